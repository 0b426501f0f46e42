"""What is said of precisions: tables, slopes, and the command."""

from __future__ import annotations

import csv
import json

import pytest
from helpers import slope

from bench.results.precision import PrecisionRun, precision_sentences, takeovers


# ---- what is said ------------------------------------------------------------------------
def planted(precision, h, **errors):
    return PrecisionRun(
        problem="pendulum", integrator="newmark", precision=precision, h=h, steps=10,
        status="ok" if errors else "newton_failed", message="", errors=errors,
    )  # fmt: skip


def curves():
    steps = [0.08, 0.04, 0.02, 0.01]
    double = [planted("double", h, q=h**2, lam=h) for h in steps]
    # lam: 1e-4/h^2 beats the method, h, from 0.04 down; at 0.08 it is a fifth of it.
    single_ = [planted("single", h, q=h**2, lam=h + 1e-4 / h**2) for h in steps]
    return steps, double, single_


def test_rounding_takes_over_where_the_error_doubles():
    steps, double, single_ = curves()
    q, lam = takeovers([*double, *single_], "single")
    assert (q.h, q.slope) == (None, None)
    assert lam.h == 0.04
    assert lam.slope == pytest.approx(slope(steps[1:], [h + 1e-4 / h**2 for h in steps[1:]]))
    steep = [planted("single", h, q=1.0, lam=1 / h**2) for h in steps]
    assert takeovers([*double, *steep], "single")[1].slope == pytest.approx(-2)
    said = precision_sentences(
        [*double, *single_, *[planted("mixed", h, q=h**2, lam=h) for h in steps]]
    )
    assert said == [
        f"newmark: in single rounding takes over in lam from h=0.04 s down "
        f"(slope {lam.slope:.2f}), not in q; in mixed no error is 2 times that in double."
    ]


def test_two_steps_give_no_slope_and_a_failure_counts():
    _, double, single_ = curves()
    failed = [*single_[:2], planted("single", 0.02), planted("single", 0.01)]
    q, lam = takeovers([*double, *failed], "single")
    assert (lam.h, lam.slope, q.h) == (0.04, None, 0.02)
    # A larger error at coarse steps alone is no rounding.
    coarse = [
        planted("single", 0.08, q=1.0, lam=9.0),
        *[planted("single", r.h, **r.errors) for r in double[1:]],
    ]
    assert [one.h for one in takeovers([*double, *coarse], "single")] == [None, None]


# ---- the command -------------------------------------------------------------------------
@pytest.mark.long
def test_the_command_prints_tables_json_and_csv(stepbench):
    line = ["precision", "oscillator", "newmark", "--steps", "0.1,0.05", "--t-end", "1"]
    found = json.loads(stepbench(*line, "--json").stdout)
    assert [(run["precision"], run["steps"]) for run in found["runs"]] == [
        (precision, count) for precision in ("double", "single", "mixed") for count in (10, 20)
    ]
    assert found["summary"][0].startswith("newmark")
    rows = list(csv.DictReader(stepbench(*line, "--csv").stdout.splitlines()))
    assert [float(row["h"]) for row in rows] == pytest.approx(3 * [0.1, 0.05])
    assert [float(row["error_q"]) for row in rows] == [run["errors"]["q"] for run in found["runs"]]
    result = stepbench(*line[:3], "ida", *line[3:])
    assert result.exit_code == 1
    assert "ida[formulation=stabilised_index2] has no step of constant size" in result.stderr
    assert "in mixed no error is 2 times" in " ".join(result.stdout.split())


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (["newmark", "--steps", "0"], "not allowed"),
        (["newmark", "--steps", "nan"], "not allowed"),
        (["newmark", "--steps", "few"], "not a list of numbers"),
        (["newmark", "newmark"], "named twice"),
        (["nomark"], "newmark"),
        (["newmark", "--t-end", "-1"], "after the start"),
        ([], "INTEGRATOR"),
    ],
)
@pytest.mark.usefixtures("without_processes")
def test_wrong_input_is_refused_in_a_sentence(refused, more, words):
    assert words in refused("precision", "pendulum", *more)
