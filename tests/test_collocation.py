"""Collocation near round-off on equations whose solutions are known."""

from __future__ import annotations

import numpy as np
import pytest

from problems.collocation import Motion, TooSmallStep, gauss, integrate, radau

METHODS = {"gauss": gauss(), "radau": radau()}


def solved(rates, start, end, method, longest=1.0, tolerance=3e-14) -> tuple[Motion, int]:
    """The motion, and the number of evaluations of the rates."""
    calls = 0

    def counted(t, s):
        nonlocal calls
        calls += 1
        return rates(t, s)

    start = np.asarray(start, dtype=float)
    groups = (slice(0, len(start)),)
    return integrate(counted, start, (0.0, end), groups, method, tolerance, longest), calls


@pytest.mark.parametrize(("name", "order"), [("gauss", 24), ("radau", 23)])
def test_the_nodes_integrate_polynomials_up_to_their_order(name, order):
    m = METHODS[name]
    for power in range(order):
        assert m.weights @ m.nodes**power == pytest.approx(1 / (power + 1), abs=1e-14)
    assert abs(m.weights @ m.nodes**order - 1 / (order + 1)) > 1e-16
    assert m.integrals @ m.nodes**3 == pytest.approx(m.nodes**4 / 4, abs=1e-15)


@pytest.mark.parametrize("method", METHODS.values(), ids=METHODS)
def test_an_oscillation_is_known_to_round_off_at_all_times(method):
    motion, calls = solved(lambda t, s: np.stack([s[:, 1], -s[:, 0]], 1), [1.0, 0.0], 50.0, method)
    t = np.linspace(0.0, 50.0, 777)
    assert np.abs(motion(t) - np.stack([np.cos(t), -np.sin(t)], 1)).max() < 1e-13
    assert calls < 1000


@pytest.mark.parametrize("method", METHODS.values(), ids=METHODS)
def test_stiffness_costs_accuracy_and_steps_no_more_than_a_jacobian(method):
    # Prothero & Robinson: s' = -k (s - cos t) - sin t, and s = cos t.
    def rates(t, s, k=1e6):
        return -k * (s - np.cos(t)[:, None]) - np.sin(t)[:, None]

    motion, calls = solved(rates, [1.0], 10.0, method)
    t = np.linspace(0.0, 10.0, 333)
    assert np.abs(motion(t)[:, 0] - np.cos(t)).max() < 1e-13
    assert calls < 1000  # an explicit method takes some millions


def test_a_small_component_is_known_beside_a_large_one_and_a_kink_is_passed():
    w = np.array([1.0, 50.0])
    motion, _ = solved(
        lambda t, s: np.concatenate([s[:, 2:], -(w**2) * s[:, :2]], 1),
        [10.0, 1e-6, 0.0, 0.0], 1.0, METHODS["gauss"], longest=0.1,
    )  # fmt: skip
    t = np.linspace(0.0, 1.0, 99)
    assert np.abs(motion(t)[:, 1] / 1e-6 - np.cos(50 * t)).max() < 1e-10
    kink, _ = solved(lambda t, s: np.abs(t - np.sqrt(0.5))[:, None], [0.0], 1.0, METHODS["gauss"])
    a = np.sqrt(0.5)
    # An error below this is taken for rounding where a shorter step happens to be no better.
    assert kink(np.ones(1))[0, 0] == pytest.approx((a**2 + (1 - a) ** 2) / 2, abs=1e-11)


def test_a_solution_that_ends_is_told_with_its_time():
    with pytest.raises(TooSmallStep, match=r"no step is small enough at t=1 s|t=0\.99999"):
        solved(lambda t, s: s**2, [1.0], 2.0, METHODS["gauss"])
    with pytest.raises(TooSmallStep, match="t=0 s"):
        solved(lambda t, s: np.nan * s, [1.0], 2.0, METHODS["radau"])
