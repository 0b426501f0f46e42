"""`stepbench drift`: what drifts off in long runs."""

from __future__ import annotations

import csv
import io
import json

import pytest
from helpers import long
from planted import Document

from bench.plugins.registry import Registry
from bench.running.drift import drift_job
from bench.running.worker import Worker
from problems.spec import SpecError

#: The step of the oscillator at omega h = 0.2 pi, and the trapezoidal rule's period error there.
H, PERIOD_ERROR = 0.6283185307179586, 0.03207491062


@pytest.fixture(scope="module")
def worker():
    return Worker(Registry([]))


@pytest.mark.parametrize(
    ("method", "energy", "within"),
    # A damping ratio of 1.572715e-4 over 1215.5 rad leaves exp(-0.3823) of the energy.
    [("newmark", 0.0, 1e-11), *long(("generalized_alpha", 0.3177, 5e-3))],
)
def test_phase_and_energy_of_the_oscillator_follow_the_spectrum(worker, method, energy, within):
    found = drift_job(worker, "oscillator", method, H, 2000)
    assert (found["status"], found["steps"]) == ("ok", 2000)
    drifts = found["drifts"]
    assert drifts["energy"]["largest"] == pytest.approx(energy, abs=within)
    if method == "newmark":
        # The period is longer by this part, so that the run falls behind.
        wanted = 1 / (1 + PERIOD_ERROR) - 1
        assert drifts["phase"]["per_s"] == pytest.approx(wanted, rel=1e-6)
        assert drifts["phase"]["largest"] == pytest.approx(-wanted * 2000 * H, rel=1e-3)
    assert max(map(len, found["rows"].values())) < 500


@pytest.mark.long
def test_projection_ends_the_drift_of_constraints(worker):
    drifts, held = (
        drift_job(worker, "pendulum", f"kvaerno3[constraints={name}]", 0.02, 2000)["drifts"]
        for name in ("index1", "projected")
    )
    for name in ("position", "velocity"):
        assert drifts[name]["largest"] > 1e-6 > 1e-14 > held[name]["largest"]
    assert drifts["position"]["per_s"] > 1e-8


def test_rows_do_not_grow_with_the_steps(worker):
    found = drift_job(worker, "oscillator", "newmark", 0.1, 40_000)
    assert found["steps"] == 40_000
    assert len(found["rows"]["t"]) < 500
    assert found["rows"]["t"][-1] == pytest.approx(4000.0)


def test_a_method_without_constant_steps_is_refused(worker):
    with pytest.raises(SpecError, match="chooses its own steps"):
        drift_job(worker, "oscillator", "radau", None, 100)


@pytest.mark.long
def test_the_command_prints_json_and_writes_a_page(stepbench, tmp_path):
    line = ["drift", "oscillator", "newmark", "--steps", 300, "--out", tmp_path, "--json"]
    result = stepbench(*line)
    assert result.exit_code == 0, result.output
    (found,) = json.loads(result.stdout)
    assert found["drifts"]["energy"]["largest"] < 1e-12
    page = (tmp_path / "drift.html").read_text()
    assert "<svg" in page
    assert "phase in s" in Document(page).words


@pytest.mark.long
def test_a_run_that_fails_is_told_beside_the_others(stepbench):
    names = "generalized_alpha[rho_inf=1]", "bdf2"
    line = "drift", "pendulum", *names, "--step", 0.02, "--steps", 300
    result = stepbench(*line, "--csv")
    assert result.exit_code == 1
    rows = list(csv.DictReader(io.StringIO(result.stdout)))
    assert [row["status"] == "ok" for row in rows] == [False, True]
    assert "generalized_alpha[rho_inf=1.0]: newton_failed" in result.stderr
    assert "bdf2" in stepbench(*line).stdout


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (["newmark", "newmark"], "named twice"),
        (["newmark", "--step", "-1"], "not allowed"),
        (["newmark", "--step", "1e306"], "end time"),
        (["newmark", "--steps", "1"], "range"),
        (["nomark"], "newmark"),
    ],
)
@pytest.mark.usefixtures("without_processes")
def test_wrong_input_is_refused_in_a_sentence(stepbench, more, words):
    result = stepbench("drift", "oscillator", *more)
    assert result.exit_code != 0
    assert words in result.stderr
