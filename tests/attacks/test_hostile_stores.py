"""Attacks on stores: hostile texts, numbers at the limits, names that are paths, and anything."""

from __future__ import annotations

import json
import random
import re
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path

import msgspec
import pytest
from planted import Document, everything, plant, whole_markdown, whole_report
from stores import PLACES, change

from bench.results.records import Record, Rows
from bench.results.store import FILE, Store
from reports.charts import rendering
from reports.figures import write_figure
from reports.pages import catalogue
from reports.pages.html_report import write_html_report
from reports.pages.markdown_report import write_markdown_report

# ---- hostile texts, numbers and names ----------------------------------------------------
TEXTS = {
    "NUL": "a\0b",
    "escape sequence": "\x1b[31mred\x1b]0;title\x07",
    "C1": "\x9b31m",
    "bidi": "\u202eevil\u2066",
    "surrogate": "half \ud800",
    "no character": "\uffff\ufffe",
    "script": "</script><script>window.came = 1</script>",
    "HTML": "<img src=x onerror=alert(1)>&\"'",
    "comment": "<!--<script>",
    "Markdown": "|a|\n# h\n`c` *e* [l](javascript:x) ![i](x)",
    "template": "{{ 7 * 7 }}{% raw %}",
    "formula": "=cmd|' /C calc'!A0",
    "Vega": "datum.x'\"]; alert(1)",
    "line breaks": "a\r\nb\u2028c\td",
    "emoji": "👩‍👩‍👧 é 中",
    "long": "x" * 10_000,
    "empty": "",
    "1 MB": "word " * 200_000,
}
SLOW = ("long", "1 MB")
NUMBERS = [1e308, 1.7976931348623157e308, 1e-300, 5e-324, 0.0, -0.0, 1e15]


def hostile(folder: Path, edit: Callable[[Record], None]) -> Path:
    """The store with edited records, in its own plan."""
    with Store(folder, create=True) as store:
        for key, record in store.records().items():
            rows, samples, record.run_s = store.rows(key), record.run_s, []
            edit(record)
            store.save(record, rows)
            for k, seconds in enumerate(samples):
                store.add_sample(record.key, k, seconds)
    return folder


def with_text(folder: Path, text: str) -> Path:
    """The text wherever text stands in a store."""

    def edit(record: Record) -> None:
        record.message = text
        if record.integrator == "poor":
            record.integrator = record.family = record.formulation = text

    hostile(folder, edit)
    with Store(folder, create=True) as store:
        for scene in store.scenes().values():
            for name in ("title", "description", "source", "reference_method"):
                setattr(scene, name, text)
            scene.parameters = [{"name": text, "value": text, "unit": text, "doc": text}]
            scene.components = {"q": [text, f"{text} [{text}]"]}
            scene.tags = scene.difficulties = scene.equations = [text]
            store.save_scene(scene)
        plan = store.plan()
        assert plan
        studies = [msgspec.structs.replace(s, title=text, note=text) for s in plan.studies]
        store.save_plan(msgspec.structs.replace(plan, title=text, studies=studies))
        environment = store.environments()[1]
        environment.command = environment.cpu = text
        store.save_environment(environment)
    return folder


def pages(folder: Path) -> Iterator[str]:
    """Both pages of a store."""
    write_html_report(folder)
    yield whole_report(folder)
    yield whole_markdown(write_markdown_report(folder).parent)


def quickly(monkeypatch: pytest.MonkeyPatch) -> None:
    """Draw the pictures of pages as empty ones: drawing takes seconds."""
    drawn = rendering.Picture(b"<svg/>")
    monkeypatch.setattr(rendering, "pictures", lambda charts: dict.fromkeys(charts, drawn))


def sound(html: str, markdown: str, charts: int) -> None:
    """The page has its charts, as data that a browser reads, and no script of others."""
    page = Document(html)
    programs = re.findall(r"<script>(.{0,3})", html)
    assert programs == ["// "] * page.scripts.count("inline")
    kinds = {s for s in page.scripts if not s.endswith(".js")}
    assert {"inline"} <= kinds <= {"application/json", "inline"}
    assert len(page.charts) >= charts
    assert "NaN" not in json.dumps(list(page.charts.values()))
    assert markdown.count("![") + markdown.count("cannot be drawn") >= charts
    for text in (html, markdown):
        assert not set(text) & set("\0\x1b\x9b\u202e\u2066\uffff\ufffe")


