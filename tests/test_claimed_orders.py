"""The checks of claimed orders and of counts, on planted errors and on lies."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest

from bench.check.trials import (
    ORDERS_TAG,
    ForcedOscillator,
    Trial,
    check_order,
    reference,
    trials,
)
from bench.check.verdicts import Failed
from bench.plugins.registry import Registry
from integrators import (
    Integrator,
    PreparedRun,
    Reading,
    StepMethod,
    Steps,
    Trajectory,
    option,
)
from integrators.methods.hht_i3 import HHTI3
from integrators.program_costs import NotCounted
from problems import jax, jnp
from problems.equations.formulations import complete, ode_rate
from problems.equations.programs import mass_varies
from problems.scenes.oscillators import SampledPd
from problems.scenes.pendulums import Pendulum
from problems.variables import ROW_GROUPS

SCENES = [Pendulum(), Pendulum(th0=1.0)]


@dataclass(frozen=True)
class Planted(Integrator):
    """The closed form with an error h^p in q, p by scene."""

    formulation = "index3"
    claimed: int = 2
    true: tuple[float, ...] = (2.0, 2.0)
    #: Part of the error, per h in s, that a next term takes away in the last quarter.
    late: float = 0.0

    def claims(self, scene):
        return {"q": self.claimed}

    def prepare(self, scene, t_end, resolution):
        order, t0 = self.true[SCENES.index(scene)], scene.interval[0]
        late, steps = self.late, resolution.count(t0, t_end)

        class Run(PreparedRun):
            def measure(self):
                t = np.linspace(t0, t_end, steps + 1)
                values = reference(scene, t_end)(t)
                h, settled = (t_end - t0) / steps, t >= t_end - (t_end - t0) / 4
                values["q"] = values["q"] + (h**order * (1 - h * late * settled))[:, None]
                return Trajectory(t, **{group: values[group] for group in ROW_GROUPS})

            def execute(self): ...

        return Run()


def judged(**how):
    return check_order([Trial(Planted(**how), scene) for scene in SCENES])


def test_a_claim_is_at_least_what_every_scene_shows():
    for claimed, true, late in (
        (2, (2.0, 2.0), 0.0),
        (2, (2.0, 3.0), 0.0),
        (2, (1.9, 2.4), 0.0),
        (3, (3.3, 3.4), 0.0),
        (8, (8.0, 7.6), 0.0),
        (8, (8.7, 8.7), 0.0),
        (8, (8.0, 8.0), 8.0),  # a high order counts over the whole run
    ):
        assert f"q {true[0]:.1f}" in judged(claimed=claimed, true=true, late=late)


def test_a_claim_that_is_too_large_fails():
    for claimed, true, said in (
        (3, (3.0, 2.0), r"claims order 3 in q on pendulum\[th0=1.0\], is 2.00"),
        (2, (1.7, 2.0), "claims order 2 in q on pendulum, is 1.70"),
        (8, (7.4, 8.0), "claims order 8 in q on pendulum, is 7.40"),
    ):
        with pytest.raises(Failed, match=said):
            judged(claimed=claimed, true=true)
    many = [Trial(Planted(claimed=3), scene) for scene in SCENES] * 3
    with pytest.raises(Failed, match=r"s\); and 3 more like these; correct `orders`"):
        check_order(many)


def test_the_check_tries_three_scenes_with_constraints_one_of_which_has_all_groups():
    registry = Registry()
    tried = [t.scene for t in trials(registry, registry.integrator("newmark"), ORDERS_TAG)]
    constrained = [scene for scene in tried if scene.sizes.nl]
    assert sorted(scene.sizes.nl for scene in constrained) == [1, 1, 2]
    (whole,) = (s for s in constrained if mass_varies(s) and s.sizes.nx and s.sizes.ny)
    published, mended = (HHTI3(mixed=m).claims(whole) for m in ("forces", "accelerations"))
    assert [published[g] < mended[g] for g in "qvxy"] == [True] * 4


@dataclass(frozen=True)
class RungeKutta(StepMethod):
    """The classical method of four stages, of which it counts as many as it says."""

    formulation: ClassVar[str] = "ode"
    orders: ClassVar = {"q": 4, "v": 4, "lam": 4}
    counted: int = option(4, "stages counted in each step", low=0)
    looping: bool = option(False, "a loop of its own, which ends at once")

    def begin(self, scene, start, h):
        z = start.z
        return Reading(z.q, z.v, z.a, z.lam, z.x, start.xdot, z.y)

    def step(self, scene, state, t, h, work):
        work.count(residuals=self.counted)
        start = jnp.concatenate([state.q, state.v])
        if self.looping:
            start = jax.lax.while_loop(lambda s: jnp.abs(s).max() > 1e9, lambda s: s / 2, start)
        k = total = ode_rate(scene, t - h, start)
        for part, weight in ((0.5, 2), (0.5, 2), (1.0, 1)):
            k = ode_rate(scene, t - h + part * h, start + part * h * k)
            total = total + weight * k
        z, xdot = complete(scene, *jnp.split(start + h / 6 * total, 2), state.x, t)
        return Reading(z.q, z.v, z.a, z.lam, z.x, xdot, z.y)

    def read(self, scene, state):
        return state


def test_steps_that_samples_cut_do_not_hide_an_order_and_a_claim_may_be_of_multipliers():
    assert check_order([Trial(RungeKutta(), SampledPd())]) == (
        "Measured (claimed): q 3.99 (4), v 4.00 (4) on sampled_pd."
    )


def test_a_lie_in_the_counts_does_not_change_the_bill():
    scene, bills = ForcedOscillator(), []
    for counted in (4, 1):
        prepared = RungeKutta(counted=counted).prepare(scene, 3.0, Steps(0.1))
        run = prepared.measure()
        assert run.work.residuals == 10 * counted
        bills.append(prepared.bill(run))
    assert bills[0] == bills[1]
    # Of four stages and of the values at the end: the force cos(1.5 t) - q - 0.3 q^3, and M a.
    # M = 1 is known beforehand, so that its factors cost nothing, and two substitutions with one
    # unknown remain.
    stage = 1 + 10 + 1 + 2 + 1 + 1 + 1
    assert bills[0]["residuals"] == pytest.approx(10 * 5 * stage, rel=0.2)
    assert bills[0]["inner solves"] == pytest.approx(10 * 5 * 2)


def test_a_loop_of_its_own_has_no_bill_instead_of_a_guess():
    prepared = RungeKutta(looping=True).prepare(ForcedOscillator(), 3.0, Steps(0.1))
    run = prepared.measure()
    assert run.status == "ok"
    with pytest.raises(NotCounted, match="turns"):
        prepared.bill(run)
