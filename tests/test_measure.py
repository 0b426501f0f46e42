"""Stored rows of a trajectory: reading them back, and their violations of the equations."""

from types import MappingProxyType

import numpy as np
import pytest
from helpers import long, toy
from small_stores import a_record

from bench.results.quantities import GROUPS, NORMS
from bench.results.store import Store
from bench.running.errors import norms, relative_errors
from bench.running.measure import invariant_changes, stored_rows, violations
from bench.running.scene_records import rates
from integrators import Steps, Tolerances
from integrators.adapters.diffrax_methods import Kvaerno3
from integrators.adapters.ida import IDA
from integrators.adapters.scipy_ode import Radau
from integrators.contract import Trajectory
from integrators.methods.generalized_alpha import GeneralizedAlpha
from integrators.methods.generalized_alpha_adaptive import GeneralizedAlphaAdaptive
from problems import MechatronicSystem
from problems.scenes.oscillators import SpringMass
from problems.scenes.pendulums import Pendulum
from problems.truth.reference import Reference
from problems.variables import Component, Sizes

TIMES = np.linspace(0.0, 0.4, 5)


def histories(scene: MechatronicSystem, run: Trajectory) -> dict[str, np.ndarray]:
    """All that a run violates."""
    change = invariant_changes(scene, run)
    return violations(scene, run) | {name: abs(values) for name, values in change.items()}


def trajectory(**changes: np.ndarray) -> Trajectory:
    """Five rows of one coordinate and two outputs, without constraints and controller."""
    sizes = {"q": 1, "v": 1, "a": 1, "lam": 0, "x": 0, "xdot": 0, "y": 2}
    rows = {name: np.ones((5, n)) * TIMES[:, None] for name, n in sizes.items()}
    return Trajectory(**{"t": TIMES, **rows, **changes}, status="diverged")


def test_rows_end_before_the_first_that_is_not_finite_and_can_be_read_back(tmp_path):
    for group in ["t", "q", "y"]:
        for bad in [np.inf, -np.inf, np.nan]:
            whole = vars(trajectory())[group].copy()
            whole.reshape(5, -1)[3, -1] = bad
            rows = stored_rows(trajectory(**{group: whole}))
            assert rows.t == TIMES[:3].tolist()
            assert {len(values) for values in rows.values.values()} == {3}
            with Store(tmp_path, create=True) as store:
                store.save(a_record(status="diverged"), rows)
                assert store.rows("k") == rows


def test_a_finite_trajectory_is_kept_whole_and_nothing_is_left_without_rows_or_numbers():
    rows = stored_rows(trajectory())
    assert (rows.t, set(rows.values)) == (TIMES.tolist(), {"q", "v", "a", "y"})
    assert rows.values["y"] == [[t, t] for t in TIMES]
    assert stored_rows(Trajectory.failed("unsupported", "no")).t == []
    lost = stored_rows(trajectory(v=np.full((5, 1), np.nan)))
    assert lost.t == []
    assert not any(lost.values.values())
    whole = {name: np.ones((5, 1)) for name in (*GROUPS, "xdot")}  # as of a reference
    assert set(stored_rows({"t": TIMES} | whole).values) == set(whole)


def test_histories_are_what_each_row_violates():
    scene = Pendulum()
    t = np.linspace(*scene.interval, 5)
    exact = scene.exact(t)
    empty = {name: np.zeros((5, 0)) for name in ("x", "xdot", "y")}
    found = histories(scene, Trajectory(t=t, **exact, **empty))
    assert set(found) == {"position", "velocity", "acceleration", "energy"}
    assert all(values.max() < 1e-12 for values in found.values())
    stretched = exact | {"q": exact["q"] * np.array([1, 1, 1.1, 1, 1])[:, None]}
    found = histories(scene, Trajectory(t=t, **stretched, **empty))
    assert found["position"][2] == pytest.approx(0.5 * (1.1**2 - 1))
    assert found["position"][[0, 1, 3, 4]].max() < 1e-12
    kinetic = 0.5 * scene.m * (exact["v"] ** 2).sum(axis=1)
    lifted = scene.m * scene.g * 0.1 * exact["q"][2, 1]
    assert found["energy"][2] == pytest.approx(abs(lifted) / kinetic.max())
    assert histories(SpringMass(), trajectory()) == {}


