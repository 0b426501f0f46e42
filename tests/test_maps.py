"""Maps: a point is a single run, and the edges agree with theory."""

from __future__ import annotations

import csv
import io
import math
import re

import altair
import numpy as np
import pytest
from helpers import long
from planted import Document

from bench.plugins.registry import Registry
from bench.running.errors import relative_errors
from bench.running.worker import Worker
from bench.sweeps.outcome_map import OUTCOMES, outcome_map
from bench.sweeps.variation import SweepRequest
from integrators import Steps, Tolerances
from problems.truth.reference import Reference
from problems.variables import GROUPS
from reports.pages.maps import _OTHERS, map_chart

REGISTRY = Registry()
ADAPTIVE, KVAERNO = "generalized_alpha_adaptive[newton=modified]", "kvaerno3[steps=constant]"


def made(problem, integrator, over, counts, step=None, t_end=None, **more):
    given = dict.fromkeys(("pattern", "rtol", "atol")) | {"step": step}
    request = SweepRequest(problem, integrator, given, t_end)
    ranges = (f"{name}:{ends[0]!r}..{ends[1]!r}" for name, ends in over.items() if ends)
    return outcome_map(Worker(REGISTRY), request, tuple(over), tuple(ranges), counts, **more)


def errors_of(found):
    return 10 ** np.array(found["log10_error"], dtype=float)


def resolution_of(method, scene, settings):
    if method.controls == "step":
        return Steps(settings.pop("h", scene.nominal_step))
    return Tolerances(settings.pop("rtol", 1e-6), settings.pop("atol", None))


@pytest.mark.parametrize(
    "cases",
    [
        (("pendulum", "generalized_alpha", {"h": None, "rho_inf": (0.0, 1.0)}, "lam:end"),),
        *long(
            [
                ("pendulum", "generalized_alpha", {"h": None, "rho_inf": (0.0, 1.0)}, "a:end"),
                ("pendulum", "generalized_alpha", {"th0": (0.5, 3.0), "h": (0.01, 0.1)}, "|q|:end"),
                ("spring_mass", "newmark", {"k": (0.5, 20.0), "m": (0.5, 2.0)}, "a:end"),
                ("duffing", KVAERNO, {"h": (0.01, 0.3), "k3": (0.1, 1.0)}, "a:end"),
                ("pendulum", ADAPTIVE, {"rtol": (1e-5, 1e-2), "th0": (0.5, 3.0)}, "a:end"),
                ("pendulum", ADAPTIVE, {"th0": (0.5, 3.0), "rtol": (1e-5, 1e-2)}, "lam"),
                ("soft_impact", ADAPTIVE, {"rtol": (1e-5, 1e-2), "atol": (1e-6, 1e-2)}, "q:end"),
            ]
        ),
    ],
)
def test_a_point_is_a_single_run(cases):
    for problem, integrator, over, error in cases:
        t_end = {"spring_mass": 5.0}.get(problem, REGISTRY.problem(problem).interval[1])
        found = made(problem, integrator, over, (4, 3), error=error, t_end=t_end)
        group = error.removesuffix(":end")
        for i, j in ((0, 0), (3, 1), (1, 2)):
            settings = dict(
                zip(over, (found["x"]["values"][i], found["y"]["values"][j]), strict=True)
            )
            scene, method = REGISTRY.problem(problem), REGISTRY.integrator(integrator)
            resolution = resolution_of(method, scene, settings)
            for of in (scene, method):
                for name in settings.keys() & vars(of).keys():
                    object.__setattr__(of, name, float(settings[name]))  # both were made here
            run = method.prepare(scene, t_end, resolution).measure()
            errors, *_ = relative_errors(run, Reference(scene, t_end))
            wanted = errors[group]["end"]
            assert errors_of(found)[j, i] == pytest.approx(wanted, rel=1e-6, abs=1e-9)
            assert found["outcome"][j][i] == ("ok" if wanted <= 0.1 else "inaccurate")
        assert len(set(errors_of(found).ravel())) > 6


@pytest.mark.parametrize(
    ("beta", "limit"), [(0.0, 2.0), *long((1 / 6, math.sqrt(12)), (1 / 12, 6**0.5))]
)
def test_undamped_methods_diverge_exactly_beyond_their_limit(monkeypatch, beta, limit):
    """Newmark with gamma = 1/2: omega h = (1/4 - beta)^(-1/2); the scene has omega = sqrt(k)."""
    # Errors are of no interest here, and the reference over so many periods takes long.
    monkeypatch.setattr(Reference, "__call__", lambda self, t: {"q": np.ones((len(t), 1))})
    monkeypatch.setattr(Reference, "largest", {"q": (np.ones(1), 1.0)})
    over = {"k": (0.99**2, 1.01**2), "m": (1.0, 1.0 + 1e-9)}
    steps = 3000
    found = made(
        "spring_mass[b=0]",
        f"newmark[beta={beta!r}]",
        over,
        (4, 2),
        step=limit,
        t_end=steps * limit,
        error="q:end",
        threshold=1e300,
    )
    ratio = np.sqrt(found["x"]["values"])  # omega h relative to the limit
    told = np.array(found["outcome"][0])
    assert (told[ratio < 1 - 1e-9] == "ok").all()
    assert (told[ratio > 1 + 1e-9] == "diverged").all()
    assert set(told) == {"ok", "diverged"}
    assert "grew beyond all bounds" in found["reasons"]["diverged"]


