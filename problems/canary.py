"""Trial of NumPy and JAX: functions by which runs are measured, on numbers with known results.

A plugin that patches one of them would change the numbers of every method beside it.
"""

from __future__ import annotations

import builtins
import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

#: Rounding is a hundred times smaller, that of 32-bit floats a million times larger.
_TOLERANCE = 1e-13


class _Result(NamedTuple):
    """The name of a function, what it gave, and what is right."""

    name: str
    value: Any
    right: Any


def wrong_functions(jax: Any, jnp: Any, foreign: bool = True) -> list[str]:
    """Return the names of functions of Python, NumPy and JAX that give wrong results.

    JAX's are traced anew in each call, as they may have been patched since the last one, which
    takes longer than to import JAX on some machines: without ``foreign`` code a product will do.
    """
    results = [*_of_python(), *_of_numpy()]

    def program(x: Any) -> list[Any]:
        traced[:] = _of_jax(jax, jnp, x) if foreign else [_Result("jax.jit", x * x, 4.0)]
        return [result.value for result in traced]

    traced: list[_Result] = []
    values = jax.jit(program)(2.0)
    results += [result._replace(value=value) for result, value in zip(traced, values, strict=True)]
    return [result.name for result in results if not _agree(result.value, result.right)]


def _agree(value: Any, right: Any) -> bool:
    """Whether a number, or an array as a list of numbers, is right; by plain Python alone."""
    if isinstance(right, list):
        given = value.tolist() if hasattr(value, "tolist") else value
        return len(given) == len(right) and builtins.all(map(_agree, given, right))
    value = float(value)
    return value == right or math.fabs(value - right) <= _TOLERANCE * math.fabs(right)


def _of_python() -> Iterator[_Result]:
    for name, value, right in (
        ("abs", abs(-3.0), 3.0),
        ("max", max([1.0, 3.0, 2.0]), 3.0),
        ("min", min([2.0, 1.0, 3.0]), 1.0),
        ("sum", sum([1.0, 2.5]), 3.5),
        ("math.isfinite", math.isfinite(2.0) and not math.isfinite(1e308 * 10), 1.0),
        ("math.sqrt", math.sqrt(2.0), 1.4142135623730951),
        ("math.log10", math.log10(2.0), 0.3010299956639812),
    ):
        yield _Result(name, value, right)


def _of_numpy() -> Iterator[_Result]:
    infinity = 1e308 * 10
    a, b = np.array([3.0, -4.0, 1.0]), np.array([0.5, 2.0, 4.0])
    m, rows = np.array([[4.0, 1.0], [2.0, 3.0]]), np.array([[3.0, 4.0], [5.0, -12.0]])
    for name, value, right in (
        ("abs", np.abs(a), [3.0, 4.0, 1.0]),
        ("max", np.max(a), 3.0),
        ("min", np.min(a), -4.0),
        ("maximum", np.maximum(a, b), [3.0, 2.0, 4.0]),
        ("minimum", np.minimum(a, b), [0.5, -4.0, 1.0]),
        ("sum", np.sum(a), 0.0),
        ("sum", np.sum(b), 6.5),
        ("mean", np.mean(b), 6.5 / 3),
        ("median", np.median(b), 2.0),
        ("sqrt", np.sqrt(b), [0.7071067811865476, 1.4142135623730951, 2.0]),
        ("exp", np.exp(b[0]), 1.6487212707001282),
        ("log", np.log(b[1]), 0.6931471805599453),
        ("log10", np.log10(b[1]), 0.3010299956639812),
        ("sin", np.sin(b[0]), 0.479425538604203),
        ("cos", np.cos(b[0]), 0.8775825618903728),
        ("dot", np.dot(a, b), -2.5),
        ("matmul", np.matmul(m, rows), [[17.0, 4.0], [21.0, -28.0]]),
        ("linalg.norm", np.linalg.norm(rows, axis=1), [5.0, 13.0]),
        ("linalg.norm", np.linalg.norm(rows[0]), 5.0),
        ("linalg.solve", np.linalg.solve(m, rows[0]), [0.5, 1.0]),
        ("linalg.inv", np.linalg.inv(m), [[0.3, -0.1], [-0.2, 0.4]]),
        ("linalg.eigvals", sorted(np.linalg.eigvals(m).real.tolist()), [2.0, 5.0]),
        ("trapezoid", np.trapezoid(b, a), 6.25),
        ("isfinite", np.isfinite([1.0, infinity, -infinity, infinity - infinity]), [1.0, 0, 0, 0]),
        ("where", np.where(a > 0, a, b), [3.0, 2.0, 1.0]),
        ("clip", np.clip(a, -1.0, 2.0), [2.0, -1.0, 1.0]),
        ("argmin", np.argmin(a), 1),
        ("argmax", np.argmax(b), 2),
        ("sort", np.sort(a), [-4.0, 1.0, 3.0]),
        ("searchsorted", np.searchsorted(b, 3.0), 2),
        ("cumsum", np.cumsum(a), [3.0, -1.0, 0.0]),
        ("diff", np.diff(b), [1.5, 2.0]),
        ("concatenate", np.concatenate([a[:1], b]), [3.0, 0.5, 2.0, 4.0]),
        ("stack", np.stack([a, b]), [[3.0, -4.0, 1.0], [0.5, 2.0, 4.0]]),
        ("split", np.split(a, [1])[1], [-4.0, 1.0]),
        ("moveaxis", np.moveaxis(m, 0, 1), [[4.0, 2.0], [1.0, 3.0]]),
        ("asarray", np.asarray([0.1, 0.2]), [0.1, 0.2]),
        ("zeros", np.zeros(2), [0.0, 0.0]),
        ("ones", np.ones(2), [1.0, 1.0]),
        ("full", np.full(2, 0.1), [0.1, 0.1]),
        ("eye", np.eye(2), [[1.0, 0.0], [0.0, 1.0]]),
        ("arange", np.arange(3), [0, 1, 2]),
        ("linspace", np.linspace(0.0, 1.0, 3), [0.0, 0.5, 1.0]),
        ("polyfit", np.polyfit([0.0, 1.0, 2.0], [1.0, 3.0, 5.0], 1), [2.0, 1.0]),
    ):
        yield _Result(f"numpy.{name}", value, right)