def test_norms_are_those_worked_out_by_hand_at_unequal_times():
    t = np.array([0.0, 1.0, 2.5, 3.0, 3.5, 4.0])
    sizes = np.array([[4.0, 2.0, 9.0, 1.0, 3.0, 2.0]])
    found = {name: norm(sizes).tolist() for name, norm in norms(t).items()}
    # The last quarter begins at t = 3: the 9 at t = 2.5 belongs to the last half alone.
    # Trapezoids of the squares 16, 4, 81, 1, 9, 4: 10 + 63.75 + 20.5 + 2.5 + 3.25 = 100, over 4 s.
    assert found == {"end": [2.0], "max": [9.0], "rms": [5.0], "settled": [3.0]}


class Known(Reference):
    """A reference with three rows of two coordinates, and some errors of its own."""

    exact = np.array([[3.0, 4.0], [0.0, 10.0], [8.0, 0.0]])  # norms 5, 10, 8
    error = MappingProxyType({"q": np.array([1e-3, 4e-3])})

    def __call__(self, t):
        none = dict.fromkeys(GROUPS, np.zeros((len(t), 0)))
        return none | {"q": self.exact}

    @property
    def largest(self):
        none = dict.fromkeys(GROUPS, (np.zeros(0), 0.0))
        largest = np.abs(self.exact).max(axis=0), np.linalg.norm(self.exact, axis=1).max()
        return none | {"q": largest}


class Named(MechatronicSystem):
    """Two coordinates without equations; only their names matter."""

    coordinates = ("x [m]", "y [m]")
    sizes = Sizes(2, 2, 0, 0, 0, 0)


class Scaled(Named):
    coordinates = ("x [m]", "y [m] ~ 0.5")


def errors_of(scene, off):
    run = trajectory(t=np.array([0.0, 1.0, 4.0]), q=Known.exact + np.array(off))
    return relative_errors(run, Known(scene, 4.0))


def test_a_group_is_judged_by_its_worst_component_and_every_norm_has_one_denominator():
    errors, floors, components, histories = errors_of(
        Named(), [[0.0, 0.0], [3.0, 4.0], [0.0, -2.0]]
    )
    # The largest values of the components are 8 and 10, that of the norm is 10.
    assert components["q"]["max"] == [3 / 8, 4 / 10]
    assert components["q"]["end"] == [0.0, 2 / 10]
    assert errors["q"] == {
        "max": 4 / 10,
        "end": 2 / 10,
        "settled": 2 / 10,
        # Trapezoids of the squares over 4 s: x 9/2 + 3*9/2 = 18, y 16/2 + 3*(16+4)/2 = 38.
        "rms": pytest.approx(max(np.sqrt(18 / 4) / 8, np.sqrt(38 / 4) / 10), rel=1e-15),
    }
    # At each row the worst component counts, whichever it is there.
    assert histories["error_q"].tolist() == [0.0, max(3 / 8, 4 / 10), 2 / 10]
    # Norms of the differences: 0, 5, 2.
    assert errors["|q|"] == {
        "max": 5 / 10,
        "end": 2 / 10,
        "settled": 2 / 10,
        "rms": pytest.approx(np.sqrt((25 / 2 + 3 * 29 / 2) / 4) / 10, rel=1e-15),
    }
    assert floors["q"] == dict.fromkeys(NORMS, pytest.approx(4e-3 / 10, rel=1e-15))
    assert floors["|q|"]["end"] == pytest.approx(np.sqrt(17) * 1e-3 / 10, rel=1e-15)


