"""Stored rows of a trajectory: reading them back, and their violations of the equations."""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
import pytest

from bench.results.quantities import GROUPS
from bench.results.records import Record
from bench.results.store import Store
from bench.running.measure import histories, norms, relative_errors, rows_of
from bench.running.scene_records import rates
from integrators.contract import Trajectory
from problems import MechatronicSystem, State, jnp
from problems.reference import Reference
from problems.scenes.pendulum import Pendulum
from problems.scenes.spring_mass import SpringMass

TIMES = np.linspace(0.0, 0.4, 5)


def trajectory(**changes: np.ndarray) -> Trajectory:
    """Five rows of one coordinate and two outputs, without constraints and controller."""
    sizes = {"q": 1, "v": 1, "a": 1, "lam": 0, "x": 0, "xdot": 0, "y": 2}
    rows = {name: np.ones((5, n)) * TIMES[:, None] for name, n in sizes.items()}
    return Trajectory(**{"t": TIMES, **rows, **changes}, status="diverged")


def test_a_finite_trajectory_is_kept_whole():
    rows = rows_of(trajectory())
    assert rows.t == TIMES.tolist()
    assert set(rows.values) == {"q", "v", "a", "y"}
    assert rows.values["y"] == [[t, t] for t in TIMES]


@pytest.mark.parametrize("bad", [np.inf, -np.inf, np.nan])
@pytest.mark.parametrize("group", ["t", "q", "y"])
def test_rows_end_before_the_first_that_is_not_finite_and_can_be_read_back(tmp_path, group, bad):
    whole = vars(trajectory())[group].copy()
    whole.reshape(5, -1)[3, -1] = bad
    rows = rows_of(trajectory(**{group: whole}))
    assert rows.t == TIMES[:3].tolist()
    assert {len(values) for values in rows.values.values()} == {3}
    record = Record(
        key="k",
        problem="p",
        integrator="i",
        family="f",
        formulation="ode",
        controls="step",
        h=0.1,
        t0=0.0,
        t_end=0.4,
        status="diverged",
    )
    with Store(tmp_path, create=True) as store:
        store.save(record, rows)
        assert store.rows("k") == rows


def test_nothing_is_left_of_a_run_without_rows_or_without_numbers():
    assert rows_of(Trajectory.failed("unsupported", "no")).t == []
    lost = rows_of(trajectory(v=np.full((5, 1), np.nan)))
    assert lost.t == []
    assert not any(lost.values.values())


def test_the_values_of_a_reference_are_rows_too():
    values = {name: np.ones((5, 1)) for name in (*GROUPS, "xdot")}
    rows = rows_of({"t": TIMES} | values)
    assert rows.t == TIMES.tolist()
    assert set(rows.values) == set(values)


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


def test_errors_are_relative_in_each_norm_by_itself():
    t = np.array([0.0, 1.0, 4.0])
    exact = np.array([[3.0, 4.0], [0.0, 10.0], [8.0, 0.0]])  # sizes 5, 10, 8
    off = np.array([[0.0, 0.0], [3.0, 4.0], [0.0, -2.0]])  # sizes 0, 5, 2

    class Known:
        error = MappingProxyType({"q": 1e-3})

        def __call__(self, at):
            none = dict.fromkeys(GROUPS, np.zeros((len(at), 0)))
            return none | {"q": exact}

    run = trajectory(t=t, q=exact + off)
    errors, floors = relative_errors(run, Known())
    assert errors["q"]["end"] == 2 / 8
    assert errors["q"]["max"] == 5 / 10
    assert errors["q"]["settled"] == 2 / 8
    # Trapezoids of the squares: (0 + 25)/2 + 3 (25 + 4)/2 = 56 and (25 + 100)/2 + 3 (100 + 64)/2.
    assert errors["q"]["rms"] == pytest.approx(np.sqrt(56 / 308.5), rel=1e-15)
    assert floors["q"]["max"] == 1e-3 / 10


@dataclass(frozen=True)
class FreePair(MechatronicSystem):
    """Two masses of 1 kg on a spring of 2 N/m, free to drift, in coordinates turned by 1 rad."""

    interval = (0.0, 1.0)
    nominal_step = 0.1

    def mass(self, q):
        return jnp.eye(2)

    def force(self, q, v, t):
        along = jnp.array([np.cos(1.0) - np.sin(1.0), np.sin(1.0) + np.cos(1.0)])
        return -2.0 * along * (along @ q)

    def initial_state(self):
        return State(q=np.array([0.3, 0.1]), v=np.array([0.7, -0.2]))


def test_a_zero_eigenvalue_up_to_rounding_is_no_slow_rate():
    # The pair swings at sqrt(k/m + k/m) = 2 rad/s. Its drift is a double zero, of which rounding
    # makes two small numbers.
    scene = FreePair()
    found = rates(scene, Reference(scene, 1.0))
    assert found["slowest"] == pytest.approx(2.0, rel=1e-9)
    assert found["fastest"] == pytest.approx(2.0, rel=1e-9)
