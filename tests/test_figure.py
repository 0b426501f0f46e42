"""Single figures: their numbers are those of the store, their look is fit for paper."""

import json
import re
import struct
from itertools import product
from pathlib import Path
from xml.etree import ElementTree

import altair
import pytest
from helpers import long
from planted import chart_rows as rows
from planted import everything, plant, planted

from bench.results.records import Record, Rows
from bench.results.store import Store
from problems.base.spec import SpecError
from reports import figures
from reports.series import series_of


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = plant(tmp_path_factory.mktemp("planted"), everything())
    with Store(path, create=True) as store:
        for record in store.records().values():
            rows = store.rows(record.key)
            scaled = {g: [[x * (1 + record.h) for x in row] for row in values]
                      for g, values in rows.values.items()}  # fmt: skip
            notes = {"error_a": [1e-3 * t for t in rows.t]}
            store.save(record, Rows(t=rows.t, values=scaled, notes=notes))  # curves of its own
    return path


def stored(folder: Path, problem: str) -> list[Record]:
    with Store(folder) as store:
        return [r for r in store.records().values() if r.problem == problem and r.status == "ok"]


def test_errors_over_costs_and_steps_are_those_of_the_store(folder):
    for error, over in product(("a:max", "lam:end"), ("residuals", "seconds", "steps", "h")):
        kind, more = ("convergence", {}) if over == "h" else ("work_precision", {"cost": over})
        figure = figures.figure(kind, folder, scene="pendulum", error=error, **more)
        group, norm = error.split(":")
        column = f"{group}_{norm}"
        known = [r for r in stored(folder, "pendulum") if over != "h" or r.controls == "step"]
        costs = {r.key: r.h if over == "h" else r.cost(over) for r in known}
        assert {
            (r["series"], r["run"], float(r[column]), r[over]) for r in rows(figure, "runs")
        } == {
            (r.integrator, r.resolution, float(f"{r.errors[group][norm]:.5g}"), text(costs[r.key]))
            for r in known
        }
        points = next(x for x in figure["layer"] if x["mark"]["type"] == "point")["encoding"]
        assert (points["x"]["field"], points["y"]["field"]) == (over, column)
        names = [v["name"] for x in figure["layer"] for v in x.get("data", {}).get("values", [])]
        assert names == ["order 2", "order 2"] * (over == "h")  # a line and its text


def text(value):
    """A number as charts have it."""
    if value is None or isinstance(value, int):
        return "" if value is None else str(value)
    return str(float(f"{value:.5g}"))


def test_a_trajectory_shows_the_finest_run_of_each_and_the_reference(folder):
    for component, group, place, title in (
        ("a:Y", "a", 1, "a[Y] in m/s^2"),
        ("a:2", "a", 1, "a[Y] in m/s^2"),
        ("lam", "lam", 0, "lam[1]"),
    ):
        figure = figures.figure("trajectory", folder, scene="pendulum", component=component)
        chosen = series_of(stored(folder, "pendulum"))
        finest = [s.ok[-1] for s in chosen]
        field, drawn = f"{group}{place}", rows(figure, "runs")
        shown = [(float(r["t"]), r["series"], float(r[field])) for r in drawn]
        with Store(folder) as store:
            known = [store.rows(record.key) for record in finest]
            reference = store.scenes()["pendulum", 1.0].reference
        assert shown == [
            (float(f"{t:.5g}"), s.label, float(f"{values[place]:.5g}"))
            for s, run in zip(chosen, known, strict=True)
            for t, values in zip(run.t, run.values[group], strict=True)
        ]
        behind = [float(r[field]) for r in rows(figure, "reference")]
        assert behind == [float(f"{values[place]:.5g}") for values in reference.values[group]]
        assert figure["layer"][-1]["encoding"]["y"]["title"] == title


def test_integrators_are_chosen_by_name_or_spec_in_the_order_given(folder):
    def names(*integrators):
        chart = figures.figure("work_precision", folder, scene="pendulum", integrators=integrators)
        return list(dict.fromkeys(row["series"] for row in rows(chart, "runs")))

    assert names("adaptive", "good[rho_inf=0.5]") == ["adaptive", "good[rho_inf=0.5]"]
    assert names("good") == ["good[rho_inf=0.8]", "good[rho_inf=0.5]"]
    assert len(names()) == 4