def test_a_component_is_measured_by_its_natural_size_or_its_largest_value(monkeypatch):
    errors, floors, components, _ = errors_of(Scaled(), [[0.0, 0.0], [3.0, 0.01], [0.0, -0.02]])
    assert components["q"]["max"] == [3 / 8, 0.02 / 0.5]
    assert (errors["q"]["max"], errors["q"]["end"]) == (3 / 8, 0.02 / 0.5)
    assert floors["q"]["max"] == 4e-3 / 0.5
    # One that hardly moves is measured by its group, up to a millionth of that.
    for largest, size in [(1e-9, 10.0), (0.9e-5, 10.0), (1.1e-5, 1.1e-5)]:
        monkeypatch.setattr(Known, "exact", np.array([[10.0, largest], [0.0, 0.0], [1.0, 0.0]]))
        components = errors_of(Named(), [[0.0, 1e-6], [0.0, 0.0], [0.0, 0.0]]).components
        assert components["q"]["max"] == [0.0, pytest.approx(1e-6 / size)]
    monkeypatch.setattr(Known, "exact", np.zeros((3, 2)))  # of a group that vanishes: absolute
    errors, floors, components, _ = errors_of(Named(), [[0.0, 0.0], [3.0, 4.0], [0.0, -2.0]])
    assert components["q"]["max"] == [3.0, 4.0]
    assert (errors["q"]["max"], errors["|q|"]["max"], floors["q"]["max"]) == (4.0, 5.0, 4e-3)


def test_components_have_the_units_of_their_coordinates_by_time():
    assert [c.text for c in Named().components("v")] == ["x [m/s]", "y [m/s]"]
    assert [c.text for c in Scaled().components("a")] == ["x [m/s^2]", "y [m/s^2]"]
    assert [c.scale for c in Scaled().components("q")] == [None, 0.5]
    assert Scaled().components("v")[1].scale is None
    assert Component.read("q [m] ~ 2, 3").rate().scale == 3
    assert Component.read("p").rate().text == "p"
    assert [c.text for c in Pendulum(copies=2).components("lam")] == ["rod [N/m]", "2"]


@pytest.mark.parametrize(
    "cases",
    [
        ((GeneralizedAlpha(), Steps(2.0 / 1500)),),
        *long(
            [
                (GeneralizedAlphaAdaptive(), Tolerances(3e-5)),
                (Kvaerno3(), Tolerances(1e-9)),
                (Radau(), Tolerances(1e-9)),
                (IDA(), Tolerances(1e-9)),
            ]
        ),
    ],
)
def test_errors_are_largest_over_all_steps_and_few_rows_are_stored(cases):
    for method, resolution in cases:
        scene = Pendulum()
        run = method.prepare(scene, 2.0, resolution).measure()
        assert run.work.steps == len(run.t) - 1 > 300
        assert (np.diff(run.t) > 0).all()
        stored = stored_rows(run)
        assert len(stored.t) < 240
        reference = Reference(scene, 2.0)
        _, _, components, histories = relative_errors(run, reference)
        worst = np.abs(run.a - reference(run.t)["a"]).max(axis=0) / np.abs(
            reference.largest["a"][0]
        )
        assert components["a"]["max"] == pytest.approx(worst, rel=1e-12)
        run.notes |= histories
        kept = stored_rows(run)
        assert kept.t == stored.t
        exact = [histories["error_a"][np.searchsorted(run.t, t)] for t in kept.t]
        assert kept.notes["error_a"] == pytest.approx(exact, rel=5e-3)
        assert max(len(f"{value:g}") for value in kept.notes["error_a"]) <= len("1.23e-05")


ALONG = np.array([np.cos(1.0) - np.sin(1.0), np.sin(1.0) + np.cos(1.0)])
#: Two masses of 1 kg on a spring of 2 N/m, free to drift, in coordinates turned by 1 rad.
FreePair = toy(
    "FreePair", q=[0.3, 0.1], v=[0.7, -0.2], interval=(0.0, 1.0), nominal_step=0.1,
    force=lambda self, q, v, t: -2.0 * ALONG * (ALONG @ q),
)  # fmt: skip


def test_a_zero_eigenvalue_up_to_rounding_is_no_slow_rate():
    # The pair swings at sqrt(k/m + k/m) = 2 rad/s. Its drift is a double zero, of which rounding
    # makes two small numbers.
    scene = FreePair()
    found = rates(scene, Reference(scene, 1.0))
    assert found["slowest"] == pytest.approx(2.0, rel=1e-9)
    assert found["fastest"] == pytest.approx(2.0, rel=1e-9)
