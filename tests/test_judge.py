"""Runs of other programs: rows of files have the errors that were planted, and disorder is told."""

import json
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from helpers import long, slope

from bench.plugins.registry import Registry
from bench.results.store import Store
from bench.running import exchange
from bench.running.errors import relative_errors
from bench.running.exchange import judge_job, template
from bench.running.worker import Worker
from integrators.resolutions import Steps
from problems.base.spec import SpecError
from problems.scenes.pendulums import Pendulum
from problems.truth.reference import named_points
from problems.variables import VARIABLES

GROUPS = ("q", "v", "a", "lam", "x", "y")
YARDSTICK = Path(__file__).parent / "benchmarks" / "yardstick_slider_crank.c"


@pytest.fixture
def judged(worker):
    """Judge files by a worker that has references, and knows no method judged before."""

    def call(scene, *files):
        fresh = Worker(Registry())
        fresh._references, fresh._scenes = worker._references, worker._scenes
        return judge_job(fresh, scene, [*map(str, files)], {}, None, False)

    return call


def exact_columns(scene):
    t = np.linspace(*scene.interval, 101)
    values = scene.exact(t)
    return {"t": t} | {
        f"{group}{i + 1}": column
        for group in GROUPS
        if scene.sizes.of(group)
        for i, column in enumerate(np.asarray(values[group]).T)
    }


PENDULUM = exact_columns(Pendulum())


def written(path, columns, facts="step=0.01"):
    table = np.column_stack([*columns.values()])
    head = f"# {facts}\n{','.join(columns)}"
    np.savetxt(path, table, delimiter=",", header=head, comments="", fmt="%.17g")
    return path


@pytest.mark.parametrize("name", ["pendulum", "oscillator"])
def test_rows_of_the_closed_form_err_by_rounding_and_a_planted_error_is_found(
    judged, worker, tmp_path, name
):
    scene = worker.problem(name)
    columns = exact_columns(scene)
    t = columns["t"]
    file = written(tmp_path / "exact.csv", columns | {"t": t + 1e-12 * (t == t[0])})
    ((record, _),) = judged(name, file).results
    assert record.status == "ok"
    groups = [g for g in GROUPS if scene.sizes.of(g)]
    assert [g for g in GROUPS if g in record.errors] == groups
    assert all(record.error(g, "max") < 1e-13 for g in groups)
    for group in groups:
        size = worker.reference(scene, scene.interval[1]).largest[group][0][0]
        scale = scene.components(group)[0].scale or size
        off = columns[f"{group}1"] + 1e-3 * scale * (t > t[0])
        file = written(tmp_path / f"{group}.csv", columns | {f"{group}1": off})
        ((bad, _),) = judged(name, file).results
        assert bad.error(group, "max") == pytest.approx(1e-3, rel=1e-9)
        assert bad.components[group]["max"][0] == pytest.approx(1e-3, rel=1e-9)
        others = [*bad.components[group]["max"][1:], *(bad.error(g, "max") for g in GROUPS)]
        assert sum(error is not None and error > 1e-12 for error in others) == 1


def test_all_kinds_of_files_and_names_of_columns_are_the_same_run(judged, tmp_path):
    columns = PENDULUM | {"q1": PENDULUM["q1"] + 1e-4 * (PENDULUM["t"] > 0.5)}
    tables = {g: np.column_stack([columns[f"{g}1"], columns[f"{g}2"]]) for g in "qva"}
    tables["lam"] = columns["lam1"][:, None]
    facts = {"step": 0.01, "seconds": 0.5, "residuals": 7}
    np.savez(tmp_path / "a.npz", t=columns["t"], **tables, **facts, method="mine")
    plain = {k: v.tolist() for k, v in ({"t": columns["t"]} | tables).items()}
    (tmp_path / "a.json").write_text(json.dumps(plain | facts | {"method": "mine"}))
    names = {"q1": "X", "q2": "Y [m]", "v1": "v:X", "lam1": "rod"}
    own = {names.get(name, name): column for name, column in columns.items()}
    written(tmp_path / "a.csv", own, "step=0.01 seconds=0.5 residuals=7 method=mine")
    semi = (tmp_path / "a.csv").read_text().replace(",", ";")
    (tmp_path / "b.csv").write_text(semi)
    files = [tmp_path / file for file in ("a.npz", "a.json", "a.csv", "b.csv")]
    found = [judged("pendulum", file).results[0].record for file in files]
    for record in found:
        assert record.errors == found[0].errors
        assert (record.integrator, record.run_s, record.work["residuals"]) == ("mine", [0.5], 7)
    assert found[0].error("q", "max") == pytest.approx(1e-4, rel=0.2)


