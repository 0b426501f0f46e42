"""False answers of plugins: each is a row, a missing part or a failed check that says its fault."""

from __future__ import annotations

from pathlib import Path

import false_plugins as false
import msgspec
import numpy as np
import pytest
from helpers import cell_of

from bench.check.checker import examine
from bench.check.verdicts import FAILED
from bench.plugins.registry import Registry
from bench.results.records import Record, Rows, SceneRecord
from bench.running import scene_records
from bench.running.inventory import Inventory
from bench.running.measure import invariant_changes
from bench.running.plan import Cell, ProfileFile, StudyFile, make_suite
from bench.running.worker import Worker
from integrators import Steps, checks
from problems import jnp
from problems.base.checks import MOST_SENTENCE, FalseAnswer
from problems.base.spec import snake_case
from problems.scenes.oscillators import SpringMass
from problems.truth.reference import Reference

PLUGINS = [Path(__file__).with_name("false_plugins.py")]
METHODS = {
    name: words
    for kind in (false.TRAJECTORIES, false.FACTS, false.SUPPORTS)
    for name, (*_, words) in kind.items()
}
METHODS["prepares_none"] = "prepare() is None, expected a PreparedRun with measure() and exec"


@pytest.fixture(scope="module")
def registry():
    return Registry(PLUGINS)


@pytest.fixture(scope="module")
def inventory():
    return Inventory(PLUGINS)


@pytest.fixture(scope="module")
def worker(registry):
    return Worker(registry)


def stored(kind, value):
    """The value as it is read back from a store."""
    written = msgspec.json.encode(value)
    assert msgspec.json.encode(msgspec.json.decode(written, type=kind)) == written
    return value


def row(worker, how, scene="oscillator"):
    """The record of a cell, and its rows, without errors."""
    cell = cell_of(worker.registry, scene, f"lying[how={how}]", 20.0, Steps(0.1))
    result = worker.measure(cell, errors=False)
    record, _ = stored(Record, result.record), stored(Rows, result.rows)
    assert "Traceback" not in record.message
    assert record.message.isprintable()
    assert len(record.message) < 2 * MOST_SENTENCE
    return record


def test_a_false_answer_is_a_row_and_a_failed_check_that_say_what_came(worker, registry):
    for how in METHODS:
        record = row(worker, how)
        assert record.status == "crashed"
        assert METHODS[how] in record.message
        assert record.family in ("liars", "lying")
        assert record.rows == 0
        check = "description" if how in false.FACTS or how in false.SUPPORTS else "runs"
        finding = examine(registry, "integrators", f"lying[how={how}]", check)
        assert finding.verdict == FAILED
        assert METHODS[how] in finding.text
        assert finding.text.isprintable()


def test_whatever_a_run_raises_is_a_row_and_a_false_bill_costs_the_bill(worker):
    record = row(worker, "raises_much")
    assert (record.status, "ValueError: xxxxxxxx" in record.message) == ("crashed", True)
    for how in false.BILLS:
        record = row(worker, how)
        assert (record.status, record.operations) == ("ok", {})
        assert f"No operations are known: {false.BILLS[how][1]}" in record.message


def test_what_can_be_read_is_turned_into_own_types(worker):
    for how in false.MENDED:
        record = row(worker, how)
        others = dict.fromkeys(("nan_rows_of_a_failure", "nan_rows"), "diverged")
        others |= {"times_of_a_failure_repeated": "step_too_small"}
        others |= {"half_of_the_interval": "crashed"}  # it reported success there
        assert record.status == others.get(how, "ok")
        assert {type(n) for n in record.work.values()} <= {int, type(None)}
        assert record.rows == false.ROWS - 1


def test_rows_are_not_those_of_the_plugin(worker):
    scene, mine = SpringMass(), {}

    class Kept(false.Run):
        def measure(self):
            mine["run"] = super().measure()
            return mine["run"]

    theirs = Kept("", scene, 20.0).measure()
    ours = checks.checked_trajectory(theirs, scene.sizes, 0.0, 20.0)
    for name in ("t", "q", "v", "a", "lam", "x", "xdot", "y"):
        np.testing.assert_array_equal(getattr(ours, name), getattr(theirs, name))
        assert not np.shares_memory(getattr(ours, name), getattr(theirs, name))
    assert ours.work == theirs.work
    assert ours.work is not theirs.work


