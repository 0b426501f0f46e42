"""The time loops: weights in varying steps, step control, exact times, values not finite."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pytest

from bench.plugins.registry import Registry
from bench.plugins.skeletons import integrator as skeleton
from integrators import Steps, Tolerances
from problems import MechatronicSystem, State, jnp, parameter

REGISTRY = Registry()


# ---- constant steps and patterns -----------------------------------------------------------
def test_a_cut_restarts_only_the_weight_whose_limit_it_passes():
    """Bruels & Arnold (2008), eqs (28)-(30), worked out by hand for h = 4/5 and h = 1/5."""
    for rho_inf, rho_inf_x, gamma, theta in [
        # Smallest safe ratios of steps are alpha_m/(1 - alpha_m) and delta_m/(1 - delta_m):
        # 1/2 and 1/13 here, so that the cut to 1/4 restarts the motion alone,
        (0.8, 0.4, 3 / 5, 247 / 308),
        # and here below zero and 7/11, so that it restarts the controller alone.
        (0.4, 0.8, 124 / 119, 11 / 20),
    ]:
        method = REGISTRY.integrator(
            f"generalized_alpha[rho_inf={rho_inf},rho_inf_x={rho_inf_x},gamma=guarded]"
        )
        run = method.prepare(REGISTRY.problem("spring_mass"), 0.1, Steps(0.1, (0.8, 0.2))).measure()
        assert run.status == "ok", run.message
        assert run.notes["gamma"][2] == pytest.approx(gamma, rel=1e-12)
        assert run.notes["theta"][2] == pytest.approx(theta, rel=1e-12)


def test_patterns_end_at_exact_times_whatever_the_rounding_of_their_fractions():
    for pattern in [(0.1,) * 10, (0.7, 0.1, 0.1, 0.1)]:
        assert np.cumsum(pattern)[-1] != 1.0
        scene, macros, n = REGISTRY.problem("spring_mass"), 8, len(pattern)
        run = REGISTRY.integrator("generalized_alpha").prepare(
            scene, 1.0, Steps(1 / macros, pattern)
        )
        found = run.measure()
        assert found.status == "ok", found.message
        assert found.t[-1] == 1.0
        assert set(np.arange(1, macros + 1) / macros) <= set(found.t.tolist())
        assert found.work.steps == macros * n


@dataclass(frozen=True)
class Losing(MechatronicSystem):
    """A mass on a spring that a constraint ties to another; the last a and lam get something on."""

    interval = (0.0, 1.0)
    more_a: float = parameter(0.0, "m/s^2", "added to a at the end")
    more_lam: float = parameter(0.0, "N", "added to lam at the end")

    def mass(self, q):
        return jnp.eye(2)

    def force(self, q, v, t):
        return -q

    def constraint(self, q, t):
        return q[:1] - q[1:]

    def initial_state(self):
        return State(q=np.ones(2), v=np.zeros(2))


@pytest.mark.parametrize("lost", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("name", ["more_a", "more_lam"])
def test_a_run_diverges_where_only_a_or_lam_is_not_finite(monkeypatch, name, lost):
    def complete(scene, q, v, x, t):
        z, xdot = plain(scene, q, v, x, t)
        ended = t >= 1.0 - 1e-9
        a = z.a + jnp.where(ended, scene.more_a, 0.0)
        return z._replace(a=a, lam=z.lam + jnp.where(ended, scene.more_lam, 0.0)), xdot

    plain = skeleton.complete
    monkeypatch.setattr(skeleton, "complete", complete)
    # The inner stage lies at the middle of the step: at the end q and v are still finite.
    method = skeleton.NewIntegrator(place=0.5)
    assert method.prepare(Losing(), 1.0, Steps(0.1)).measure().status == "ok"
    run = method.prepare(Losing(**{name: lost}), 1.0, Steps(0.1)).measure()
    assert run.status == "diverged"
    assert "t=1 s" in run.message
    assert run.t[-1] == pytest.approx(0.9)


# ---- steps that follow a tolerance -----------------------------------------------------------
@dataclass(frozen=True)
class Forced(MechatronicSystem):
    """A free mass under the force a0 + j t, and a state x' = s t."""

    interval = (0.0, 10.0)
    q0: float = parameter(0.0, "m", "position at the start")
    v0: float = parameter(0.0, "m/s", "velocity at the start")
    x0: float = parameter(0.0, "1", "state at the start")
    a0: float = parameter(0.0, "m/s^2", "acceleration at the start")
    j: float = parameter(0.0, "m/s^3", "jerk at the start")
    s: float = parameter(0.0, "1/s^2", "second derivative of the state")

    def mass(self, q):
        return jnp.eye(1)

    def force(self, q, v, t):
        return jnp.reshape(self.a0 + self.j * t, 1)

    def state_rate(self, z):
        return jnp.reshape(self.s * z.t, 1)

    def initial_state(self):
        return State(*(np.array([value]) for value in (self.q0, self.v0, self.x0)))


def test_the_first_step_is_worked_out_from_the_next_terms_of_the_taylor_series():
    for values, h in [
        # All by hand for rtol = atol = 1e-4: a group may err by 1e-4 (1 + its norm) sqrt(rtol).
        ({"j": 12.0, "v0": 1e4}, 0.01),  # q: jerk h^3/12 = 1e-6
        ({"j": 4.0, "q0": 1e4, "v0": 99.0}, 0.005),  # v: jerk h^2 = 1e-4
        # v is zero, and is taken as a times a hundredth of the interval:
        ({"j": 1.0, "q0": 1e4, "a0": 990.0}, 0.01),
        ({"s": 0.25, "x0": 99.0}, 0.02),  # x: x'' h^2 = 1e-4
        ({"q0": 1.0}, 0.1),  # nothing moves: a hundredth of the interval
    ]:
        method = REGISTRY.integrator("generalized_alpha_adaptive")
        run = method.prepare(Forced(**values), 10.0, Tolerances(1e-4, 1e-4)).measure()
        assert run.status == "ok", run.message
        assert run.notes["h"][1] == pytest.approx(h, rel=1e-4)