def test_groups_and_components_that_are_missing_are_told_and_have_no_error(judged, tmp_path):
    part = {name: PENDULUM[name] for name in ("t", "q1", "q2", "v2")}
    part["v2"] = part["v2"] + 1e-2 * (part["t"] > 0.5)
    found = judged("pendulum", written(tmp_path / "part.csv", part))
    ((record, rows),) = found.results
    assert found.lacking == [["v1", "a", "lam"]]
    assert {g for g in record.errors if g in GROUPS} == {"q", "v"}
    assert record.components["v"]["max"][0] is None
    assert record.error("v", "max") == record.components["v"]["max"][1] > 1e-3
    assert set(rows.values) == {"q"}
    assert record.energy_drift is None


def test_points_alone_are_judged_by_their_rule(judged, worker, tmp_path):
    scene = worker.problem("iftomm_pendulum")
    reference = worker.reference(scene, scene.interval[1])
    t = np.linspace(*scene.interval, 201)
    (name, at), *_ = named_points(scene, reference(t)["q"]).items()
    columns = {"t": t, f"{name} x": at[:, 0] * (1 + 1e-2 * (t > t[0])), f"{name} y": at[:, 1]}
    file = written(tmp_path / "points.csv", columns)
    ((record, _),) = judged("iftomm_pendulum", file).results
    assert not any(g in record.errors for g in GROUPS)
    assert record.history_error == pytest.approx(1e-2 / np.sqrt(2), rel=0.1)


def changed(**columns):
    return lambda own: own | {name: change(own[name]) for name, change in columns.items()}


def at(k, value):
    return lambda column: np.where(np.arange(len(column)) == k, value, column)


@pytest.mark.parametrize(
    ("change", "facts", "sentence"),
    [
        (changed(t=lambda t: t[::-1]), "step=0.01", "write times that increase"),
        (changed(t=at(3, 0.36)), "step=0.01", "in row 4 follows"),
        (changed(t=lambda t: t + 1.0), "step=0.01", "starts at 0.35 s and ends at 1.35 s"),
        (changed(q1=lambda q: q + 0.1), "step=0.01", "starts with q1=0.92884336"),
        (changed(q2=at(5, np.nan)), "step=0.01", "q2 is nan in row 6"),
        (lambda own: {"x": own["q1"]}, "step=0.01", "has no column t"),
        (lambda own: own | {"q3": own["q1"]}, "step=0.01", "has no 'q3'; did you mean 'q2'"),
        (lambda own: own, "seconds=1", "tells neither step nor rtol"),
        (lambda own: own, "step=0.01 rtol=1e-3", "tells both a step and an rtol"),
        (lambda own: own, "step=0.01 length=2", "says length=2, and the scene has length=1.0"),
        (lambda own: own, "step=0.01 lenght=1", "did you mean 'length'?"),
        (lambda own: own, "step=0.01 scene=chain", "is a run of chain"),
        (lambda own: own, "step=0.01 seconds=-1", "give a number from 0 up"),
        (lambda own: own, "step=0.01 residuals=inf", "give a number from 0 up"),
        (lambda own: own, "step=0.01 method=newmark", "'newmark' is not allowed"),
        (lambda own: {k: v[:1] for k, v in own.items()}, "step=0.01", "are judged: write more"),
    ],
)
def test_disorder_in_a_file_is_a_sentence(judged, tmp_path, change, facts, sentence):
    file = written(tmp_path / "run.csv", change(PENDULUM), facts)
    with pytest.raises(SpecError, match=re.escape(sentence)) as told:
        judged("pendulum", file)
    assert "run.csv" in str(told.value) or "method" in str(told.value)


SPOILT = [b"", b"PK\x03\x04 and no more", b"rows", b"\x93NUMPY"]


@pytest.mark.parametrize(
    ("name", "content", "sentence"),
    [
        ("run.csv", b"t;q1\n0,35;0,8\n0,36;0,8\n", "write numbers with a point"),
        ("run.csv", b"t,q1\n0,35,0,8\n", "the head has 2 columns"),
        ("run.csv", b"t,q1\n0.35,0.8\n0.36\n", "a cell for each column"),
        ("run.csv", b"t,q1\n0.35,0.8\n0.36,zero\n", "is not as expected: could not convert"),
        ("run.csv", b"t,q1,q1\n0.35,0.8,0.8\n", "has the column 'q1' twice"),
        ("run.csv", b"", "it is empty"),
        ("run.csv", b"t\n" + b"0.35\n" * (2 * exchange.MOST_ROWS + 1), "2 to 1000000 are judged"),
        *((f"run.{k}", text, rf"n.{k} is not as expected: .*\.$")
          for k in ("npz", "json") for text in SPOILT),
    ],
)  # fmt: skip
def test_a_file_that_is_no_table_is_a_sentence(judged, tmp_path, name, content, sentence):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(SpecError, match=sentence):
        judged("pendulum", tmp_path / name)


def test_rows_where_values_jump_are_compared_in_their_phases(judged, worker, tmp_path):
    scene = worker.problem("bouncing_ball")
    t = np.linspace(*scene.interval, 301)
    exact = worker.reference(scene, scene.interval[1])(t)
    names = {f"{g}{i + 1}": c for g in ("q", "v") for i, c in enumerate(exact[g].T)}
    file = written(tmp_path / "ball.csv", {"t": t} | names)
    ((record, _),) = judged("bouncing_ball", file).results
    assert record.status == "ok"
    assert max(record.error("q", "max"), record.error("v", "max")) < 1e-14