@pytest.mark.long
def test_undamped_index_3_spoils_the_multiplier():
    found = made(
        "pendulum", "generalized_alpha", {"h": (0.005, 0.01), "rho_inf": (0.8, 1.0)}, (3, 2),
        error="lam:end",
    )  # fmt: skip
    assert found["outcome"] == [["ok"] * 3, ["inaccurate"] * 3]
    assert errors_of(found)[0].max() < 0.02 < 0.2 < errors_of(found)[1].min()
    assert found["reasons"] == {"inaccurate": "The error of lam (end) is above 0.1."}
    # Steps that are used up are told apart from points that were not begun.
    method = "generalized_alpha_adaptive[max_steps=100]"
    found = made("pendulum", method, {"rtol": (1e-6, 1e-2), "th0": (1.0, 1.1)}, (2, 2))
    assert found["outcome"] == [["budget_exceeded", "ok"]] * 2
    assert "100 steps were used up" in found["reasons"]["budget_exceeded"]


def test_newton_failures_and_unsupported_points_are_told():
    found = made(
        "pendulum", "generalized_alpha[newton_max=2]", {"h": (0.001, 0.2), "rho_inf": (0.5, 0.9)},
        (4, 3),
    )  # fmt: skip
    assert [row[-1] for row in found["outcome"]] == ["newton_failed"] * 3
    assert np.isnan(errors_of(found)[:, -1]).all()
    assert np.isfinite(errors_of(found)[:, 0]).all()
    partly = made("pendulum", "newmark", {"beta": (0.0, 0.5), "gamma": (0.5, 0.6)}, (4, 3))
    told = [[outcome == "not_run" for outcome in row] for row in partly["outcome"]]
    assert told == [[True, True, False, False]] * 3
    assert "constraints act like infinite frequencies" in partly["reasons"]["not_run"]


def test_a_scene_without_a_reference_is_told_apart(monkeypatch):
    def fails(self, t):
        if self.scene.k > 1.0:
            raise RuntimeError("no such luck")
        return dict.fromkeys(GROUPS, np.ones((len(t), 1)))

    monkeypatch.setattr(Reference, "__call__", fails)
    monkeypatch.setattr(Reference, "largest", dict.fromkeys(GROUPS, (np.ones(1), 1.0)))
    found = made("spring_mass", "newmark", {"k": (0.5, 2.0), "m": (1.0, 2.0)}, (4, 2), t_end=1.0)
    assert found["outcome"][0][3] == "no_reference"
    assert found["reasons"]["no_reference"] == "The reference failed: no such luck"
    assert found["outcome"][0][0] in ("ok", "inaccurate")


def test_the_reference_is_made_once_per_scene(monkeypatch):
    asked, plain = [], Reference.__call__
    counted = lambda self, t: asked.append(self.scene.th0) or plain(self, t)  # noqa: E731
    monkeypatch.setattr(Reference, "__call__", counted)
    over = {"h": (0.01, 0.1), "rho_inf": (0.0, 1.0)}
    made("pendulum", "generalized_alpha", over, (4, 3))
    assert len(asked) == 1


# ---- the command -------------------------------------------------------------------------
MAP = ("map", "pendulum", "generalized_alpha", "--over", "h,rho_inf", "--grid", "4x3")


@pytest.mark.usefixtures("without_processes")
def test_the_page_holds_the_map_and_asks_no_network(stepbench, tmp_path):
    result = stepbench(*MAP, "--out", tmp_path)
    assert result.exit_code == 0, result.output
    assert "over h and rho_inf: 12 runs" in result.output
    assert re.search(r"ok +\d+ +\d+\.\d %", result.output)
    text = (tmp_path / "map.html").read_text()
    page = Document(text)
    assert "generalized_alpha on pendulum" in page.words
    assert not re.search(r"(src|href)=\"(?!data:|#)", text)
    assert "<svg" in text


def test_tiles_meet_in_the_middle_and_show_the_outcomes():
    found = {
        "x": {"name": "h", "values": [0.01, 0.1, 1.0], "log": True},
        "y": {"name": "sigma", "values": [0.0, 1.0], "log": False},
        "threshold": 0.1,
        "outcome": [["ok", "ok", "diverged"], ["newton_failed", "inaccurate", "inaccurate"]],
        "log10_error": [[-3.5, -1.0, None], [None, -0.5, 5.0]],
    }
    chart = map_chart(found)
    altair.Chart.from_dict(chart)
    tiles = [list(row.values()) for row in csv.DictReader(io.StringIO(chart["datasets"]["map"]))]
    near, far = 10**-1.5, 10**-0.5
    expected = [
        (10**-2.5, near, -0.5, 0.5, "ok, error up to 0.001"),
        (near, far, -0.5, 0.5, "ok, error up to 0.1"),
        (far, 10**0.5, -0.5, 0.5, "diverged"),
        (10**-2.5, near, 0.5, 1.5, "Newton failed"),
        (near, far, 0.5, 1.5, "inaccurate, error up to 1"),
        (far, 10**0.5, 0.5, 1.5, "inaccurate, error above 1"),
    ]
    for (*ends, words), (*wanted, said) in zip(tiles, expected, strict=True):
        assert words == said
        assert [float(end) for end in ends] == pytest.approx(wanted, rel=1e-4)
    assert {o for o in OUTCOMES if o not in ("ok", "inaccurate")} == set(_OTHERS)
