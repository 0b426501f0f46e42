"""Numerical damping of methods at constant steps at the frequencies of scenes: run and page."""

from __future__ import annotations

import math
import shutil
from unittest.mock import Mock

import pytest
from planted import Document, everything, plant, whole_markdown, whole_report

from bench.commands.suite import run_suite
from bench.results.records import Damping, SceneRecord
from bench.results.store import Store
from bench.running.inventory import Inventory
from bench.running.plan import make_suite
from bench.running.process import Limits
from bench.running.profiles import read_profile
from bench.running.runner import Runner
from bench.stability import damping as analysis
from reports.formatting import number
from reports.pages.html_report import write_html_report
from reports.pages.markdown_report import write_markdown_report
from reports.tables.damping_table import damping_table

PROFILE = """
samples = 0
[[study]]
problems = ["duffing"]
integrators = ["newmark", "generalized_alpha[rho_inf=0.5]", "ida"]
steps = [0.05]
rtol = [1e-3]
[[study]]
problems = ["pendulum"]
t_end = 0.5
integrators = ["newmark"]
steps = [0.02]
"""


def scene(name="duffing", nominal_step=0.05, rates=None) -> SceneRecord:
    return SceneRecord(problem=name, t0=0.0, t_end=1.0, nominal_step=nominal_step, rates=rates)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("run")
    (path / "profile.toml").write_text(PROFILE)
    return path


@pytest.mark.usefixtures("without_processes")
def test_a_run_analyses_its_methods_once_at_the_frequencies_of_their_scenes(folder, capsys):
    registry = Inventory()
    suite = make_suite(*read_profile(str(folder / "profile.toml")), registry)
    run_suite(suite, registry, folder / "out", jobs=1)
    assert "damping" in capsys.readouterr().err
    with Store(folder / "out") as store:
        known, scenes, records = store.damping(), store.scenes(), store.records()
    newmark = known["newmark[beta=0.25,gamma=0.5]"]
    ended = [r for r in records.values() if r.integrator.startswith("newmark") and r.status == "ok"]
    at = sorted(scenes[r.problem, r.t_end].omega_h for r in ended)
    assert len(at) >= 1
    assert newmark.omega_h == at
    # The trapezoidal rule damps nothing, and stretches the period by w h / (2 atan(w h / 2)).
    assert newmark.ratio == pytest.approx([0.0] * len(at), abs=1e-12)
    stretched = [w / (2 * math.atan(w / 2)) - 1 for w in at]
    assert newmark.period_error == pytest.approx(stretched, rel=1e-7)
    damped = known["generalized_alpha[rho_inf=0.5]"]
    (w,) = damped.omega_h
    assert w == scenes["duffing", 3.0].omega_h
    # |root| = exp(-ratio angle), and the angle is w / (1 + period error).
    angle = w / (1 + damped.period_error[0])
    assert damped.radius[0] == pytest.approx(math.exp(-damped.ratio[0] * angle), rel=1e-12)
    assert 1e-7 < damped.ratio[0] < 1e-4
    assert len(known) == 2  # not ida, which chooses its steps
    run_suite(suite, registry, folder / "out", jobs=1)
    assert "damping" not in capsys.readouterr().err
    with Store(folder / "out") as store:
        assert store.damping() == known


def test_the_page_shows_what_the_run_found(folder):
    with Store(folder / "out") as store:
        found = store.damping()["generalized_alpha[rho_inf=0.5]"]
    for write in (write_html_report, write_markdown_report):
        write(folder / "out")
    page = Document(whole_report(folder / "out"))
    rows = page.rows("Damping and period error of the method itself")
    (cell,) = [r["gα 0.5"] for r in rows if "duffing" in r["scene"]]
    assert cell == f"{number(found.ratio[0])} ({100 * found.period_error[0]:+.2g}%)"
    assert cell in whole_markdown(folder / "out")