@pytest.mark.attack
@pytest.mark.parametrize("name", TEXTS)
def test_no_text_stops_a_page_or_a_picture(folder, name):
    with_text(folder, TEXTS[name])
    html, markdown = pages(folder)
    sound(html, markdown, charts=10)
    # In code nothing is HTML.
    assert "<script" not in re.sub("`[^`]*`", "", markdown)


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=pytest.mark.attack if n in SLOW else ()) for n in TEXTS]
)
def test_no_text_stops_a_figure_an_export_or_a_comparison(good, folder, tmp_path, stepbench, name):
    with_text(folder, TEXTS[name])
    picture = tmp_path / "a.svg"
    write_figure("work_precision", folder, picture, scene="spring_mass")
    assert picture.read_bytes().startswith(b"<svg")
    rows = stepbench("export", folder)
    compared = stepbench("compare", good, folder)
    for result in (rows, compared):
        assert result.exit_code == 0, result.output
        assert not set(result.output) & set("\0\x1b\x9b\u202e\uffff")
    assert not any(line.startswith("=") for cell in rows.stdout.split(",") for line in [cell])


def with_number(folder: Path, number: float, k: int) -> Path:
    """The number wherever one is allowed, in every k-th record."""
    count = iter(range(10_000))

    def edit(record: Record) -> None:
        if next(count) % k:
            return
        record.errors = {g: dict.fromkeys(norms, abs(number)) for g, norms in record.errors.items()}
        record.reference_error = {
            g: dict.fromkeys(norms, abs(number)) for g, norms in record.reference_error.items()
        }
        record.constraint = dict.fromkeys(record.constraint, abs(number))
        record.operations = {"residuals": abs(number)}
        record.energy_drift = record.compile_s = abs(number)

    hostile(folder, edit)
    with Store(folder, create=True) as store:
        for scene in store.scenes().values():
            scene.drawings = [
                {"t": number, "lines": [[(number, -number), (None, 0.0), (1.0, 2.0)]]}
            ]
            scene.reference = Rows(t=[number, number], values={"q": [[number], [-number]]})
            scene.nominal_step = number
            scene.rates = dict.fromkeys(("fastest", "slowest", "decay", "oscillation"), number)
            store.save_scene(scene)
    change(folder, "UPDATE samples SET seconds = ? WHERE number = 1 AND ? > 0", number, number)
    return folder


@pytest.mark.attack
@pytest.mark.parametrize("k", [1, 2, 5])
@pytest.mark.parametrize("number", NUMBERS)
def test_no_number_stops_a_page_or_a_picture(folder, number, k):
    sound(*pages(with_number(folder, number, k)), charts=4)


@pytest.mark.parametrize("number", NUMBERS)
def test_no_number_stops_an_export_or_a_comparison(good, folder, stepbench, number):
    with_number(folder, number, 2)
    for command in (("export", folder), ("compare", good, folder), ("compare", folder, good)):
        result = stepbench(*command)
        assert result.exit_code == 0, result.output


@pytest.mark.parametrize("count", [0, 1])
def test_a_store_of_hardly_anything_has_pages(tmp_path, monkeypatch, count):
    quickly(monkeypatch)
    records = [r for r in everything() if r.problem == "pendulum"][:count]
    plant(tmp_path, records, samples=count)
    sound(*pages(tmp_path), charts=0)


NAMES = {
    "path": "../../../tmp/x",
    "root": "/etc/passwd",
    "newline": "a\nb",
    "emoji": "👻",
    "drive": "C:\\x:y",
    "long": "n" * 10_000,
    "dots": "..",
    "space": " a b ",
}


