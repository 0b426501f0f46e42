"""Certain digits: those of closed forms and publications, of each scene's file, and their ends."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from decimal import Decimal
from pathlib import Path

import digits
import numpy as np
import pytest
from helpers import long, scene_or_skip

from bench.plugins.registry import Registry
from bench.running.truth import truth_job
from bench.running.worker import Worker
from problems import State
from problems.base.spec import SpecError
from problems.truth.reference import Reference
from problems.variables import VARIABLES

STORED = json.loads(digits.FILE.read_text(encoding="utf-8"))
QUICK = ("duffing", "pendulum", "spring_mass")
DOCUMENT = (Path(__file__).parents[1] / "docs" / "truth.md").read_text(encoding="utf-8")


#: Test Set for IVP Solvers, problem caraxis, t = 3, in 21 digits; a from its equations.
CAR_AXIS = {
    "q": [0.0493455784275402809122, 0.496989460230171153861,
          1.04174252488542151681, 0.373911027265361256927],
    "v": [-0.0770583684040972357970, 0.00744686658723778553466,
          0.0175568157537232222276, 0.770341043779251976443],
    "a": [-4.930286874874, 0.520265802413, 0.522011199926, 49.284321166953],
    "lam": [-0.00473688659084893324729, -0.00110468033125734368808],
}  # fmt: skip
#: The same, problem crank, t = 0.1.
CRANK = {
    "q": [0.1500000000000104e2, -0.3311734988256260, 0.1697373328427860, 0.1893192899613509e-3,
          0.2375751249879174e-4, -0.5323896770569702e-5, -0.8363313279112129e-5],
    "v": [0.15e3, 0.6025346755138369e2, -0.8753116326670527e1, -0.3005541400289738e-1,
          -0.5500431812571696e-2, 0.4974111734266989e-3, 0.1105560003626645e-2],
    "a": [0.0, 0.6488737541276957e4, 0.2167938629509884e4, 0.3391137060286523e2,
          0.1715134772216488, -0.1422449408912512e1, 0.1003946428124810e1],
    "lam": [-0.6232935833287916e2, -0.1637920993367306e3, 0.2529857947066878e2],
}  # fmt: skip


def unit(text: str) -> Decimal:
    """A unit of the last digit of a number."""
    return Decimal(1).scaleb(int(Decimal(text).as_tuple().exponent))


def assert_same(found: dict, stored: dict) -> None:
    """Two rows agree as far as both go, to a unit of the last digit of each."""
    assert found["t"] == stored["t"]
    for group in set(VARIABLES) & stored.keys():
        for one, two in zip(found[group], stored[group], strict=True):
            assert abs(Decimal(one) - Decimal(two)) <= unit(one) + unit(two)
            assert max(unit(one), unit(two)) <= 100 * min(unit(one), unit(two))


@pytest.mark.parametrize(
    "name",
    [
        *("pendulum", *long("oscillator", "iftomm_pendulum", "slider_crank_driven")),
        *long("chaplygin_sleigh", "driven_springs"),
    ],
)
def test_digits_without_a_closed_form_are_those_of_the_closed_form(name):
    scene, own = scene_or_skip(name), Worker(Registry())
    (exact,) = (scene.exact(np.array(scene.interval[:1])),)
    start = State(*(exact[g][0] if g in exact else np.zeros(0) for g in "qvx"))
    blocks = {"exact": None, "initial_state": lambda self: start, "published": ()}
    own._scenes[name] = type("Unknown", (type(scene),), {**blocks, "__module__": __name__})()
    rows = truth_job(own, name, None, None)["rows"]
    exact = scene.exact(np.array([row["t"] for row in rows]))
    for k, row in enumerate(rows):
        for group in row["digits"]:
            for text, value in zip(row[group], exact[group][k], strict=True):
                rounding = 4 * np.spacing(np.abs(exact[group][:, :]).max())
                assert abs(Decimal(text) - Decimal(value)) <= unit(text) + Decimal(rounding)
    assert min(row["digits"]["q"] for row in rows) >= 12


@pytest.mark.parametrize("name", [*QUICK, *long(*sorted(STORED.keys() - {*QUICK}))])
def test_stored_digits_are_computed_again(worker, name):
    scene_or_skip(name)
    found, stored = digits.computed(worker, name), STORED[name]
    for rows in zip(found["rows"], stored["rows"], strict=True):
        assert_same(*rows)
    assert found["how"] == stored["how"]


def test_the_file_has_all_scenes_and_enough_digits_of_smooth_ones():
    registry = Registry()
    assert STORED.keys() == registry.problems.keys()
    assert digits.text(STORED) == digits.FILE.read_text(encoding="utf-8")
    assert digits.FILE.stat().st_size < 150_000
    classes = {n: p.cls for n, p in registry.problems.items() if n[:5] not in ("mjcf_", "sympy")}
    smooth = [n for n, cls in classes.items() if "smooth" in getattr(cls, "tags", ())]
    for name in smooth:
        for row in STORED[name]["rows"]:
            assert all(n >= (12 if g in "qv" else 10) for g, n in row["digits"].items()), name
    assert len(smooth) > 9


@pytest.mark.parametrize(
    ("name", "published", "far"),
    [
        # As far as the source goes: 21 digits, and starts that are consistent to 1e-8 only.
        ("car_axis", CAR_AXIS, {"q": 2e-12, "v": 2e-11, "a": 1e-9, "lam": 1e-12}),
        ("slider_crank_flexible", CRANK, {"q": 3e-10, "v": 1e-6, "a": 1e-3, "lam": 4e-5}),
    ],
)
def test_stored_digits_are_those_of_the_ivp_test_set(name, published, far):
    (*_, row) = STORED[name]["rows"]
    for group, values in published.items():
        found = np.array([float(text) for text in row[group]])
        assert np.abs(found - values).max() <= far[group], (group, found - values)


def test_other_coordinates_of_a_mechanism_have_the_same_digits():
    angle, top = slice(2, 3), slice(3, None)
    pairs = [
        ("slider_crank", "slider_crank_minimal", {"q": angle, "v": angle, "a": angle}),
        ("heavy_top_r3_so3", "heavy_top_so3", {"q": top, "v": top, "a": top}),
        ("heavy_top_r3_so3", "heavy_top_se3", {"q": slice(0, None), "lam": slice(0, None)}),
    ]
    for one, two, places in pairs:
        for first, second in zip(STORED[one]["rows"], STORED[two]["rows"], strict=True):
            assert first["t"] == second["t"]
            for group, part in places.items():
                for a, b in zip(first[group][part], second[group], strict=True):
                    assert abs(Decimal(a) - Decimal(b)) <= unit(a) + unit(b), (one, two, group)


def test_digits_end_where_the_ways_differ(worker, monkeypatch):
    another = Reference.another

    def spoilt(self, t, changed):
        found = another(self, t, changed)
        off = np.where((t > 1.55) & (t < 1.95), 1e-6, 0.0)[:, None]
        off[t > 2.55] = np.nan
        return found | {"v": found["v"] + off * changed}

    monkeypatch.setattr(Reference, "another", spoilt)
    found = truth_job(worker, "duffing", 0.5, None)
    known = [row["digits"]["v"] for row in found["rows"]]
    assert min(known[:4]) >= 13
    assert known[4:] == [5, 5, 0]
    assert [len(row["v"][0].partition(".")[2]) for row in found["rows"][4:]] == [5, 5, 0]
    assert found["rows"][-1]["v"] == [""]
    assert min(row["digits"]["q"] for row in found["rows"]) >= 13
    assert "v: digits end, none is certain from t=3 s on." in found["remarks"]
    assert any(r.startswith("v: differences grow") for r in found["remarks"])


@pytest.mark.parametrize(
    ("every", "at", "came"),
    [
        (None, [3.5], "3.5, 1 of them"),
        (None, [0.1, float("nan"), 0.2], "nan"),
        (None, [*np.linspace(0, 3, 1001)], "0, 0.003, .* 1001 of them"),
        *((every, None, f"every {every:g} s") for every in (0.0, -1.0, 4.0, 1e-9, float("nan"))),
    ],
)
def test_instants_that_are_not_allowed_are_refused(worker, every, at, came):
    with pytest.raises(SpecError, match=f"{came}.* not allowed; give 1 to 1000 times from 0 s to"):
        truth_job(worker, "duffing", every, at)


@pytest.mark.long
def test_a_way_that_does_not_reach_the_end_says_where_digits_end(worker):
    with pytest.raises(SpecError, match=r"t=0.714.* Digits end there: ask for earlier instants"):
        truth_job(worker, "n_four_bar", None, None)


@pytest.mark.usefixtures("without_processes")
def test_the_command_prints_what_judge_reads(stepbench, refused, tmp_path):
    line = "truth", "duffing", "--at", "0,1.5,3"
    shown = stepbench(*line).output
    for text in STORED["duffing"]["rows"][-1]["q"]:
        assert text[:-1] in shown
    assert re.search(r"How: Gauss collocation.*; Radau\s+IIA", shown)
    rows = json.loads(stepbench(*line, "--json").output)["rows"]
    assert_same(rows[-1], STORED["duffing"]["rows"][-1])
    head, *table = stepbench(*line, "--csv").output.splitlines()
    assert head == "t,q1,v1,a1"
    assert table[-1].split(",")[1:] == [rows[-1][g][0] for g in "qva"]
    (tmp_path / "rows.csv").write_text("\n".join(["# step=1.5 method=truth", head, *table]))
    (record,) = json.loads(stepbench("judge", "duffing", tmp_path / "rows.csv", "--json").output)
    assert max(record["errors"][g]["max"] for g in "qva") < 1e-13
    assert "does not go with --every" in refused(*line, "--every", "1")


def test_the_programs_of_the_document_pass_with_these_digits(tmp_path):
    programs = {}
    for language, ending in (("c", "c"), ("python", "py")):
        (text,) = re.findall(rf"^```{language}\n(.*?)^```$", DOCUMENT, re.DOTALL | re.MULTILINE)
        programs[ending] = text
    assert STORED["duffing"]["rows"][-1]["q"][0] in programs["c"]
    shutil.copy(digits.FILE, tmp_path)

    def code(text: str, ending: str) -> int:
        (tmp_path / f"test.{ending}").write_text(text)
        if ending == "py":
            return subprocess.run([sys.executable, "-I", "test.py"], cwd=tmp_path).returncode
        subprocess.run(["cc", "test.c", "-o", "test", "-lm"], cwd=tmp_path, check=True)
        return subprocess.run([tmp_path / "test"]).returncode

    for ending, text in programs.items():
        if ending != "c" or shutil.which("cc"):
            assert code(text, ending) == 0
            assert code(text.replace("0.3 * v", "0.31 * v"), ending) == 1