@pytest.fixture
def again(folder, tmp_path):
    """The suite, its inventory, and a copy of its store."""
    shutil.copytree(folder / "out", tmp_path / "out")
    registry = Inventory()
    suite = make_suite(*read_profile(str(folder / "profile.toml")), registry)
    with Store(tmp_path / "out", create=True) as store:
        yield suite, registry, store


def test_methods_are_asked_that_came_to_the_end_at_all_frequencies_that_are_known(again):
    suite, registry, store = again
    scenes, records = store.scenes(), store.records()

    def asked(known):
        found = analysis.missing(suite, known, scenes, records, registry)
        return {task.arguments[0]: task.arguments[1] for task in found}

    plain, damped = "newmark[beta=0.25,gamma=0.5]", "generalized_alpha[rho_inf=0.5]"
    first = asked({})
    assert first.keys() == {plain, damped}  # ida chooses its steps
    assert asked({plain: Damping(omega_h=[5.0])})[plain] == (*first[plain], 5.0)
    for record in records.values():
        if record.integrator == damped:
            record.status = "crashed"
    assert asked({}).keys() == {plain}


def test_damping_is_kept_until_the_source_of_the_method_or_the_analysis_changes(again, monkeypatch):
    (suite, registry, store), name = again, "newmark[beta=0.25,gamma=0.5]"

    def complete(budget_s):
        with Runner(1, Limits(budget_s, 4.0)) as runner:
            analysis.complete_damping(suite, store, registry, runner)
        return store.damping()

    known = store.damping()
    assert complete(60.0) == known
    store.keep(Damping(omega_h=known[name].omega_h, fingerprint="other"), name)
    assert complete(60.0) == known
    store.forget(Damping, name)
    lost = complete(1e-9)[name]
    assert lost.omega_h == known[name].omega_h
    assert "running because it took more than 1e-09 s of processor time" in lost.message
    assert complete(60.0)[name] == lost
    monkeypatch.setattr("bench.running.inventory.fingerprint", lambda made: "other")
    monkeypatch.setattr(registry, "_known", {})
    analysis.complete_damping(suite, store, registry, Mock(run=lambda groups: []))
    assert store.damping() == {}


def test_every_ending_has_its_words():
    scenes = [("one", scene(rates={"oscillation": 2.0}))]  # omega h = 0.1
    found = {
        "damps": Damping(omega_h=[0.1], radius=[0.99], ratio=[0.0123], period_error=[0.00125]),
        "keeps": Damping(omega_h=[0.1], radius=[1.0], ratio=[-3e-16], period_error=[0.0]),
        "grows": Damping(omega_h=[0.1], radius=[1.25], ratio=[-0.1], period_error=[0.0]),
        "creeps": Damping(omega_h=[0.1], radius=[0.5], ratio=[None], period_error=[None]),
        "fails": Damping(omega_h=[0.1], radius=[None], ratio=[None], period_error=[None]),
        "lost": Damping(omega_h=[0.1], message="It took too long."),
        "elsewhere": Damping(omega_h=[0.2], radius=[1.0], ratio=[0.0], period_error=[0.0]),
    }
    table = damping_table(found, scenes)
    (row,) = table.rows
    assert dict(zip(table.head, row, strict=True)) == {
        "scene": "one, omega h = 0.1",
        "damps": "0.0123 (+0.12%)",
        "keeps": "0 (+0%)",
        "grows": "grows 1.25 times per step",
        "creeps": "no oscillation, 0.5 left",
        "fails": "not solved",
        "lost": "It took too long.",
        "elsewhere": "",
    }


def test_without_frequencies_or_analysis_there_is_no_table(tmp_path):
    known = {"a": Damping(omega_h=[0.1], message="m")}
    assert damping_table(known, [("one", scene(rates=None))]) is None
    assert damping_table(known, [("one", scene(rates={"oscillation": 0.0}))]) is None
    assert damping_table({}, [("one", scene(rates={"oscillation": 2.0}))]) is None
    plant(tmp_path, everything())
    assert "of the method itself" not in write_html_report(tmp_path).read_text(encoding="utf-8")