def test_the_only_scene_needs_no_name_and_intervals_are_chosen(tmp_path):
    runs = [
        planted("pendulum[l=2]", "m", {"q": (t, 2)}, h=0.1, t_end=t, key=str(t)) for t in (1.0, 5.0)
    ]
    with Store(tmp_path, create=True) as store:
        for run in runs:
            store.save(run, Rows(t=[]))
    with pytest.raises(SpecError, match=r"to t=1, 5 s; choose one with --t-end"):
        figures.figure("work_precision", tmp_path)
    for scene in (None, "pendulum", "pendulum[l=2]"):
        figure = figures.figure("work_precision", tmp_path, scene=scene, t_end=5.0)
        assert float(rows(figure, "runs")[0]["q_max"]) == pytest.approx(0.05)


# ---- paper -------------------------------------------------------------------------------
@pytest.mark.parametrize("kind", ["work_precision", *long("convergence", "trajectory")])
def test_a_figure_is_as_wide_as_a_column_in_every_format(folder, tmp_path, stepbench, kind):
    files = {suffix: tmp_path / f"fig.{suffix}" for suffix in ("svg", "png", "pdf", "json")}
    for file in files.values():
        result = stepbench("report", folder, "--figure", kind, "--scene", "pendulum", "-o", file)
        assert result.exit_code == 0, result.output
        assert f"Figure: {file}" in result.output
    drawing = ElementTree.parse(files["svg"]).getroot()
    assert drawing.get("width") == "250pt"
    words = " ".join(text for text in drawing.itertext())
    assert "good 0.8" in words  # its short name
    assert "good[rho_inf=0.8]" not in words
    assert "undefined" not in words
    assert "NaN" not in files["svg"].read_text()
    image = files["png"].read_bytes()
    wide, _ = struct.unpack(">II", image[16:24])
    place = image.index(b"pHYs")
    per_metre, _ = struct.unpack(">II", image[place + 4 : place + 12])
    assert wide / per_metre == pytest.approx(0.0882, rel=0.01)  # 250 points in m
    box = re.search(rb"/MediaBox \[0 0 (\S+) ", files["pdf"].read_bytes())
    assert float(box.group(1)) == pytest.approx(250, abs=0.5)
    figure = json.loads(files["json"].read_text())
    assert "vega-lite" in figure["$schema"]
    altair.Chart.from_dict(figure)  # checks it against the schema
    assert figure["config"]["background"] == "white"
    assert figure["config"]["axis"]["tickWidth"] <= 0.5


def test_figures_are_refused_in_one_sentence(folder, refused, tmp_path):
    Store(tmp_path, create=True).close()
    empty = refused("report", tmp_path, "--figure", "convergence")
    assert "The store holds no finished run" in empty
    for arguments, words in (
        ("work_precison --scene pendulum", "did you mean 'work_precision'"),
        ("convergence", "choose one with --scene: spring_mass, pendulum"),
        ("convergence --scene pendulm", "did you mean 'pendulum'"),
        ("convergence --scene pendulum --error x", "no error of 'x'; known: a, lam"),
        ("convergence --scene pendulum --error q:maxi", "did you mean 'max'"),
        ("convergence --scene pendulum --cost steps", "has no --cost; it takes"),
        ("convergence --scene pendulum -i adaptive", "nothing to draw"),
        ("convergence --scene pendulum -i fragile", "reached the end"),
        ("convergence --scene pendulum -i god", "There is no integrator 'god'"),
        ("convergence --scene pendulum --t-end 3", "stored to t=1 s"),
        ("work_precision --scene pendulum --cost step", "did you mean 'steps'"),
        ("trajectory --scene pendulum --error a:max", "has no --error; it takes"),
        ("trajectory --scene pendulum --component x:1", "no component 'x'"),
        ("trajectory --scene pendulum --component q:Z", "known: 1, 2, X, Y"),
        ("trajectory --scene pendulum -o a.gif", "ends in .svg, .png, .pdf, .json"),
        ("trajectory --scene pendulum -o no/such/a.svg", "there is no folder 'no/such'"),
    ):
        said = refused("report", folder, "--figure", *arguments.split())
        assert words in said, arguments


def test_errors_over_time_are_the_notes_of_the_finest_runs(folder):
    chart = figures.figure("errors_over_time", folder, scene="pendulum", error="a")
    ends = [row for row in rows(chart, "histories") if float(row["t"]) == 1.0]
    assert {float(row["error_a"]) for row in ends} == {1e-3}
    with pytest.raises(SpecError, match="no group 'b'"):
        figures.figure("errors_over_time", folder, scene="pendulum", error="b")
    with pytest.raises(SpecError, match="has stored errors of q over time"):
        figures.figure("errors_over_time", folder, scene="pendulum")