def test_files_of_one_method_have_one_end_and_different_steps(judged, tmp_path):
    short = {name: column[:50] for name, column in PENDULUM.items()}
    one = written(tmp_path / "one.csv", PENDULUM)
    for columns, facts, sentence in (
        (PENDULUM, "step=0.01", "the step or tolerance of a file before"),
        (short, "step=0.02", "have end times 0.84, 1.35"),
        (PENDULUM, "step=0.02 method=b", "methods"),
        (PENDULUM, "rtol=1e-3", "others tolerances"),
    ):
        other = written(tmp_path / "other.csv", columns, facts)
        with pytest.raises(SpecError, match=sentence):
            judged("pendulum", one, other)


@pytest.mark.parametrize(
    "name", ["pendulum[length=2.0]", "bouncing_ball", *long("slider_crank", "quarter_car")]
)
def test_a_template_has_the_start_of_the_scene(judged, worker, tmp_path, name):
    text = template(worker, name)
    *_, head, first = text.splitlines()
    later = first.split(",")
    later[0] = repr(float(later[0]) + 0.01)
    (tmp_path / "rows.csv").write_text(f"{text}{','.join(later)}\n")
    ((record, _),) = judged(name, tmp_path / "rows.csv").results
    assert record.status == "ok"
    names = [n.rstrip("0123456789") for n in head.split(",")]
    assert names[0] == "t"
    assert set(names[1:]) <= set(VARIABLES)


@pytest.mark.skipif(not shutil.which("cc"), reason="There is no C compiler.")
def test_the_program_of_the_document_is_built_and_judged(judged, tmp_path):
    document = (Path(__file__).parents[1] / "docs" / "judge.md").read_text(encoding="utf-8")
    (program,) = re.findall(r"^```c\n(.*?)^```$", document, re.DOTALL | re.MULTILINE)
    (tmp_path / "heun.c").write_text(program)
    build, command = re.findall(r"^(cc .*?) && |^(stepbench judge.*)$", document, re.MULTILINE)
    assert build[0] == "cc heun.c -o heun -lm"
    assert command[1].endswith("heun200.csv heun400.csv heun800.csv --out stepbench-results")
    subprocess.run(build[0].split(), check=True, cwd=tmp_path)
    files = []
    for steps in (200, 400, 800):
        run = subprocess.run([tmp_path / "heun", str(steps)], check=True, capture_output=True)
        files.append(tmp_path / f"heun{steps}.csv")
        files[-1].write_bytes(run.stdout)
    found = [record for record, _ in judged("duffing", *files).results]
    for group in "qva":
        errors = [record.error(group, "max") for record in found]
        assert slope([record.h for record in found], errors) == pytest.approx(2, abs=0.05)
        assert errors[-1] < 1e-4


@pytest.mark.long
@pytest.mark.skipif(not shutil.which("cc"), reason="There is no C compiler.")
def test_a_program_in_c_stands_in_a_report_beside_the_same_method_of_the_bench(
    judged, worker, stepbench, tmp_path
):
    compiled = ["cc", "-O1", "-o", tmp_path / "crank", YARDSTICK, "-lm"]
    subprocess.run(compiled, check=True)
    files = []
    for steps in (250, 500, 1000):
        run = [tmp_path / "crank", str(steps), "1.0", "0.8", "ga_in_c"]
        files.append(tmp_path / f"{steps}.csv")
        files[-1].write_bytes(subprocess.run(run, check=True, capture_output=True).stdout)
    folder = tmp_path / "results"
    shown = stepbench("judge", "slider_crank", *files, "--out", folder).output
    assert "settled         2.00  2.00  2.00  2.00" in shown
    with Store(folder) as store:
        found = sorted(store.records().values(), key=lambda r: -(r.h or 0.0))
        (plan, machines) = store.plan(), store.environments()
    assert [r.integrator for r in found] == ["ga_in_c"] * 3
    assert all(r.run_s and machines[r.environment].cpu == "as told by the author" for r in found)
    assert plan.integrators["ga_in_c"].source.startswith("as told by the author: seconds, counts")
    page = next((folder / "report").glob("method-ga_in_c*")).read_text(encoding="utf-8")
    assert "as told by the author: seconds, counts" in page
    assert "stepbench stability" not in page
    scene = worker.problem("slider_crank")
    method = worker.registry.integrator("generalized_alpha[rho_inf=0.8]")
    # By one reference: the sizes by which errors are divided depend on its steps.
    for record, _ in judged("slider_crank", *files).results:
        run = method.prepare(scene, 1.0, Steps(record.h)).measure()
        own = relative_errors(run, worker.reference(scene, 1.0)).errors
        for group in ("q", "v", "a", "lam"):
            assert record.error(group, "max") == pytest.approx(own[group]["max"], rel=1e-6)
