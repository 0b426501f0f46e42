"""Pictures: many processes draw what one draws; no picture has more lines than can be read."""

from __future__ import annotations

import contextlib
import csv
import io
import json
import math
import os
import re
import signal
import subprocess
import sys

import psutil
import pytest
from planted import Document, plant, planted, whole_markdown, whole_report

from reports.charts import rendering
from reports.pages.html_report import write_html_report
from reports.pages.markdown_report import _FIGURES as FIGURES
from reports.pages.markdown_report import write_markdown_report


def line(name, text="a,b\n1,2\n"):
    return {
        "datasets": {name: text},
        "data": {"name": name, "format": {"type": "csv"}},
        "mark": "line",
        "encoding": {f: {"field": k, "type": "quantitative"} for f, k in (("x", "a"), ("y", "b"))},
        "config": {"axis": {"labelColor": "#123456"}},
    }


CHARTS = {f"chart-{k}": line(f"d{k}", f"a,b\n1,{k}\n2,{2 * k}\n") for k in range(5)}


def drawn(folder):
    # Numbers in the names of clips and gradients count on within one process.
    return {f.name: re.sub(r"(clip|gradient_)\d+", r"\1", f.read_text()) for f in folder.iterdir()}


@pytest.mark.long
def test_two_engines_draw_what_one_draws_and_are_kept(tmp_path, monkeypatch):
    assert rendering.draw(CHARTS, tmp_path / "one") == {}
    monkeypatch.setattr(rendering, "PART_SIZE", 400)
    monkeypatch.setattr(rendering, "cores", lambda: 2)
    rendering.draw(CHARTS, tmp_path / "two")
    engines = list(rendering._idle)
    assert len(engines) >= 2
    rendering.draw(CHARTS, tmp_path / "two")
    assert set(rendering._idle) == set(engines)
    assert drawn(tmp_path / "one") == drawn(tmp_path / "two")
    assert set(drawn(tmp_path / "one")) == {f"{name}.svg" for name in CHARTS}
    assert "#123456" in drawn(tmp_path / "one")["chart-0.svg"]


@pytest.mark.parametrize("worth", [10**9, 100])
def test_a_chart_that_cannot_be_drawn_says_so(tmp_path, monkeypatch, worth):
    monkeypatch.setattr(rendering, "PART_SIZE", worth)
    monkeypatch.setattr(rendering, "cores", lambda: 2)
    charts = {"good": line("good", "a,b\n" + "1,2\n" * 99), "bad": {"mark": "no such mark"}}
    failed = rendering.draw(charts, tmp_path)
    assert list(failed) == ["bad"]
    assert failed["bad"].sentence.startswith("This chart cannot be drawn: ")
    assert set(drawn(tmp_path)) == {"good.svg"}


#: A chart that takes minutes.
MANY = {"data": {"sequence": {"start": 0, "stop": 10_000_000}}, "mark": "point"}


def dangerous(monkeypatch):
    """Charts reach the engines as they are, unclean."""
    monkeypatch.setattr(rendering, "chart_json", json.dumps)
    return line("bad") | {"title": "a\0b"}


def test_a_chart_that_ends_its_engine_costs_no_other(monkeypatch):
    # vl-convert's text measuring panics at a NUL, and takes its process along.
    bad = dangerous(monkeypatch)
    found = rendering.pictures({"one": CHARTS["chart-0"], "bad": bad, "two": CHARTS["chart-1"]})
    assert [name for name, picture in found.items() if picture.content] == ["one", "two"]
    assert "The process died while running (SIGABRT)" in found["bad"].sentence


def test_what_would_end_an_engine_is_cleaned_before():
    numbers = {"data": {"values": [{"a": math.inf, "b": math.nan}]}}
    for text in ("a\0b", "\ud800", "\x1b[31m", "\uffff", "</script>", "\u202e"):
        svg = rendering.picture(line("bad") | numbers | {"title": text}).svg
        assert svg.startswith("<svg"), svg
        assert not set(svg) & set("\0\x1b\uffff\u202e")


