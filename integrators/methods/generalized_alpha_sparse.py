"""The generalized-alpha step on large scenes: sparse tangents, factorised inside the compiled loop.

The tangent's pattern is found once per kind of scene, and analysed once by KLU; a new tangent then
takes a few Jacobian-vector products (one per colour of the pattern) and one factorisation on the
known pattern. Full Newton does so in every iteration; modified Newton keeps the factorisation over
iterations and steps while it contracts, and an iteration is one residual and two triangular
solves. Work and memory of a step grow with the entries of the tangent.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from typing import Any, ClassVar, NamedTuple

import numpy as np

from integrators.methods import generalized_alpha_step
from integrators.methods.generalized_alpha_step import AlphaState, Scheme
from integrators.native import klu
from integrators.native.newton import Linear
from integrators.native.time_loop import DIVERGED, Kernel, StepReport, kernel, step_times
from problems.formulations import Start
from problems.runtime import jax, jnp
from problems.sparse_initial_values import projected
from problems.sparsity import Pattern
from problems.system import MechatronicSystem


class SparseNumbers(NamedTuple):
    """A scheme, the tangent's analysis, and the part of the jerk that the constraints cause."""

    scheme: Scheme
    analysis: klu.Analysis
    constrained_jerk: Any


@dataclass(frozen=True)
class SparseAlpha:
    """A member of the family at work on one large scene, as the march wants it."""

    scheme: Scheme
    formulation: str
    newton: str
    scene: MechatronicSystem
    start: Start
    noted: ClassVar[tuple[str, ...]] = ("h", "gamma", "theta")

    def pattern(self) -> Pattern:
        """Pattern of the tangent."""
        return _analysed(self.scene.template(), self._stabilised)[0]

    def numbers(self) -> SparseNumbers:
        """What is traced."""
        pattern, symbolic = _analysed(self.scene.template(), self._stabilised)
        z, jerk = self.start.z, self.start.jerk
        if self.scheme.corrected and self.scene.sizes.nl and not self._stabilised:
            jerk = projected(self.scene, z.q, float(z.t), jerk)
        analysis = klu.Analysis(pattern.rows, pattern.columns, np.asarray(symbolic.raw))
        return SparseNumbers(self.scheme, analysis, jerk)

    def kernel(self, scene: MechatronicSystem) -> GuardedKernel:
        """The compiled march."""
        return _kernel(scene.template(), self._stabilised, self.newton == "modified")

    @property
    def _stabilised(self) -> bool:
        return self.formulation == "stabilised_index2"


@cache
def _analysed(template: MechatronicSystem, stabilised: bool) -> tuple[Pattern, Any]:
    """Pattern of a scene's tangents, and KLU's analysis of it."""
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
    weights = generalized_alpha_step.weights(scheme, state, h)
    t = jnp.asarray(template.interval[0])
    equations = generalized_alpha_step.equations(stabilised, template, scheme, state, weights, t, h)
    n = sizes.nq + sizes.nl * (2 if stabilised else 1) + sizes.nx + sizes.ny
    pattern = Pattern(equations.residual, n)
    return pattern, klujax.analyze(jnp.asarray(pattern.rows), jnp.asarray(pattern.columns), n)


class GuardedKernel:
    """A march that ends with a status where a tangent is exactly singular.

    KLU ends the program there, and with it go all results. Which step it was is then found by
    halving the number of steps.
    """

    def __init__(self, kernel: Kernel) -> None:
        self._kernel, self.pack = kernel, kernel.pack

    @property
    def compilations(self) -> int:
        """As in `march.Kernel`."""
        return self._kernel.compilations

    def __call__(self, packed: Any, rows: Any, row_count: Any) -> Any:
        result = self._try(packed, rows, row_count)
        if result is not None:
            return result
        fine, wrong = 0, int(rows[row_count - 1])
        while wrong - fine > 1:
            middle = (fine + wrong) // 2
            done = self._try(packed, jnp.full_like(rows, middle), jnp.ones_like(row_count))
            fine, wrong = (fine, middle) if done is None else (middle, wrong)
        kept, _ = self._kernel(packed, rows, (rows[:row_count] <= fine).sum())
        _, end = self._kernel(packed, jnp.full_like(rows, fine), jnp.ones_like(row_count))
        t, _ = step_times(self._kernel.clock(packed), fine)
        return kept, jnp.concatenate([jnp.stack([DIVERGED, t]), end[2:]])

    def _try(self, *arguments: Any) -> Any:
        try:
            return jax.block_until_ready(self._kernel(*arguments))
        except (ValueError, RuntimeError) as error:
            if klu.FAILURE in str(error):
                return None
            raise


@cache
def _kernel(template: MechatronicSystem, stabilised: bool, modified: bool) -> GuardedKernel:
    pattern, _ = _analysed(template, stabilised)
    begin, step = partial(_begin, stabilised, modified), partial(_step, stabilised, pattern)
    return GuardedKernel(kernel(begin, step, generalized_alpha_step.read, template, _finish))


def _begin(
    stabilised: bool,
    modified: bool,
    scene: MechatronicSystem,
    numbers: SparseNumbers,
    start: Start,
    h: Any,
) -> AlphaState:
    state = generalized_alpha_step.begin(
        stabilised, False, scene, numbers.scheme, start, h, numbers.constrained_jerk
    )
    return state._replace(kept=klu.none()) if modified else state


def _step(
    stabilised: bool,
    pattern: Pattern,
    scene: MechatronicSystem,
    numbers: SparseNumbers,
    state: AlphaState,
    t: Any,
    h: Any,
) -> tuple[AlphaState, StepReport]:
    linear = _linear(pattern, numbers.analysis)
    return generalized_alpha_step.step(
        stabilised, False, scene, numbers.scheme, state, t, h, linear
    )


def _linear(pattern: Pattern, analysis: klu.Analysis) -> Linear:
    """Updates by KLU; what modified Newton keeps is a factorisation."""

    def once(residual: Callable, u: Any) -> Any:
        return klu.solve(analysis, pattern.values(residual, u), residual(u))

    def renewed(residual: Callable, u: Any, kept: Any) -> Any:
        return klu.factorised(analysis, pattern.values(residual, u), instead_of=kept)

    def update(kept: Any, r: Any) -> Any:
        return klu.solve_by(kept, analysis, r)

    return Linear(once, renewed, update, known=lambda kept: kept[0] > 0)


def _finish(state: AlphaState) -> None:
    """After the last step, nobody else frees what modified Newton has kept."""
    if state.kept.size:
        klu.free(state.kept)
