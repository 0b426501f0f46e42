"""Backward differences: of order two, also on Lie groups, and of orders one to five."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np

from integrators.contract import WIDER, option
from integrators.native.algebra.step_records import Errors, Reading, Scalar, Time
from integrators.native.step.method_options import (
    Formulated,
    OwnValues,
    StageMethod,
    StageState,
    formulation_option,
)
from integrators.native.step.stage_equations import Base, Guess, Slopes, stage_equations
from integrators.native.step.step_work import StepWork
from integrators.native.step_method import ErrorControl, ImplicitStepMethod
from problems.base.runtime import Array, Float, Int, jax, jnp
from problems.equations.formulations import Start
from problems.equations.kinematics import Displaced, advance, displaced
from problems.system import MechatronicSystem
from problems.variables import state_layout


@dataclass(frozen=True)
class BDF2(StageMethod, Formulated, ImplicitStepMethod):
    """Backward differences of order two; L-stable, one solve in a step.

    With the ratio w = h/h_before of two steps, for u = q, v and x::

        h udot+ = (1 + 2 w)/(1 + w) u+ - (1 + w) u + w^2/(1 + w) u-

    For q and v the first step is one of generalized-alpha with rho_inf = 0, so that it damps as
    much::

        q+ = q + h v + h^2/2 a+,   v+ = v + h (a + 3 a+)/4,   x+ = x + h (xdot + 3 xdot+)/4

    In the stabilised form the multiplier corrects q alone, not v.
    """

    family: ClassVar[str] = "backward differences"
    takes: ClassVar[tuple[str, ...]] = ("velocity_constraint", "coupled_force")
    orders: ClassVar[dict[str, int]] = {"q": 2, "v": 2, "a": 2, "lam": 2, "x": 2, "y": 2}
    source: ClassVar[str] = (
        "Gear (1971), doi:10.1109/TCT.1971.1083221; variable steps after Hairer, Norsett & Wanner "
        "(1993), doi:10.1007/978-3-540-78862-1, sec. III.5"
    )

    def own(self, scene: MechatronicSystem, start: Start, h: Time) -> tuple[Base, Array]:
        """Return the displacement of q in the last step, v and x at its start, and whether there
        was none."""
        return Base(0.0 * start.z.v, start.z.v, start.z.x), jnp.asarray(True)

    def step(
        self, scene: MechatronicSystem, state: StageState, t: Time, h: Time, work: StepWork
    ) -> StageState:
        now, _, ((moved, v, x), is_first) = state
        w = h / state.guess.h
        newest, older = (1 + w) ** 2 / (1 + 2 * w), w**2 / (1 + 2 * w)
        tau = h * (1 + w) / (1 + 2 * w)
        v_base = newest * now.v - older * v
        q_base = displaced(scene, now.q, older * moved, tau * v_base)
        later = Base(q_base, v_base, newest * now.x - older * x)
        # Of the first step's acceleration and rate only those of the start are there.
        a, xdot = now.a, now.xdot
        q_base = displaced(scene, now.q, h * now.v)
        first = Base(q_base, now.v + h / 4 * a, now.x + h / 4 * xdot)
        both = (Slopes(h**2 / 2, 3 * h / 4, 3 * h / 4), first), (Slopes(tau**2, tau, tau), later)
        slopes, base = jax.tree.map(lambda one, two: jnp.where(is_first, one, two), *both)
        e = stage_equations(scene, self.formulation, base, slopes, t, (now.q, t - h))
        z, xdot, guess = e.solve_from(work, state.guess, h)
        on_group = isinstance(base.q, Displaced)
        moved = base.q.w + slopes.q * z.a if on_group else z.q - now.q
        shown = self.reported(scene, z, xdot, work)
        return StageState(shown, guess, (Base(moved, now.v, now.x), jnp.asarray(False)))


@dataclass(frozen=True)
class BLieDF(BDF2):
    """BDF2 on Lie groups: backward differences of displacements, which move q once in a step.

    With displacements w = h D, where q+ = q o exp(w+), and the ratio r = h/h_before::

        v+ = (1 + 2 r)/(1 + r) D+ - r/(1 + r) D,   h vdot+ as in `BDF2`

    Where velocities are the rates of the coordinates it is BDF2.
    """

    name: ClassVar[str] = "bliedf"
    takes: ClassVar[tuple[str, ...]] = tuple(WIDER)
    source: ClassVar[str] = "Wieloch & Arnold (2021), doi:10.1016/j.cam.2019.112517"

    formulation: str = formulation_option("index3", "index2")


#: Differences that are kept: order five needs those up to the seventh for its choice.
_KEPT = 8
#: 1 + 1/2 + ... + 1/k.
_HARMONIC = np.concatenate([[0.0], np.cumsum(1 / np.arange(1, _KEPT))])
#: Values smaller than this count as this large when orders are compared, as the default of atol.
_SMALL = 0.01
#: Backward differences of a cubic at equal steps h, from its derivatives h^m s^(m).
_OF_TAYLOR = np.array([[1, 0, 0, 0], [0, 1, -1 / 2, 1 / 6], [0, 0, 1, -1], [0, 0, 0, 1]])
_TO_TAYLOR = np.linalg.inv(_OF_TAYLOR)
#: Largest ratio of neighbouring steps.
_GROWTH = 2.0


class BDFState(NamedTuple):
    """Values at the end of the last step, and differences of s = [q, v, x] there.

    ``differences[m]`` is the divided difference of the last m + 1 values times
    ``spans[0] ... spans[m - 1]``, the times in s between the last value and the others.
    """

    shown: Reading
    differences: Float[Array, "8 n"]
    spans: Float[Array, " 7"]
    order: Int[Array, ""]
    #: Estimated local error of s in the last step, and the order of that step; 0 before the first.
    error: Float[Array, " n"]
    order_before: Int[Array, ""]
    guess: Guess


@dataclass(frozen=True)
class BDFAdaptive(OwnValues, ErrorControl, ImplicitStepMethod):
    """Backward differences with variable step and order and a fixed leading coefficient.

    It is the algorithm of DASSL and IDA on the mechanical form. With the polynomial p of degree k
    through the last values of s = [q, v, x]::

        s+ = p(t+) + h/(1 + 1/2 + ... + 1/k) (sdot+ - pdot(t+))

    The local error is that of DASSL, a multiple of s+ - p(t+). a and lam are not tested. The next
    order is k - 1, k or k + 1, by the sizes of h^(k+1) s^(k+1) and its neighbours: it falls where
    these terms do not decrease, and rises where they do.

    With index 3 an error of q of one step's tolerance is one of v of 1/h that size, which does not
    fall with the steps; x, whose rate may hold a, has the same. Only q is tested then. A spring so
    stiff that no step resolves it does the same to v, which is tested there, and orders three to
    five let its vibration grow where omega h is a few: steps stay near 1/omega, as IDA's do. On a
    bar of 18124 rad/s both take some 34 000 steps for a second at rtol=1e-5, and no digit of a,
    which is not tested, is right (relative, largest over time: 0.8 and 4.2).
    """

    family: ClassVar[str] = "backward differences"
    takes: ClassVar[tuple[str, ...]] = ("velocity_constraint", "coupled_force")
    source: ClassVar[str] = (
        "Brenan, Campbell & Petzold (1996), doi:10.1137/1.9781611971224, ch. 5; Jackson & "
        "Sacks-Davis (1980), doi:10.1145/355900.355903"
    )
    formulation: str = formulation_option("stabilised_index2", "index3", "index2", "index1")
    max_order: int = option(5, "largest order", low=1, high=5)

    @property
    def order(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        """The order whose tolerance local errors have; see
        `integrators.native.loops.adaptive_steps`."""
        return min(4, self.max_order)

    @property
    def order_of_first_step(self) -> int:
        return min(2, self.max_order)

    @property
    def tested(self) -> str:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Groups that the first step follows.

        On index 3 it follows q alone: a controller that begins at zero would make it so small that
        rounding of positions, eps/h^2, would spoil a and lam.
        """
        return "q" if self.formulation == "index3" else "qvx"

    def first_step(self, h: Time) -> Time:
        # On index 3 nothing tests the error of v, which is 1/h of that of q.
        return h / 4 if self.formulation == "index3" else h

    def begin(self, scene: MechatronicSystem, start: Start, h: Time) -> BDFState:
        """Begin with order two and the differences of Taylor polynomials, as at equal steps."""
        z = start.z
        first = [z.v - h / 2 * z.a + h**2 / 6 * start.jerk, z.a - h / 2 * start.jerk]
        second = [z.a - h * start.jerk, start.jerk]
        rows = [
            jnp.concatenate([z.q, z.v, z.x]),
            h * jnp.concatenate([*first, start.xdot - h / 2 * start.xddot]),
            h**2 * jnp.concatenate([*second, start.xddot]),
            h**3 * jnp.concatenate([start.jerk, 0 * start.jerk, 0 * start.xddot]),
        ]
        differences = jnp.zeros((_KEPT, len(rows[0]))).at[: len(rows)].set(jnp.stack(rows))
        order = jnp.asarray(self.order_of_first_step)
        shown = self.reported(scene, z, start.xdot)
        guess = Guess.begin(z, start.xdot, h)
        spans = h * jnp.arange(1.0, _KEPT)
        return BDFState(shown, differences, spans, order, 0 * rows[0], 0 * order, guess)

    def step(
        self, scene: MechatronicSystem, state: BDFState, t: Time, h: Time, work: StepWork
    ) -> BDFState:
        k, now, layout = state.order, state.shown, state_layout(scene.sizes)
        state = _respaced(state, h)
        spans = h + jnp.concatenate([jnp.zeros(1), state.spans[:-1]])
        # Differences with respect to the times from the end of this step.
        shifted = _products(spans / state.spans)[:, None] * state.differences
        used = (jnp.arange(_KEPT) <= k)[:, None]
        rates = jnp.concatenate([jnp.zeros(1), jnp.cumsum(1 / spans)])
        predicted = jnp.sum(jnp.where(used, shifted, 0.0), axis=0)
        rate = jnp.sum(jnp.where(used, rates[:, None] * shifted, 0.0), axis=0)

        tau = h / jnp.asarray(_HARMONIC)[k]
        q, v, x = layout.split(predicted - tau * rate)
        base, slopes = Base(advance(scene, q, tau * v), v, x), Slopes(tau**2, tau, tau)
        e = stage_equations(scene, self.formulation, base, slopes, t, (now.q, t - h))
        z, xdot, guess = e.solve_from(work, state.guess, h)

        s = jnp.concatenate([z.q, z.v, z.x])
        sums = jnp.cumsum(shifted, axis=0)
        differences = jnp.concatenate([s[None], s - sums[:-1]])
        part = h / spans
        leading = jnp.sum(jnp.where(jnp.arange(1, _KEPT) <= k, part, 0.0))
        last = part[k]
        constant = jnp.maximum(last, jnp.abs(last + leading - jnp.asarray(_HARMONIC)[k]))
        return BDFState(
            self.reported(scene, z, xdot, work),
            differences,
            spans,
            self._next_order(scene, k, differences, part),
            constant * differences[k + 1],
            k,
            guess,
        )

    def _next_order(
        self, scene: MechatronicSystem, k: Array, differences: Array, part: Array
    ) -> Array:
        """Choose the next order by DASSL's rule; ``part`` are h/spans."""
        derivatives = _products(jnp.arange(1, _KEPT) * part)[:, None] * differences

        def sizes_of(group: str) -> Array:
            at = getattr(state_layout(scene.sizes), group)
            scale = _SMALL + jnp.linalg.norm(differences[0, at])
            return jnp.linalg.norm(derivatives[:, at], axis=1) / scale

        sizes = jnp.max(jnp.stack([sizes_of(g) for g in self._tested(scene)]), axis=0)
        two_lower, lower, here, higher = (sizes[k + j] for j in (-1, 0, 1, 2))
        falling = (lower <= jnp.minimum(here, higher)) | (
            (k > 2) & (jnp.maximum(two_lower, lower) <= here)
        )
        down = (k > 1) & falling
        up = ~down & (k < self.max_order) & (higher < jnp.where(k > 1, 1.0, 0.5) * here)
        return k + up - down

    def _tested(self, scene: MechatronicSystem) -> str:
        return self.tested if scene.sizes.nl else "qvx"

    def estimate(self, before: BDFState, after: BDFState, h: Time) -> Errors:
        now = after.shown
        q, v, x = jnp.split(after.error, [len(now.q), len(now.q) + len(now.v)])
        if self.formulation == "index3" and now.lam.size:
            v, x = 0 * v, 0 * x
        return Errors(q, v, x)

    def order_of(self, after: BDFState) -> Scalar:
        return after.order_before

    def ratios(self) -> tuple[Scalar, Scalar]:
        return 0.0, _GROWTH


def _respaced(state: BDFState, h: Time) -> BDFState:
    """Before the first step, give the Taylor polynomials of `begin` the spacing h.

    A first step that is tried again, smaller, would have values of before that are far apart: the
    parabola through them errs by h times their distance squared, which is 1/h in a of index 3.
    """
    first, ratio = state.order_before == 0, h / state.spans[0]
    rows = state.differences[: len(_OF_TAYLOR)]
    powers = ratio ** jnp.arange(len(_OF_TAYLOR))
    respaced = jnp.asarray(_OF_TAYLOR) @ (powers[:, None] * (jnp.asarray(_TO_TAYLOR) @ rows))
    return state._replace(
        differences=state.differences.at[: len(rows)].set(jnp.where(first, respaced, rows)),
        spans=jnp.where(first, ratio, 1.0) * state.spans,
    )


def _products(factors: Array) -> Array:
    """1, f1, f1 f2, ..."""
    return jnp.concatenate([jnp.ones(1), jnp.cumprod(factors)])