@pytest.mark.parametrize("name", NAMES)
def test_no_name_leaves_the_folder(folder, tmp_path, stepbench, monkeypatch, name):
    quickly(monkeypatch)

    def edit(record: Record) -> None:
        record.problem = NAMES[name]
        record.key = f"{NAMES[name]} | {record.key}"

    with Store(folder, create=True) as store:
        for scene in store.scenes().values():
            scene.problem = NAMES[name]
            store.save_scene(scene)
    hostile(folder, edit)
    outside = {path for path in tmp_path.rglob("*") if folder not in path.parents}
    write_markdown_report(folder)
    for command in (("export", folder), ("compare", folder, folder, "--out", folder / "c")):
        assert stepbench(*command).exit_code == 0
    result = stepbench(
        "figure", folder, "trajectory", "-o", folder / "a.json", "--scene", NAMES[name]
    )
    assert result.exit_code in (0, 1)
    assert "Traceback" not in result.output
    assert {path for path in tmp_path.rglob("*") if folder not in path.parents} == outside


@pytest.mark.parametrize("name", NAMES)
def test_no_picture_of_a_catalogue_leaves_its_folder(folder, tmp_path, monkeypatch, name):
    with Store(folder) as store:
        scene = next(iter(store.scenes().values()))
    scene.problem = NAMES[name]
    drawn = rendering.Picture(b"<svg/>")
    monkeypatch.setattr(catalogue, "pictures", lambda charts: dict.fromkeys(charts, drawn))
    before = set(tmp_path.rglob("*"))
    catalogue.write_catalogue([scene], tmp_path / "c")
    new = {path.relative_to(tmp_path) for path in set(tmp_path.rglob("*")) - before}
    assert {path.parts[0] for path in new} == {"c"}
    (picture,) = (path for path in new if path.suffix == ".svg")
    assert picture.parent == Path("c", catalogue.PICTURES)


# ---- anything, anywhere ------------------------------------------------------------------
VALUES = (
    *(
        None,
        True,
        0,
        -0.0,
        -1,
        1e308,
        -1e308,
        5e-324,
        10**30,
        1e-300,
        0.5,
        "",
        [],
        {},
        [None],
        [[]],
    ),
    *("a\0b", "\x1b[31m", "</script>", "\u202ex", "=1+1", "|x|`*_[a](b)$", "../../etc", "x" * 300),
)


def leaves(value: object, path: tuple = ()) -> Iterator[tuple]:
    yield path
    if isinstance(value, dict):
        for key in value:
            yield from leaves(value[key], (*path, key))
    elif isinstance(value, list):
        for key in range(min(len(value), 3)):
            yield from leaves(value[key], (*path, key))


def put(value, path: tuple, new: object):
    if not path:
        return new
    value[path[0]] = put(value[path[0]], path[1:], new)
    return value


@pytest.mark.parametrize(
    "seed", [pytest.param(s, marks=pytest.mark.attack if s >= 10 else ()) for s in range(200)]
)
def test_anything_anywhere_costs_no_more_than_rows(good, folder, stepbench, monkeypatch, seed):
    chance = random.Random(seed)
    with closing(sqlite3.connect(folder / FILE)) as db, db:
        for _ in range(chance.randint(1, 6)):
            table, column, _ = PLACES[chance.choice(list(PLACES))]
            rows = db.execute(f"SELECT rowid, {column} FROM {table}").fetchall()
            number, raw = chance.choice(rows)
            try:
                value = json.loads(raw)
            except ValueError:  # the number of the schema, or spoilt before
                continue
            if not isinstance(value, dict):
                continue
            value = put(value, chance.choice(list(leaves(value))), chance.choice(VALUES))
            spoilt = json.dumps(value).encode()
            db.execute(f"UPDATE {table} SET {column} = ? WHERE rowid = ?", (spoilt, number))
    if seed < 10:
        quickly(monkeypatch)
    html, markdown = pages(folder)
    assert "<h1>" in html
    assert markdown.startswith("# ")
    for command in (("export", folder), ("compare", good, folder), ("compare", folder, good)):
        result = stepbench(*command)
        assert result.exit_code == 0, result.output
