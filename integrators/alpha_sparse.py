"""The generalized-alpha step on large scenes: sparse tangents, factorised inside the compiled loop.

The tangent's pattern is found once per kind of scene, and analysed once by KLU; every Newton
iteration then takes a few Jacobian-vector products (one per colour of the pattern) and one
factorisation on the known pattern. Work and memory of a step grow with the entries of the tangent.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, partial
from typing import Any, ClassVar, NamedTuple

import numpy as np

from integrators import alpha_step
from integrators.alpha_step import AlphaState, Scheme
from integrators.march import Kernel, StepReport, kernel
from problems.formulations import Start
from problems.large import projected
from problems.runtime import jnp
from problems.sparsity import Pattern
from problems.system import MechatronicSystem, Sizes

#: A tangent with more than this part of its entries is no sparse one.
_MOST_FILL = 0.1


class SparseNumbers(NamedTuple):
    """A scheme; rows and columns of the tangent's entries, which may not be constants of the
    program (XLA would sort them while compiling), and the address of KLU's analysis of them;
    the part of the jerk that the constraints cause."""

    scheme: Scheme
    rows: Any
    columns: Any
    analysis: Any
    constrained_jerk: Any


@dataclass(frozen=True)
class SparseAlpha:
    """A member of the family at work on one large scene, as the march wants it."""

    scheme: Scheme
    formulation: str
    scene: MechatronicSystem
    start: Start
    noted: ClassVar[tuple[str, ...]] = ("h", "gamma", "theta")

    def pays(self) -> bool:
        """Whether the tangent has few entries."""
        pattern, *_ = _prepared(self.scene.template(), self._stabilised)
        return len(pattern.rows) < _MOST_FILL * pattern.size**2

    def numbers(self) -> SparseNumbers:
        """What is traced."""
        pattern, analysis, _ = _prepared(self.scene.template(), self._stabilised)
        z, jerk = self.start.z, self.start.jerk
        if self.scheme.corrected and self.scene.sizes.nl and not self._stabilised:
            jerk = projected(self.scene, z.q, float(z.t), jerk)
        address = np.asarray(analysis.raw)
        return SparseNumbers(self.scheme, pattern.rows, pattern.columns, address, jerk)

    def kernel(self, scene: MechatronicSystem) -> Kernel:
        """The compiled march."""
        _, _, functions = _prepared(scene.template(), self._stabilised)
        return kernel(*functions, scene.template(), scene.sizes)

    @property
    def _stabilised(self) -> bool:
        return self.formulation == "stabilised_index2"


@cache
def _prepared(template: MechatronicSystem, stabilised: bool) -> tuple:
    """Pattern and analysis of a scene's tangents, and the functions of the march."""
    import klujax

    sizes, h = template.sizes, jnp.asarray(template.nominal_step)
    start = template.initial_state()
    zeros = {n: jnp.zeros(k) for n, k in zip(("lam", "x", "y"), sizes[1:], strict=True)}
    nothing = jnp.zeros(sizes.nq)
    scheme = Scheme(*[jnp.asarray(0.5)] * 7, *[jnp.asarray(False)] * 3, 1e-9, 9, jnp.asarray(True))
    state = AlphaState(
        jnp.asarray(start.q), jnp.asarray(start.v), nothing, nothing, zeros["lam"], zeros["x"],
        zeros["x"], zeros["x"], zeros["y"], h, h, h, h, h, nothing, None, None, None,
    )  # fmt: skip
    weights = alpha_step.weights(scheme, state, h)
    t = jnp.asarray(template.interval[0])
    equations = alpha_step.equations(stabilised, template, sizes, scheme, state, weights, t, h)
    n = sizes.nq + sizes.nl * (2 if stabilised else 1) + sizes.nx + sizes.ny
    pattern = Pattern(equations.residual, n)
    analysis = klujax.analyze(jnp.asarray(pattern.rows), jnp.asarray(pattern.columns), n)
    begin, step = partial(_begin, stabilised), partial(_step, stabilised, pattern)
    return pattern, analysis, (begin, step, alpha_step.read)


def _begin(
    stabilised: bool,
    scene: MechatronicSystem,
    sizes: Sizes,
    numbers: SparseNumbers,
    start: Start,
    h: Any,
) -> AlphaState:
    return alpha_step.begin(
        stabilised, False, scene, sizes, numbers.scheme, start, h, numbers.constrained_jerk
    )


def _step(
    stabilised: bool,
    pattern: Pattern,
    scene: MechatronicSystem,
    sizes: Sizes,
    numbers: SparseNumbers,
    state: AlphaState,
    t: Any,
    h: Any,
) -> tuple[AlphaState, StepReport]:
    import klujax

    def solve(residual: Any, u: Any) -> Any:
        values = pattern.values(residual, u)
        at = numbers.rows, numbers.columns
        return klujax.solve_with_symbol(*at, values, residual(u), numbers.analysis)

    return alpha_step.step(stabilised, False, scene, sizes, numbers.scheme, state, t, h, solve)
