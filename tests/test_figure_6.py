"""Figure 6 of Bruels & Arnold (2008), matched with a plain program of its recursion."""

from __future__ import annotations

import math

import numpy as np
import pytest

from bench.running.profiles import read_profile
from integrators import Steps
from integrators.methods.generalized_alpha import GeneralizedAlpha
from problems.base.spec import build, split_spec
from problems.scenes.oscillators import SpringMass

(STUDY,) = (study for study in read_profile("paper")[1].study if len(study.pattern) > 1)
#: At t = 5 s, from an independent program with 18 digits: q, v, a, x.
EXACT = np.array([-0.566053023185347031, 2.047440149690645877, -0.431440197110770576,
                  -3.340324670314635247])  # fmt: skip


def next_weight(weight, m, f, s):
    """Eq. (29): the weight of a step from that of the step before, which was s times smaller.

    The first line is the shift of the auxiliary value before the last step, in units of that step:
    the one with which `weight` makes it second order. The second is the shift after it.
    """
    before = ((1 - f) * weight - (1 - m) / 2) / (weight - (1 - m))
    shift = ((m - f) - m * before) / (1 - m) / s
    return (1 - m) * (0.5 - shift) / ((1 - f) - shift)


def plain_run(macro, updated, rho=0.8, t_end=5.0):
    """Algorithm 1 on the controlled spring-mass with steps 0.3 H, 0.7 H in turn, in plain numbers.

    m = k = 1, sigma = 0.1, b = 1.4, g_max = 1; q = 5, v = x = 0 at the start. Returns q, v, a and x
    at the end, and the weights of all steps.
    """
    am, af = (2 * rho - 1) / (rho + 1), rho / (rho + 1)
    dm, df = (3 * rho - 1) / (2 * (rho + 1)), rho / (rho + 1)
    beta, gamma, theta = 1 / (1 + rho) ** 2, 0.5 + af - am, 0.5 + df - dm
    q, v, x = 5.0, 0.0, 0.0
    a, xdot = -5.0, 7.0
    aux, auxx, last, weights = a, xdot, None, []
    for n in range(2 * round(t_end / macro)):
        h = (0.3, 0.7)[n % 2] * macro
        if updated and last is not None:
            gamma, theta = (
                next_weight(gamma, am, af, h / last),
                next_weight(theta, dm, df, h / last),
            )
        last = h
        weights.append((gamma, theta))

        # Auxiliary values at the end, and with them q and x, are base + slope * (a or xdot there).
        slope, slope_x = (1 - af) / (1 - am), (1 - df) / (1 - dm)
        base, base_x = (af * a - am * aux) / (1 - am), (df * xdot - dm * auxx) / (1 - dm)
        q0 = q + h * v + h**2 * ((0.5 - beta) * aux + beta * base)
        x0 = x + h * ((1 - theta) * auxx + theta * base_x)
        dq, dx = h**2 * beta * slope, h * theta * slope_x
        for _ in range(30):
            q, x = q0 + dq * a, x0 + dx * xdot
            force = math.tanh(x)
            motion, control = a + q - force, xdot + 0.1 * x + 1.4 * a
            coupling, own = (force**2 - 1) * dx, 1 + 0.1 * dx  # derivatives by xdot
            det = (1 + dq) * own - 1.4 * coupling
            change = (own * motion - coupling * control) / det
            change_x = ((1 + dq) * control - 1.4 * motion) / det
            a, xdot = a - change, xdot - change_x
            if max(abs(change), abs(change_x)) < 1e-14:
                break
        q, x = q0 + dq * a, x0 + dx * xdot
        v += h * ((1 - gamma) * aux + gamma * (base + slope * a))
        aux, auxx = base + slope * a, base_x + slope_x * xdot
    return np.array([q, v, a, x]), np.array(weights)


def make(cls, text):
    name, options = split_spec(text)
    return build(cls, options, name)


def our_run(macro, gamma):
    method = GeneralizedAlpha(rho_inf=0.8, gamma=gamma)
    run = method.prepare(SpringMass(), 5.0, Steps(macro, (0.3, 0.7))).measure()
    assert run.status == "ok", run.message
    return run, np.array([run.q[-1, 0], run.v[-1, 0], run.a[-1, 0], run.x[-1, 0]])


def errors(values):
    return np.abs(values - EXACT) / np.abs(EXACT)


@pytest.mark.parametrize("gamma", ["fixed", "updated"])
def test_errors_of_figure_6_agree_with_a_plain_program_of_the_recursion(gamma):
    for macro in STUDY.steps:
        plain, weights = plain_run(macro, gamma == "updated")
        run, ours = our_run(macro, gamma)
        assert errors(ours) == pytest.approx(errors(plain), abs=1e-9)
        recorded = np.column_stack([run.notes["gamma"], run.notes["theta"]])[1:11]
        assert recorded == pytest.approx(weights[:10], rel=1e-11)


def test_the_profile_shows_the_paper_s_update_beside_the_others():
    assert (STUDY.problems, STUDY.pattern, STUDY.t_end) == (["spring_mass"], (0.3, 0.7), 5.0)
    shown = [make(GeneralizedAlpha, text) for text in STUDY.integrators]
    assert shown == [GeneralizedAlpha(gamma=gamma) for gamma in ("fixed", "updated", "guarded")]


def test_a_restart_after_sharp_cuts_gives_other_errors():
    apart = [
        np.abs(errors(our_run(macro, "guarded")[1]) / errors(plain_run(macro, True)[0]) - 1).max()
        for macro in STUDY.steps[:3]
    ]
    assert min(apart) > 1e-3
