"""Notes on runs that reach the end: accelerations that nothing controls, orders that are lost."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import long, reference
from planted import everything

from bench.plugins.registry import Registry
from bench.results.records import Record, endings
from bench.running.linearisation import uncontrolled
from bench.running.plan import Cell
from bench.running.worker import Worker
from integrators import Steps, Tolerances, Trajectory
from integrators.checks import caution
from integrators.methods.hht_i3 import HHTI3
from problems.base.checks import FalseAnswer
from problems.scenes.oscillators import DrivenSprings
from problems.scenes.pendulums import DoublePendulum, Pendulum, StiffBar
from problems.scenes.slider_crank import SliderCrank, SliderCrankMinimal
from reports.tables.run_tables import notes_table


def exact_run(scene, steps: int, part: float = 1.0) -> Trajectory:
    """The exact motion at equal steps over a part of the interval."""
    t0, t_end = scene.interval
    t_end = t0 + part * (t_end - t0)
    t = np.linspace(t0, t_end, steps + 1)
    values = reference(scene, t_end)(t)
    return Trajectory(
        t, **{group: values[group] for group in ("q", "v", "a", "lam", "x", "xdot", "y")}
    )


@pytest.mark.parametrize(
    "cases", [((Pendulum(), 30),), *long([(SliderCrank(), 200), (DoublePendulum(), 50)])]
)
def test_a_motion_without_fast_vibrations_has_no_note(cases):
    for rtol in [0.3, 1e-3]:
        for scene, steps in cases:
            assert uncontrolled(scene, exact_run(scene, steps), rtol) == ""


def test_a_vibration_that_v_hides_is_told_until_the_tolerance_sees_its_phase():
    """18124 rad/s in 10 s are 28 845 periods; v is 7.72 m/s and dv/dt, averaged, 19.6 m/s^2."""
    for rtol, speaks in [(1e-3, True), (1e-6, True), (1e-8, True), (1e-11, False)]:
        note = uncontrolled(StiffBar(), exact_run(StiffBar(), 1000), rtol)
        assert bool(note) == speaks
        assert not speaks or ("1.81e+04 rad/s" in note and "smaller rtol" in note)
        assert not speaks or "a step spans 29 periods of the fastest vibration" in note


def test_constant_steps_of_more_than_half_a_period_leave_it_out():
    for h, speaks in [(1e-2, True), (1.8e-4, True), (1.6e-4, False)]:
        note = uncontrolled(StiffBar(), exact_run(StiffBar(), round(0.1 / h), 0.01), None)
        assert bool(note) == speaks
        assert not speaks or "smaller steps" in note


def test_rows_of_a_long_run_are_further_apart_than_its_steps():
    run = exact_run(StiffBar(), 100, 0.01)
    assert uncontrolled(StiffBar(), run, None) != ""
    run.work.steps = 1000
    assert uncontrolled(StiffBar(), run, None) == ""


def test_a_vibration_that_dies_out_adds_up_no_longer():
    """Of 5000 periods of the spring 3.4 are over when it has fallen to 1/e; the natural size of a
    is 1.44 m/s^2, not that of the jolt at the start."""
    for rtol, speaks in [(1e-5, True), (1e-7, False)]:
        note = uncontrolled(DrivenSprings(), exact_run(DrivenSprings(), 1000), rtol)
        assert bool(note) == speaks
        assert not speaks or "3.16e+03 rad/s" in note


@pytest.fixture(scope="module")
def worker() -> Worker:
    return Worker(Registry())


def measured(worker: Worker, scene: str, method: str, t_end: float, resolution) -> Record:
    record = worker.measure(Cell(scene, method, t_end, resolution)).record
    assert record.status == "ok", record.message
    return record


@pytest.mark.parametrize(
    "cases",
    [
        (("rodas5p", 1e-4),),
        *long(
            [
                ("radau_iia", 1e-4),
                ("generalized_alpha_adaptive", 1e-3),
                ("bdf_adaptive", 1e-3),
                ("hht_i3", 1e-4),
                ("ida", 1e-2),
                ("cvode", 1e-2),
                ("kvaerno5", 1e-2),
                ("radau", 1e-2),
            ]
        ),
    ],
)
def test_every_method_with_a_tolerance_says_so(worker, cases):
    for method, rtol in cases:
        record = measured(worker, "stiff_bar", method, 0.1, Tolerances(rtol))
        assert "Accelerations are not controlled" in record.message
        assert record.error("a", "max") > 0.1  # the note is true
        assert record.notes[0] == record.message
        assert record.notes[-1].startswith("Errors above 0.1")


def test_the_published_mix_of_forces_says_that_it_loses_its_order_where_the_mass_varies():
    varying, forces = SliderCrankMinimal(), HHTI3(mixed="forces")
    assert "order 1 here, not 2" in (forces.caution(varying) or "")
    assert forces.caution(Pendulum()) is None
    assert HHTI3().caution(varying) is None


@pytest.mark.long
def test_a_caution_is_a_note_of_a_run(worker):
    cell = "slider_crank_minimal", "hht_i3[mixed=forces,steps=constant]", 0.1, Steps(0.01)
    assert "take mixed=accelerations" in measured(worker, *cell).message


def test_a_caution_is_none_or_a_sentence():
    class Odd(HHTI3):
        def caution(self, scene):
            return ""

    with pytest.raises(FalseAnswer, match="caution"):
        caution(Odd(), Pendulum())


def test_errors_above_a_tenth_are_a_note_and_those_of_failed_runs_are_none():
    record = everything()[0]
    record.status, record.message, record.errors = (
        "ok",
        "",
        {"q": {"max": 0.11}, "v": {"max": 0.09}},
    )
    record.claims, record.rtol = {"q": 2}, None
    (note,) = record.notes
    assert note.endswith(": q 0.11; its steps are too large for order 2.")
    record.rtol = 1e-4
    assert record.notes[0].endswith("; the error of q is 1.1e+03 times rtol.")
    record.status = "diverged"
    assert record.notes == []


def test_runs_with_a_note_are_counted_and_listed():
    noted, other = everything()[:2]
    noted.status = other.status = "ok"
    noted.message, other.message = "It may be wrong.", ""
    assert endings([noted, other]) == "2 ok (1 with a note), 0 failed with a reason"
    table = notes_table([noted, noted, other])
    assert table is not None
    assert [row[2:] for row in table.rows] == [["2", "It may be wrong."]]
    assert notes_table([other]) is None
