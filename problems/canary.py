"""Trial of NumPy and JAX: functions by which runs are measured, on numbers with known results.

A plugin that patches one of them would change the numbers of every method beside it.
"""

from __future__ import annotations

import builtins
import math
from typing import Any

import numpy as np

#: Rounding is a hundred times smaller, that of 32-bit floats a million times larger.
_TOLERANCE = 1e-13

#: By the name of a function, what it gave and what is right.
_Trials = dict[str, tuple[Any, Any]]


def wrong_functions(jax: Any, jnp: Any, foreign: bool = True) -> list[str]:
    """Return the names of functions of Python, NumPy and JAX that give wrong results.

    JAX's are traced anew in each call, as they may have been patched since the last one, which
    takes longer than to import JAX on some machines: without ``foreign`` code a product will do.
    """
    tried = _of_python() | _under("numpy", _of_arrays(np, 2.0) | _of_numpy())
    traced: _Trials = {"jax.jit": (None, 4.0)}

    def program(x: Any) -> dict[str, Any]:
        if not foreign:
            return {"jax.jit": x * x}
        traced.update(_under("jax.numpy", _of_arrays(jnp, x)) | _of_jax(jax, x))
        return {name: value for name, (value, _) in traced.items()} | {"jax.jit": x * x}

    values = jax.jit(program)(2.0)
    tried |= {name: (values[name], right) for name, (_, right) in traced.items()}
    return [name for name, (value, right) in tried.items() if not _agree(value, right)]


def _under(module: str, results: _Trials) -> _Trials:
    return {f"{module}.{name}": result for name, result in results.items()}


def _agree(value: Any, right: Any) -> bool:
    """Whether a number, or an array as a list of numbers, is right; by plain Python alone."""
    if isinstance(right, list):
        given = value.tolist() if hasattr(value, "tolist") else value
        return len(given) == len(right) and builtins.all(map(_agree, given, right))
    value = float(value)
    return value == right or math.fabs(value - right) <= _TOLERANCE * math.fabs(right)


def _of_python() -> _Trials:
    return {
        "abs": (abs(-3.0), 3.0),
        "max": (max([1.0, 3.0, 2.0]), 3.0),
        "min": (min([2.0, 1.0, 3.0]), 1.0),
        "sum": (sum([1.0, 2.5]), 3.5),
        "math.isfinite": (math.isfinite(2.0) and not math.isfinite(1e308 * 10), 1.0),
        "math.sqrt": (math.sqrt(2.0), 1.4142135623730951),
        "math.log10": (math.log10(2.0), 0.3010299956639812),
    }


def _of_arrays(xp: Any, x: Any) -> _Trials:
    """_Trials of functions that NumPy and JAX share at x = 2, which may be traced."""
    a, b = xp.stack([x + 1, -2 * x, x - 1]), xp.stack([x / 4, x, 2 * x])
    m = xp.stack([xp.stack([2 * x, x - 1]), xp.stack([x, x + 1])])
    infinity = x * 1e308
    return {
        "stack": (m, [[4.0, 1.0], [2.0, 3.0]]),
        "abs": (xp.abs(a), [3.0, 4.0, 1.0]),
        "max": (xp.max(a), 3.0),
        "min": (xp.min(a), -4.0),
        "maximum": (xp.maximum(a, b), [3.0, 2.0, 4.0]),
        "minimum": (xp.minimum(a, b), [0.5, -4.0, 1.0]),
        "sum": (xp.sum(b), 6.5),
        "mean": (xp.mean(b), 6.5 / 3),
        "sqrt": (xp.sqrt(b), [0.7071067811865476, 1.4142135623730951, 2.0]),
        "exp": (xp.exp(x), 7.38905609893065),
        "log": (xp.log(x), 0.6931471805599453),
        "sin": (xp.sin(x), 0.9092974268256817),
        "cos": (xp.cos(x), -0.4161468365471424),
        "tanh": (xp.tanh(x), 0.9640275800758169),
        "arctan2": (xp.arctan2(x, -x), 2.356194490192345),
        "dot": (xp.dot(a, b), -2.5),
        "matmul": (xp.matmul(m, m), [[18.0, 7.0], [14.0, 11.0]]),
        "linalg.norm": (xp.linalg.norm(xp.stack([a[:2], 3 * a[:2]]), axis=1), [5.0, 15.0]),
        "linalg.solve": (xp.linalg.solve(m, -a[1::-1]), [1.5, -2.0]),
        "linalg.inv": (xp.linalg.inv(m), [[0.3, -0.1], [-0.2, 0.4]]),
        "where": (xp.where(a > 0, a, b), [3.0, 2.0, 1.0]),
        "isfinite": (xp.isfinite(xp.stack([x, infinity, infinity - infinity])), [1.0, 0.0, 0.0]),
        "isnan": (xp.isnan(xp.stack([x, infinity, infinity - infinity])), [0.0, 0.0, 1.0]),
        "concatenate": (xp.concatenate([a[:1], b]), [3.0, 0.5, 2.0, 4.0]),
        "split": (xp.split(a, [1])[1], [-4.0, 1.0]),
        "asarray": (xp.asarray(b), [0.5, 2.0, 4.0]),
        "zeros": (xp.zeros(2), [0.0, 0.0]),
        "full": (xp.full(2, x), [2.0, 2.0]),
        "eye": (xp.eye(2), [[1.0, 0.0], [0.0, 1.0]]),
    }


