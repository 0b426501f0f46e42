"""The references against published digits and against the equations they solve."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import toy

from bench.plugins.registry import Sources
from bench.running import inventory
from problems import SampledSystem, held, jnp, parameter
from problems.scenes.oscillators import SpringMass
from problems.scenes.pendulums import Pendulum
from problems.scenes.planar_truck import PlanarTruck, PlanarTruckJoint
from problems.truth import reference
from problems.truth.collocation import Motion, TooSmallStep, gauss, integrate, radau
from problems.truth.reference import Reference

# t, q, v, a, x, xdot of the controlled spring-mass with the parameters of Bruels & Arnold
# (2008), computed independently in extended precision.
DIGITS = [
    (1, 3.074511887288059853, -3.435146307218303886, -2.074735700581933216,
     4.548866815408162130, 2.449743299273890289),
    (5, -0.566053023185347031, 2.047440149690645877, -0.431440197110770576,
     -3.340324670314635247, 0.938048742986542331),
    (10, -0.335893500667447607, -0.105174039199964112, 0.179186713288789428,
     -0.158008776105379490, -0.235060520993767251),
    (20, -0.108891845422092386, 0.012641312917356572, -0.001205427254579633,
     -0.110545380949083926, 0.012742136251319878),
]  # fmt: skip


def test_the_spring_mass_reference_has_the_published_digits():
    reference = Reference(SpringMass(), 20.0)
    values = reference(np.array([row[0] for row in DIGITS], dtype=float))
    ours = np.column_stack([values[g][:, 0] for g in ("q", "v", "a", "x", "xdot")])
    wanted = np.array([row[1:] for row in DIGITS])
    assert ours == pytest.approx(wanted, abs=2e-12)
    # The stated error covers what is really there, and is small enough to judge 1e-9 by.
    worst = np.abs(ours - wanted).max(axis=0)
    for error, group in zip(worst, ("q", "v", "a", "x"), strict=False):
        assert error <= 2 * reference.error[group] < 1e-11


#: A fast vibration of 1 um beside a slow one of 10 m.
Beside = toy(
    "Beside", q=[10.0, 1e-6], interval=(0.0, 0.2), nominal_step=0.05,
    force=lambda self, q, v, t: -jnp.array([1.0, 2500.0]) * q,
)  # fmt: skip


def test_the_reference_knows_small_components_beside_large_ones():
    t, reference = np.linspace(0.0, 0.2, 50), Reference(Beside(), 0.2)
    small = np.abs(reference(t)["q"][:, 1] / 1e-6 - np.cos(50.0 * t)).max()
    assert small <= 2 * reference.error["q"][1] / 1e-6 < 1e-9


def test_a_kept_reference_is_read_and_a_spoilt_one_made_anew(tmp_path, monkeypatch):
    file, made, make = tmp_path / "references" / "beside", [], Reference._integrated
    monkeypatch.setattr(reference, "_file_of", lambda scene, t_end: file)
    monkeypatch.setattr(Reference, "_integrated", lambda self: made.append(1) or make(self))
    t = np.linspace(0.0, 0.2, 9)
    first = Reference(Beside(), 0.2)
    values, error, largest = first(t), first.error, first.largest
    content = file.read_bytes()
    again = Reference(Beside(), 0.2)
    assert all(np.array_equal(again(t)[g], values[g]) for g in ("q", "v", "a"))
    assert all(np.array_equal(again.error[g], error[g]) for g in error)
    assert all(np.array_equal(again.largest[g][0], largest[g][0]) for g in largest)
    assert len(made) == 1
    spoilt = bytearray(content)
    spoilt[len(spoilt) // 2] ^= 1
    file.write_bytes(spoilt)
    assert np.array_equal(Reference(Beside(), 0.2)(t)["q"], values["q"])
    assert len(made) == 2
    assert file.read_bytes() == content
    # Without a folder for it nothing is kept, and nothing fails.
    monkeypatch.setattr(reference, "_file_of", lambda scene, t_end: file / "below")
    assert np.array_equal(Reference(Beside(), 0.2)(t)["q"], values["q"])


def test_processes_without_plugins_keep_references_of_scenes_in_the_registry(monkeypatch):
    given = []
    monkeypatch.setattr(inventory, "keep_references", given.append)
    inventory.load_registry(lambda *phase: None, Sources())
    (file_of,) = given
    files = [file_of(Pendulum(m=m), t_end) for m, t_end in ((1.0, 1.0), (2.0, 1.0), (2.0, 2.0))]
    assert len(set(files)) == 3
    assert file_of(Pendulum(m=2.0), 2.0) == files[2]
    assert file_of(Beside(), 0.2) is None
    monkeypatch.setattr(inventory, "Registry", lambda *_: None)
    inventory.load_registry(lambda *phase: None, Sources({"mine.py"}))
    assert given[1](Pendulum(), 1.0) is None


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


def test_the_nodes_integrate_polynomials_up_to_their_order():
    for name, order in [("gauss", 24), ("radau", 23)]:
        m = METHODS[name]
        for power in range(order):
            assert m.weights @ m.nodes**power == pytest.approx(1 / (power + 1), abs=1e-14)
        assert abs(m.weights @ m.nodes**order - 1 / (order + 1)) > 1e-16
        assert m.integrals @ m.nodes**3 == pytest.approx(m.nodes**4 / 4, abs=1e-15)


def test_oscillations_and_stiff_motions_are_known_to_round_off_at_all_times():
    # Prothero & Robinson: s' = -k (s - cos t) - sin t, and s = cos t.
    def stiff(t, s, k=1e6):
        return -k * (s - np.cos(t)[:, None]) - np.sin(t)[:, None]

    for method in METHODS.values():
        for rates, start, end in (
            (lambda t, s: np.stack([s[:, 1], -s[:, 0]], 1), [1.0, 0.0], 50.0),
            (stiff, [1.0], 10.0),
        ):
            motion, calls = solved(rates, start, end, method)
            t = np.linspace(0.0, end, 777)
            exact = np.stack([np.cos(t), -np.sin(t)], 1)[:, : len(start)]
            assert np.abs(motion(t) - exact).max() < 1e-13
            assert calls < 1000  # an explicit method takes some millions where it is stiff


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


@pytest.mark.long
@pytest.mark.parametrize("truck", [PlanarTruckJoint(), PlanarTruck()], ids=str)
def test_forces_in_balance_leave_rounding_that_is_no_size_of_the_motion(truck):
    ours = Reference(truck, 5.0)
    assert max(np.max(ours.error[group]) for group in "qv") < 1e-12
    (q,) = (published for published in truck.published if published.quantity == "q")
    assert ours(np.array([q.t]))["q"][0] == pytest.approx(q.values, abs=1e-10)


def hold(self, z):
    q, v = z.q[0], z.v[0]
    return {"u": 9.81 * jnp.cos(q) - 3600.0 * (q - 0.5) - 120.0 * v}


#: A pendulum that a sampled controller holds against its weight, almost at rest.
Resting = toy(
    "Resting", base=SampledSystem, interval=(0.0, 0.02), nominal_step=0.002,
    sample_time=parameter(0.0005, "s", "time between two samples", low=1e-6),
    u=held(0.0, "N m", "torque"), sample=hold, mass=lambda self, q: jnp.eye(1),
    initial_state=toy(q=[0.5 + 1e-9]).initial_state,
    force=lambda self, q, v, t: jnp.stack([self.u]) - 9.81 * jnp.cos(q),
)  # fmt: skip


def test_where_a_sampled_loop_rests_steps_do_not_follow_the_rounding_of_its_forces():
    phases = Reference(Resting(), 0.02)._integrate(0)
    assert len(phases.held) == 40
    # Between samples a step goes on as it was: most phases are a single one.
    assert len(phases.motion.series) <= 45
    # So near 0.5 the equations are linear: d'' = w^2 d + a with another constant a at each sample.
    h, w, d, v = 0.0005, np.sqrt(9.81 * np.sin(0.5)), 1e-9, 0.0
    c, s = np.cosh(w * h), np.sinh(w * h)
    for _ in range(40):
        a = -3600.0 * d - 120.0 * v
        d, v = d + a / w**2 * (c - 1) + v / w * s, a / w * s + v * c
    # Each phase rounds q at 0.5, which the controller answers.
    assert phases.motion(np.array([0.02]))[0] == pytest.approx([0.5 + d, v], abs=1e-12)
