"""Numbers and sentences of the front page against a second count from the records."""

from __future__ import annotations

import copy

import pytest
from chromium import in_chromium
from planted import planted
from recount import faults, page_data

from bench.results.records import INTERRUPTED, UNSUPPORTED, Plan, Rows, Study
from bench.results.store import Store
from reports.pages.html_report import write_html_report
from reports.pages.report import read_report
from reports.pages.site import _command
from reports.questions.phrases import plain

NONE = Rows(t=[])


def run(scene, name, cost, error=1e-5, h=0.01, **changes):
    """A run with a number of residuals and an error in a; q tells methods apart."""
    errors = {"a": {"max": error}, "q": {"max": 1e-3 * sum(map(ord, name))}}
    known = {"errors": errors, "work": {"residuals": cost}, "run_s": []}
    known |= {"key": f"{scene} | {name} | {h}", "family": name.partition(" ")[0]}
    return planted(scene, name, {"a": (1, 2), "q": (1, 2)}, h=h, **(known | changes))


def odd_runs():
    """Every way in which a method can stand on a scene."""
    records = [
        *(run("won", name, cost) for name, cost in (("one", 100), ("two", 250), ("far", 9))),
        run("won", "two", 900, 1e-8, h=0.001),
        *(run("tied", name, cost) for name, cost in (("one", 100), ("two", 100), ("three", 300))),
        *(run("near", name, cost) for name, cost in (("one", 100), ("two", 105), ("three", 120))),
        *(run("dark", name, cost) for name, cost in (("one", 100), ("two", 50), ("unseen", None))),
        run("darkest", "unseen", None),
        run("darkest", "one", 10, 1e-2),
        run("alone", "one", 100),
        *(run("missed", name, 10, 3e-3) for name in ("one", "two")),
        run("broken", "one", 100),
        *(run("coarse", n, 9, reference_error={"a": {"max": 2e-6}}) for n in ("one", "two")),
        *(run("twins", name, 100) for name in ("one", "two")),
        run("lucky", "one", 100, later=[{"a": 1e-5}, {"a": 1e-2}]),
        run("lucky", "two", 300, later=[{"a": 1e-5}, {"a": 1e-5}]),
        run("lucky", "three", 500, later=[{"a": 1e-5}, {"a": 1e-5}]),
    ]
    records[2].errors["a"]["max"] = 1e-2
    endings = {"two": "newton_failed", "cut": INTERRUPTED, "shy": UNSUPPORTED}
    records += [run("broken", n, None, status=s, errors={}) for n, s in endings.items()]
    records.append(
        run("twins", "copy", 100, errors=next(r.errors for r in records if r.problem == "twins"))
    )
    return records


def write_odd(folder, records):
    """A run folder with these records, their times and a plan."""
    with Store(folder, create=True) as store:
        for record in records:
            store.save(record, NONE)
            samples = 1 if "once" in record.integrator else 7
            for k in range(samples if record.work["residuals"] and record.status == "ok" else 0):
                store.add_sample(record.key, k, 1e-6 * record.work["residuals"] * (1 + 0.001 * k))
        names = dict.fromkeys(r.problem for r in records)
        cells = {name: [r.key for r in records if r.problem == name] for name in names}
        studies = [
            Study(title=k, problem=k, t_end=1.0, figures=[], cells=own) for k, own in cells.items()
        ]
        store.keep(Plan(name="odd", title="Odd", samples=3, budget_s=1.0, studies=studies))
    return folder


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return write_odd(tmp_path_factory.mktemp("odd"), odd_runs())


@pytest.fixture(scope="module")
def odd(folder):
    write_html_report(folder)
    return folder, page_data(folder)


@in_chromium
def test_all_numbers_of_the_front_page_are_those_of_the_records(odd):
    folder, data = odd
    assert len(data["answers"]) == 2 * 9 * 3
    assert faults(folder, data) == []


@in_chromium
@pytest.mark.parametrize("place", ["states", "first", "standings", "profile"])
def test_a_wrong_number_is_found(odd, place):
    folder, data = odd[0], copy.deepcopy(odd[1])
    answer = data["answers"]["a|1e-4|residuals"]
    if place == "states":
        answer["scenes"][0]["states"][1] = [2.6, 0]
    elif place == "first":
        answer["scenes"][1]["first"].pop()
    elif place == "standings":
        answer["filters"]["all"]["standings"][0][2] += 1
    else:
        data["profiles"]["a|residuals"]["all"]["methods"]["0"][10] += 100
    assert len(faults(folder, data)) == 1


@in_chromium
def test_runs_that_were_not_tried_are_no_failures(odd):
    data = odd[1]
    names = [m["label"] for m in data["methods"]]
    states = data["answers"]["a|1e-4|operations"]["scenes"]
    (states,) = (
        s["states"] for s, k in zip(states, data["scenes"], strict=True) if k["id"] == "broken"
    )
    assert {k: s for k, s in zip(names, states, strict=False) if s} == {
        "one": [1.0, 0],
        "two": "failed",
    }
    assert data["failed"] == 1


def test_a_method_s_page_tells_how_it_stands_on_each_scene(folder):
    report = read_report(folder, interactive=False)
    tables = {m.label: m.scenes for m in report.methods}
    states = {k: {row[0]: row[1] for row in table.rows} for k, table in tables.items()}
    assert states["cut"] == states["shy"] == {"broken": "not tried"}
    assert states["two"]["broken"] == "no run reached the end"
    assert (states["two"]["coarse"], states["two"]["missed"]) == ("not judged", "not reached")
    assert (states["one"]["won"], states["unseen"]["dark"]) == ("reached", "reached")
    cards = {m.label: " ".join(map(plain, m.card)) for m in report.methods}
    assert "With none to compare: alone." in cards["one"]
    assert "At a cost that is not measured: dark and darkest." in cards["unseen"]
    assert "was tried on no scene" in cards["cut"]


def test_the_command_of_a_scene_repeats_its_run():
    one = run("s", "one", 10, controls="tolerance", rtol=1e-4, atol=1e-6)
    none = {"one": ""}
    assert _command([one], none) == "stepbench solve s one --rtol 0.0001 --t-end 1"
    one.atol = 1e-9
    assert _command([one], none) == "stepbench solve s one --rtol 0.0001 --atol 1e-09 --t-end 1"