def _of_numpy() -> _Trials:
    a, b, m = np.array([3.0, -4.0, 1.0]), np.array([0.5, 2.0, 4.0]), np.array([[4.0, 1], [2, 3]])
    return {
        "median": (np.median(b), 2.0),
        "log10": (np.log10(b[1]), 0.3010299956639812),
        "linalg.eigvals": (sorted(np.linalg.eigvals(m).real.tolist()), [2.0, 5.0]),
        "trapezoid": (np.trapezoid(b, a), 6.25),
        "clip": (np.clip(a, -1.0, 2.0), [2.0, -1.0, 1.0]),
        "argmin": (np.argmin(a), 1),
        "argmax": (np.argmax(b), 2),
        "sort": (np.sort(a), [-4.0, 1.0, 3.0]),
        "searchsorted": (np.searchsorted(b, 3.0), 2),
        "cumsum": (np.cumsum(a), [3.0, -1.0, 0.0]),
        "diff": (np.diff(b), [1.5, 2.0]),
        "moveaxis": (np.moveaxis(m, 0, 1), [[4.0, 2.0], [1.0, 3.0]]),
        "ones": (np.ones(2), [1.0, 1.0]),
        "arange": (np.arange(3), [0, 1, 2]),
        "linspace": (np.linspace(0.0, 1.0, 3), [0.0, 0.5, 1.0]),
        "polyfit": (np.polyfit([0.0, 1.0, 2.0], [1.0, 3.0, 5.0], 1), [2.0, 1.0]),
    }


def _of_jax(jax: Any, x: Any) -> _Trials:
    """_Trials of JAX's transformations and loops at x = 2, traced."""
    b = jax.numpy.stack([x / 4, x, 2 * x])
    results = {
        "jvp": (jax.jvp(lambda s: s * s, (x,), (1.0 + 0 * x,))[1], 4.0),
        "grad": (jax.grad(lambda s: s**3)(x), 12.0),
        "jacfwd": (jax.jacfwd(lambda s: s * s)(b), [[1.0, 0, 0], [0, 4.0, 0], [0, 0, 8.0]]),
        "vmap": (jax.vmap(lambda s: s + x)(b), [2.5, 4.0, 6.0]),
        "lax.cond": (jax.lax.cond(x > 1, lambda s: s, lambda s: -s, x), 2.0),
        "lax.fori_loop": (jax.lax.fori_loop(0, 3, lambda k, s: s * 2 + k, x), 20.0),
        "lax.while_loop": (jax.lax.while_loop(lambda s: s < 9, lambda s: 3 * s, x), 18.0),
    }
    return _under("jax", results)