def test_false_facts_cost_their_owners_cells(inventory, worker):
    for how in false.FACTS:
        study = StudyFile(problems=["oscillator"], integrators=[f"lying[how={how}]"], steps=[0.1])
        suite = make_suite("facts", ProfileFile(study=[study]), inventory)
        (facts,) = suite.plan.integrators.values()
        assert facts.orders == {}
        stored(type(suite.plan), suite.plan)
        (cell,) = suite.cells.values()
        assert false.FACTS[how][-1] in worker.measure(cell, errors=False).record.message


def test_a_false_part_of_a_scene_costs_the_part(registry, monkeypatch):
    monkeypatch.setattr(scene_records, "rates", lambda *_: None)  # they are compiled
    for name in false.SCENES:
        scene = registry.problem(snake_case(name))
        record = stored(
            SceneRecord, scene_records.scene_record(scene, 20.0, lambda: Reference(scene, 20.0))
        )
        words = false.SCENES[name][-1]
        assert any(words in fault for fault in record.faults)
        assert all(fault.isprintable() for fault in record.faults)
        assert record.sizes["nq"] == 1
        assert record.equations
        if false.SCENES[name][1] != "reference" and "coordinates" not in false.SCENES[name][0]:
            assert record.reference.t


def test_a_check_says_what_is_false_in_a_scene(registry):
    for name in false.SCENES | false.STARTS:
        _, check, words = (false.SCENES | false.STARTS)[name]
        finding = examine(registry, "problems", snake_case(name), check)
        assert finding.verdict == FAILED
        assert words in finding.text
        assert finding.text.isprintable()


def test_false_starts_energies_and_closed_forms_cost_their_part(registry, worker):
    for name in false.STARTS:
        record = row(worker, "well", snake_case(name))
        assert record.status == "crashed"
        assert false.STARTS[name][-1] in record.message
    for name in false.TIMES:
        plugin = registry.problems[snake_case(name)]
        assert plugin.cls is None
        assert false.TIMES[name][-1] in plugin.reason
    for name in ("EnergyVector", "EnergyNan"):
        record = row(worker, "well", snake_case(name))
        assert (record.status, record.energy_drift) == ("ok", None)
        assert "No energy drift is known: " in record.message
    cell = cell_of(registry, "nan", "lying[how=well]", 20.0, Steps(0.1))
    record = stored(Record, worker.measure(cell).record)
    assert (record.status, record.errors) == ("ok", {})
    assert "the reference failed: exact()['q'][0, 0] is nan, expected finite" in record.message


def test_scenes_are_turned_into_own_types(registry, inventory, monkeypatch):
    monkeypatch.setattr(scene_records, "rates", lambda *_: None)
    scene = registry.problem("numpy_step")
    record = stored(
        SceneRecord, scene_records.scene_record(scene, 20.0, lambda: Reference(scene, 20.0))
    )
    assert type(scene.nominal_step) is float
    assert (record.tags, record.faults) == (["smooth"], [])
    facts = inventory.problem("numpy_step"), inventory.integrator("lying")
    cell = Cell(*facts, 20.0, Steps(np.float64(0.1), (np.float64(1.0),)))
    stored(Record, cell.record("ok"))
    assert "np." not in cell.key
    assert cell.record("crashed", "\x1b[31m\n").message == "\N{REPLACEMENT CHARACTER}[31m"
    liar = inventory.integrator("lying[how=orders_half]")
    assert Cell(facts[0], liar, 20.0, Steps(0.1)).record("ok").status == "crashed"


def test_an_energy_that_is_lost_in_motion_is_false():
    lost = {"energy": lambda self, q, v: jnp.where(v[0] == 0.0, q[0], jnp.nan)}
    scene = false.scene_class("EnergyLost", lost)()
    run = false.honest(scene, 20.0)
    assert set(invariant_changes(scene, run)) == {"energy"}
    run.v = run.v + 1.0
    with pytest.raises(FalseAnswer, match=r"energy\(\) of the rows\[0\] is nan"):
        invariant_changes(scene, run)