def test_an_engine_that_was_killed_is_replaced():
    assert rendering.picture(CHARTS["chart-0"]).content
    for engine in rendering._idle:
        os.kill(engine.pid, signal.SIGKILL)
    assert rendering.picture(CHARTS["chart-0"]).content


@pytest.mark.long
def test_an_engine_that_does_not_end_is_stopped(monkeypatch):
    monkeypatch.setattr(rendering, "LONGEST_DRAWING", 0.3)
    rendering._end_engines()
    assert "more than 0.3 s of processor time" in rendering.picture(MANY).sentence
    rendering._end_engines()


@pytest.mark.long
@pytest.mark.skipif(sys.platform != "linux", reason="a signal of Linux")
def test_engines_end_with_their_parent_though_they_draw():
    code = (
        "import os, threading; from reports.charts import rendering; "
        "engine = rendering._engine(); rendering._idle.append(engine); "
        "assert rendering.picture({'mark': 'point'}).content; print(engine.pid, flush=True); "
        "threading.Timer(1.5, os.kill, (os.getpid(), 9)).start(); "
        f"rendering.picture({MANY!r})"
    )
    told = subprocess.run([sys.executable, "-P", "-c", code], capture_output=True, check=False)
    assert told.returncode == -9
    with contextlib.suppress(psutil.NoSuchProcess):
        psutil.Process(int(told.stdout)).wait(2)


@pytest.mark.long
def test_a_drawing_process_does_not_import_what_lies_where_the_user_stands(tmp_path):
    (tmp_path / "reports").mkdir()
    (tmp_path / "reports" / "__init__.py").write_text("raise SystemExit('the wrong one')")
    code = (
        "from pathlib import Path; from reports.charts import rendering; "
        "rendering.PART_SIZE, rendering.cores = 1, lambda: 2; "
        f"rendering.draw({ {k: CHARTS[k] for k in list(CHARTS)[:2]}!r}, Path('out'))"
    )
    subprocess.run([sys.executable, "-P", "-c", code], cwd=tmp_path, check=True)
    assert len(list((tmp_path / "out").iterdir())) == 2


@pytest.fixture(scope="module")
def crowd(tmp_path_factory):
    """30 integrators, of which the later ones err less in q; the last one failed."""
    records = [
        planted("pendulum", f"m{k:02}", {g: (1.0 / (k + 1), 2) for g in ("q", "a")}, h=h)
        for k in range(29)
        for h in (0.1, 0.05, 0.025)
    ]
    failed = {"status": "crashed", "errors": {}}
    records += [planted("pendulum", "m29", {}, h=h, **failed) for h in (0.1, 0.05, 0.025)]
    return plant(tmp_path_factory.mktemp("crowd"), records)


def labels(chart):
    """The integrators that the legend of a chart names."""
    return set(re.findall(r">(m\d\d)[:<,]", chart))


def test_a_still_picture_shows_the_most_accurate_of_a_crowd_and_says_so(crowd):
    text = whole_markdown(write_markdown_report(crowd).parent)
    figures = crowd / FIGURES
    best = [f"m{k:02}" for k in range(28, -1, -1)]
    for name, most in (("convergence-max", 24), ("work_precision", 24), ("trajectory", 12)):
        chart = (figures / f"scene-1-1-{name}.svg").read_text()
        assert labels(chart) == set(best[:most]), name
        assert f"Of 30 integrators those {most} are shown that err least in q." in text


def test_a_chart_that_answers_shows_the_errors_of_all_and_few_lines_over_time(crowd):
    write_html_report(crowd)
    page = Document(whole_report(crowd))
    rows = csv.DictReader(io.StringIO(page.charts["scene-1-1-work_precision"]["datasets"]["runs"]))
    assert {row["series"] for row in rows} == {f"m{k:02}" for k in range(29)}
    rows = csv.DictReader(io.StringIO(page.charts["scene-1-1-trajectory"]["datasets"]["runs"]))
    assert len({row["series"] for row in rows}) == 12
    assert "Of 30 integrators those 12 are shown" in page.words
    assert "those 24 are shown" not in page.words
