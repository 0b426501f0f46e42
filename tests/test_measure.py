"""What is kept of a trajectory: rows that can be read back, and what they violate."""

from __future__ import annotations

import numpy as np
import pytest

from bench.results.quantities import GROUPS
from bench.results.records import Record
from bench.results.store import Store
from bench.running.measure import histories, rows_of
from integrators.contract import Trajectory
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
