"""Attacks on stores: spoilt rows, hostile texts, numbers at the limits, names that are paths.

A spoilt row costs itself alone: every command gives all others, and says what is left out.
"""

from __future__ import annotations

import json
import random
import re
import shutil
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace

import msgspec
import pytest
from planted import Document, everything, plant

from bench.results.experiments import CaseResult, ExperimentResult, PartResult
from bench.results.records import Damping, IntegratorFacts, Record, Rows
from bench.results.store import FILE, Store
from bench.running.session import missing_cells
from reports.charts import rendering
from reports.figures import write_figure
from reports.pages import catalogue
from reports.pages.html_report import write_html_report
from reports.pages.markdown_report import write_markdown_report

METHOD = "good[rho_inf=0.8]"
AN_EXPERIMENT = ExperimentResult(
    name="e",
    number=1,
    title="t",
    claim="c",
    remedy="r",
    source="s",
    parts=[
        PartResult(
            text="x",
            quantity="y",
            take="slope",
            healthy=(1.8, None),
            cases=[
                CaseResult(
                    label="l",
                    integrator=METHOD,
                    family="alpha",
                    axis="h",
                    x=[0.1, 0.05],
                    y=[1.0, 0.5],
                    number=1.0,
                    predicted=(0.9, 1.1),
                    as_predicted=True,
                    healthy=True,
                    history=([0.0, 1.0], [1.0, 2.0]),
                )
            ],
        )
    ],
)


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A store with two rows or more of every kind."""
    few = [
        record
        for record in everything()
        if (record.h or 0) >= 0.025
        and record.integrator not in ("good[rho_inf=0.5]", "ringing[rho_inf=1]")
        and (record.rtol or 1) > 1e-5
    ]
    folder = plant(tmp_path_factory.mktemp("stores") / "good", few)
    known = Damping(omega_h=[0.1, 1.0], radius=[0.9, None], ratio=[0.1, 0.2])
    with Store(folder, create=True) as store:
        store.save_damping(METHOD, known)
        store.save_damping("poor", known)
        store.save_experiment(AN_EXPERIMENT)
        store.save_experiment(msgspec.structs.replace(AN_EXPERIMENT, name="f", number=2))
        store.save_environment(store.environments()[1])
        plan = store.plan()
        assert plan
        facts = {METHOD: IntegratorFacts(title="G", orders={"q": 2}, source="S")}
        store.save_plan(msgspec.structs.replace(plan, integrators=facts))
    return folder


@pytest.fixture(scope="module")
def whole(good: Path) -> dict[str, dict]:
    """All that the good store gives."""
    return content(good)


@pytest.fixture
def folder(good: Path, tmp_path: Path) -> Path:
    """A copy of the good store, to be spoilt."""
    return shutil.copytree(good, tmp_path / "spoilt")


def change(folder: Path, sql: str, *values: object) -> None:
    """Change a store behind its back."""
    with closing(sqlite3.connect(folder / FILE)) as db, db:
        db.execute(sql, values)


def content(folder: Path) -> dict[str, dict]:
    """All that a store gives, by table and key."""
    with Store(folder) as store:
        records = store.records()
        return {
            "plan": {"plan": store.plan()} if store.plan() else {},
            "environments": store.environments(),
            "scenes": store.scenes(),
            "damping": store.damping(),
            "experiments": store.experiments(),
            "records": records,
            "rows": {key: rows for key in records if (rows := store.rows(key)) and rows.t},
        }


# ---- one spoilt row ----------------------------------------------------------------------
#: A row of each kind: table, column, the row's place, and the key under which it is read.
PLACES = {
    "plan": ("meta", "value", "name = 'plan'"),
    "environments": ("environments", "value", "id = 1"),
    "scenes": ("scenes", "value", "problem = 'pendulum'"),
    "damping": ("damping", "value", f"integrator = '{METHOD}'"),
    "experiments": ("experiments", "value", "name = 'e'"),
    "records": ("records", "value", f"key = 'pendulum | {METHOD} | h=0.1'"),
    "rows": ("records", "rows", f"key = 'pendulum | {METHOD} | h=0.1'"),
}
DAMAGES: dict[str, Callable[[bytes], object]] = {
    "not JSON": lambda raw: b"{" + raw,
    "cut": lambda raw: raw[: len(raw) // 2],
    "another type": lambda raw: b"[1]",
    "null": lambda raw: b"null",
    "no fields": lambda raw: b"{}",
    "text for a number": lambda raw: raw.replace(b"1.0", b'"one"').replace(b"0.1", b'"x"'),
    "not UTF-8": lambda raw: raw.replace(b'":', b'\xff\xfe":', 1),
    "empty": lambda raw: b"",
    "zeros": lambda raw: bytes(len(raw)),
    "a number": lambda raw: 7,
    "huge": lambda raw: b"[" * 2_000_000,
    "deep": lambda raw: b'{"x":' * 100_000 + b"1" + b"}" * 100_000,
}


def spoil(folder: Path, kind: str, damage: str) -> None:
    table, column, where = PLACES[kind]
    with closing(sqlite3.connect(folder / FILE)) as db, db:
        (raw,) = db.execute(f"SELECT {column} FROM {table} WHERE {where}").fetchone()
        spoilt = DAMAGES[damage](raw)
        assert spoilt != raw
        db.execute(f"UPDATE {table} SET {column} = ? WHERE {where}", (spoilt,))


@pytest.mark.parametrize("damage", DAMAGES)
@pytest.mark.parametrize("kind", PLACES)
def test_one_spoilt_row_costs_itself_alone(whole: dict, folder: Path, kind: str, damage: str):
    spoil(folder, kind, damage)
    before, after = whole, content(folder)
    lost = {k: [key for key in before[k] if key not in after[k]] for k in before}
    # The sampled values of a record that cannot be read are not asked for.
    assert {k for k, keys in lost.items() if keys} == {kind} | (
        {"rows"} & {kind, "rows"} if (kind == "records") else set()
    )
    assert len(lost[kind]) == 1
    for k, rows in after.items():
        assert rows == {key: before[k][key] for key in rows}
    with Store(folder) as store:
        assert [row.table for row in store.set_aside()] == [kind]


def told(result, folder: Path) -> None:
    """The command went on and said what is left out."""
    assert result.exit_code == 0, result.output
    assert "Traceback" not in result.output
    assert f"{folder}: 1 row of the store cannot be read and left out" in result.stderr


@pytest.mark.parametrize(
    ("kind", "damage"),
    [
        pytest.param(kind, damage, marks=() if quick else pytest.mark.attack)
        for k, kind in enumerate(PLACES)
        for j, damage in enumerate(DAMAGES)
        for quick in [j == k]
    ],
)
def test_commands_give_all_other_rows(good, folder, tmp_path, stepbench, kind, damage):
    spoil(folder, kind, damage)
    keys = set(content(folder)["records"])
    as_json = stepbench("export", folder, "--json")
    told(as_json, folder)
    assert {row["key"] for row in json.loads(as_json.stdout)} == keys
    as_csv = stepbench("export", folder, "-o", tmp_path / "a.csv")
    told(as_csv, folder)
    compared = stepbench("compare", good, folder, "--json")
    told(compared, folder)
    assert json.loads(compared.stdout)["shared"] == len(keys)
    merged = stepbench("merge", folder, folder, "--out", tmp_path / "all")
    told(merged, folder)
    assert set(content(tmp_path / "all")["records"]) == keys
    figure = stepbench(
        *("figure", folder, "convergence", "--scene", "pendulum", "-o", tmp_path / "a.json")
    )
    told(figure, folder)


@pytest.mark.attack
@pytest.mark.parametrize("damage", DAMAGES)
@pytest.mark.parametrize("kind", PLACES)
def test_pages_say_what_is_left_out(folder, stepbench, kind, damage):
    spoil(folder, kind, damage)
    told(stepbench("report", folder), folder)
    for name in ("report.html", "report.md"):
        text = (folder / name).read_text(encoding="utf-8")
        assert text.index("1 row of the store cannot be read") < text.index(
            "Summary</h2>" if (name.endswith("html")) else "## Summary"
        )


@pytest.mark.parametrize("kind", ["records", "rows"])
def test_a_run_measures_spoilt_cells_anew(folder: Path, kind: str):
    spoil(folder, kind, "cut")
    with Store(folder) as store:
        names = [*store.records(), f"pendulum | {METHOD} | h=0.1"]
        cells = {
            key: SimpleNamespace(key=key, fingerprint=lambda registry: "")
            for key in sorted({*names})
        }
        suite = SimpleNamespace(cells=cells, plan=SimpleNamespace(budget_s=1.0))
        missing = missing_cells(suite, store, None)  # type: ignore[arg-type]
    assert [cell.key for cell in missing] == [f"pendulum | {METHOD} | h=0.1"]


SPOILT_SAMPLES = {
    "text": "INSERT OR REPLACE INTO samples SELECT key, 0, 'soon' FROM records LIMIT 1",
    "negative": "INSERT OR REPLACE INTO samples SELECT key, 0, -1.0 FROM records LIMIT 1",
    "zero": "INSERT OR REPLACE INTO samples SELECT key, 0, 0 FROM records LIMIT 1",
    "infinite": "INSERT OR REPLACE INTO samples SELECT key, 0, 9e999 FROM records LIMIT 1",
    "blob": "INSERT OR REPLACE INTO samples SELECT key, 0, x'ff' FROM records LIMIT 1",
    "number is text": "INSERT INTO samples SELECT key, 'first', 1.0 FROM records LIMIT 1",
    "orphan": "INSERT INTO samples VALUES ('nobody', 0, 1.0)",
    "orphan of a blob": "INSERT INTO samples VALUES (x'fffe', 0, 1.0)",
}


@pytest.mark.parametrize("how", SPOILT_SAMPLES)
def test_a_spoilt_sample_costs_itself_alone(whole, folder, stepbench, how):
    change(folder, SPOILT_SAMPLES[how])
    told(stepbench("export", folder, "--json"), folder)
    before, after = whole["records"], content(folder)["records"]
    assert list(after) == list(before)
    lost = sum(len(before[key].run_s) - len(after[key].run_s) for key in before)
    assert lost == (0 if "orphan" in how or how == "number is text" else 1)


SPOILT_KEYS = {
    "null": "UPDATE records SET key = NULL WHERE rowid = 1",
    "blob": "UPDATE records SET key = x'ff00' WHERE rowid = 1",
    "not UTF-8": "UPDATE records SET key = CAST(x'ff61' AS TEXT) WHERE rowid = 1",
    "another": "UPDATE records SET key = 'other' WHERE rowid = 1",
    "control characters": "UPDATE records SET key = 'a' || char(27) || 'b' WHERE rowid = 1",
    "empty": "UPDATE records SET key = '' WHERE rowid = 1",
}


@pytest.mark.parametrize("how", SPOILT_KEYS)
def test_a_spoilt_key_costs_its_row_alone(whole, folder, stepbench, how):
    change(folder, "DELETE FROM samples WHERE key = (SELECT key FROM records WHERE rowid = 1)")
    change(folder, SPOILT_KEYS[how])
    result = stepbench("export", folder, "--json")
    told(result, folder)
    assert len(json.loads(result.stdout)) == len(whole["records"]) - 1
    assert "\x1b" not in result.output


@pytest.mark.parametrize("damage", ["empty file", "half a file", "noise", "no tables", "schema"])
def test_a_file_that_is_no_store_is_one_sentence(folder, stepbench, damage):
    path = folder / FILE
    whole = path.read_bytes()
    if damage == "schema":
        change(folder, "UPDATE meta SET value = x'ff1b' WHERE name = 'schema'")
    elif damage == "no tables":
        change(folder, "DROP TABLE records")
    else:
        damaged = {
            "empty file": b"",
            "half a file": whole[: len(whole) // 3],
            "noise": b"\x1b" * 9999,
        }
        path.write_bytes(damaged[damage])
    for command in (("export", folder), ("compare", folder, folder), ("report", folder)):
        result = stepbench(*command)
        assert result.exit_code == 1
        assert "Traceback" not in result.output
        assert "--fresh" in result.output
        assert "\x1b" not in result.output


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
    yield write_html_report(folder).read_text(encoding="utf-8")
    yield write_markdown_report(folder).read_text(encoding="utf-8")


def quickly(monkeypatch: pytest.MonkeyPatch) -> None:
    """Draw the pictures of pages as empty ones: drawing takes seconds."""
    drawn = rendering.Picture(b"<svg/>")
    monkeypatch.setattr(rendering, "pictures", lambda charts: dict.fromkeys(charts, drawn))


def sound(html: str, markdown: str, charts: int) -> None:
    """The page has its charts, as data that a browser reads, and no script of others."""
    page = Document(html)
    assert page.scripts == len(page.charts) + 2
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