def _of_jax(jax: Any, jnp: Any, x: Any) -> Iterator[_Result]:
    """Results at x = 2, traceable."""
    a, b = jnp.stack([x + 1, -2 * x, x - 1]), jnp.stack([x / 4, x, 2 * x])
    m = jnp.stack([jnp.stack([2 * x, x - 1]), jnp.stack([x, x + 1])])
    for name, value, right in (
        ("numpy.stack", m, [[4.0, 1.0], [2.0, 3.0]]),
        ("numpy.abs", jnp.abs(a), [3.0, 4.0, 1.0]),
        ("numpy.max", jnp.max(a), 3.0),
        ("numpy.min", jnp.min(a), -4.0),
        ("numpy.maximum", jnp.maximum(a, b), [3.0, 2.0, 4.0]),
        ("numpy.minimum", jnp.minimum(a, b), [0.5, -4.0, 1.0]),
        ("numpy.sum", jnp.sum(b), 6.5),
        ("numpy.sqrt", jnp.sqrt(x), 1.4142135623730951),
        ("numpy.exp", jnp.exp(x), 7.38905609893065),
        ("numpy.log", jnp.log(x), 0.6931471805599453),
        ("numpy.sin", jnp.sin(x), 0.9092974268256817),
        ("numpy.cos", jnp.cos(x), -0.4161468365471424),
        ("numpy.tanh", jnp.tanh(x), 0.9640275800758169),
        ("numpy.arctan2", jnp.arctan2(x, -x), 2.356194490192345),
        ("numpy.dot", jnp.dot(a, b), -2.5),
        ("numpy.matmul", jnp.matmul(m, m), [[18.0, 7.0], [14.0, 11.0]]),
        ("numpy.linalg.norm", jnp.linalg.norm(a[:2]), 5.0),
        ("numpy.linalg.solve", jnp.linalg.solve(m, -a[1::-1]), [1.5, -2.0]),
        ("numpy.linalg.inv", jnp.linalg.inv(m), [[0.3, -0.1], [-0.2, 0.4]]),
        ("numpy.where", jnp.where(a > 0, a, b), [3.0, 2.0, 1.0]),
        ("numpy.isfinite", jnp.isfinite(jnp.stack([x, x / 0])), [1.0, 0.0]),
        ("numpy.isnan", jnp.isnan(jnp.stack([x, x / 0 - x / 0])), [0.0, 1.0]),
        ("numpy.concatenate", jnp.concatenate([a[:1], b]), [3.0, 0.5, 2.0, 4.0]),
        ("numpy.split", jnp.split(a, [1])[1], [-4.0, 1.0]),
        ("numpy.asarray", jnp.asarray(x), 2.0),
        ("numpy.zeros", jnp.zeros(2), [0.0, 0.0]),
        ("numpy.full", jnp.full(2, x), [2.0, 2.0]),
        ("numpy.eye", jnp.eye(2), [[1.0, 0.0], [0.0, 1.0]]),
        ("jvp", jax.jvp(lambda s: s * s, (x,), (1.0 + 0 * x,))[1], 4.0),
        ("grad", jax.grad(lambda s: s**3)(x), 12.0),
        ("jacfwd", jax.jacfwd(lambda s: s * s)(b), [[1.0, 0, 0], [0, 4.0, 0], [0, 0, 8.0]]),
        ("vmap", jax.vmap(lambda s: s + x)(a), [5.0, -2.0, 3.0]),
        ("lax.cond", jax.lax.cond(x > 1, lambda s: s, lambda s: -s, x), 2.0),
        ("lax.fori_loop", jax.lax.fori_loop(0, 3, lambda k, s: s * 2 + k, x), 20.0),
        ("lax.while_loop", jax.lax.while_loop(lambda s: s < 9, lambda s: 3 * s, x), 18.0),
    ):
        yield _Result(f"jax.{name}", value, right)
