"""A store with planted records, whose numbers the tests of the pages know."""

import csv
import io
import json
import math
import re
import shutil
from collections.abc import Callable, Mapping, Sequence
from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from bench.results.quantities import NORMS
from bench.results.records import Environment, Plan, Record, Rows, SceneRecord, Study
from bench.results.store import Store
from reports.questions import Question
from reports.ranking import Answer, by_cost
from reports.series import Series

STEPS = [0.1 / 2**k for k in range(6)]
MACHINE = Environment(
    date="2025-03-01T10:00:00+00:00", command="stepbench run planted", cpu="Model 1", cores=8,
    memory_gib=15.5, platform="Linux", versions={"python": "3.12.1", "numpy": "2.1.0"},
)  # fmt: skip
ATTACK = "Newton stopped at t=0.1 s: <script>alert(1)</script> | residual 1e3; take a smaller step."


def planted(
    problem: str,
    integrator: str,
    groups: dict[str, tuple[float, float]],
    *,
    h: float,
    family: str = "alpha",
    **changes,
) -> Record:
    """A record with errors C h^p for {group: (C, p)}; a step has 3 residuals of 10 operations."""
    steps = round(1 / h)
    known = {
        "key": f"{problem} | {integrator} | h={h!r}",
        "problem": problem,
        "integrator": integrator,
        "family": family,
        "formulation": "index3" if problem == "pendulum" else "unconstrained",
        "controls": "step",
        "h": h,
        "t0": 0.0,
        "t_end": 1.0,
        "status": "ok",
        "errors": {
            g: dict.fromkeys(("end", "max", "rms", "settled"), c * h**p)
            for g, (c, p) in groups.items()
        },
        "reference_error": {g: dict.fromkeys(NORMS, 1e-15) for g in groups},
        "work": {"steps": steps, "residuals": 3 * steps},
        "rows": steps,
        "compile_s": 1.5,
        "environment": MACHINE.number,
    }
    known |= changes
    count = known["work"].get("residuals")
    return Record(**({"operations": {"residuals": 10.0 * count} if count else {}} | known))


def curves(t_end: float, names: dict[str, int], amplitude: float = 1.0) -> Rows:
    t = [t_end * k / 60 for k in range(61)]
    values = {
        n: [[amplitude * math.cos(6 * x + i) for i in range(size)] for x in t]
        for n, size in names.items()
    }
    return Rows(t=t, values=values)


def everything() -> list[Record]:
    """Two scenes, fixed steps and tolerances, a lost order, no convergence, failures."""
    free = {"q": (1.0, 2), "v": (2.0, 2), "a": (3.0, 2), "x": (0.5, 2), "y": (0.7, 2)}
    held = {"q": (1.0, 2), "v": (2.0, 2), "a": (3.0, 2), "lam": (4.0, 2)}
    records = []
    for h in STEPS:
        records += [
            planted("spring_mass", "good[rho_inf=0.8]", free, h=h),
            planted("spring_mass", "poor", {g: (c, 1) for g, (c, _) in free.items()}, h=h),
            planted("pendulum", "good[rho_inf=0.8]", held, h=h),
            planted("pendulum", "good[rho_inf=0.5]", held, h=h),
            planted("pendulum", "ringing[rho_inf=1]", held | {"lam": (0.3, 0)}, h=h),
        ]
        for record in records[-3:-1]:
            record.errors["lam"]["max"] = 2 * h
        for record in records[-3:]:
            record.constraint = {"position": 1e-13, "velocity": h**2, "acceleration": h}
            record.energy_drift = h**2 / 7
    for k in range(3, 9):
        rtol = 10.0**-k
        errors = {g: dict.fromkeys(("end", "max", "rms", "settled"), 3 * rtol) for g in held}
        changes = {"controls": "tolerance", "rtol": rtol, "atol": rtol / 100, "errors": errors}
        changes |= {"key": f"pendulum | adaptive | {rtol}", "work": {"residuals": 100 * k}}
        records.append(planted("pendulum", "adaptive", held, h=0.1, family="bdf", **changes))
    for h in STEPS[:2]:
        failed = planted("pendulum", "fragile", {}, h=h, family="other", status="newton_failed")
        failed.message = ATTACK
        records.append(failed)
    return records


def some() -> list[Record]:
    """Runs of two methods without their finest step."""
    return [r for r in everything() if r.integrator in ("poor", "fragile") and r.h != STEPS[-1]]


def plant(folder: Path, records: list[Record], samples: int = 3, plan: bool = True) -> Path:
    """A run folder with these records."""
    names = {"spring_mass": {"q": 1, "v": 1, "a": 1, "x": 1, "y": 2}}
    names["pendulum"] = {"q": 2, "v": 2, "a": 2, "lam": 1}
    sizes = {"spring_mass": {"nq": 1, "nl": 0, "nx": 1, "ny": 2}}
    sizes["pendulum"] = {"nq": 2, "nl": 1, "nx": 0, "ny": 0}
    for record in records:  # other scenes are like the mass
        names.setdefault(record.problem, names["spring_mass"])
        sizes.setdefault(record.problem, sizes["spring_mass"])
    with Store(folder, create=True) as store:
        store.keep(MACHINE)
        for problem in dict.fromkeys(r.problem for r in records):
            store.keep(
                SceneRecord(
                    problem=problem,
                    t_end=1.0,
                    title=f"The {problem} scene.",
                    description="A first paragraph\nover two lines.\n\nA second paragraph.",
                    source="A book, p. 11",
                    difficulties=["lam oscillates"],
                    parameters=[{"name": "m", "value": 1.25, "unit": "kg", "doc": "mass & load"}],
                    components={
                        group: [f"{name} [{unit}]" for name in "XY"[: names[problem]["q"]]]
                        for group, unit in (("q", "m"), ("v", "m/s"), ("a", "m/s^2"))
                    },
                    sizes=sizes[problem],
                    t0=0.0,
                    reference_method="closed form",
                    reference_error=dict.fromkeys(names[problem], 1e-15),
                    reference=curves(1.0, names[problem]),
                    drawings=[
                        {"t": t, "lines": [[[0.0, 0.0], [math.sin(t), -math.cos(t)]]]}
                        for t in (0.0, 0.5, 1.0)
                    ],
                )
            )
        for record in records:
            rows = curves(1.0, names[record.problem], 1.02) if record.status == "ok" else Rows(
                t=[], values={}
            )  # fmt: skip
            store.save(record, rows)
            seconds = 1e-6 * (record.work.get("residuals") or 1)
            if record.status == "ok":
                for n in range(samples):
                    store.add_sample(record.key, n, seconds * (1 + 0.01 * n))
        if plan:
            studies = [
                Study(
                    title=f"Study of the {problem}",
                    note="A note.",
                    problem=problem,
                    t_end=1.0,
                    figures=["trajectory", "convergence", "work_precision"],
                    cells=[r.key for r in records if r.problem == problem],
                )
                for problem in dict.fromkeys(r.problem for r in records)
            ]
            store.keep(
                Plan(name="planted", title="Planted", samples=3, budget_s=1.0, studies=studies)
            )
    return folder


def edited(folder: Path, name: str, edit: Callable[[Record], None]) -> Path:
    """A copy of a folder whose records were edited; their samples are ``run_s``."""
    copy = folder.parent / name
    shutil.copytree(folder, copy)
    with Store(copy, create=True) as store:
        for key, record in store.records().items():
            rows = store.rows(key)
            edit(record)
            samples, record.run_s, record.rounds = record.run_s, [], []
            store.save(record, rows)
            for k, seconds in enumerate(samples):
                store.add_sample(key, k, seconds)
    return copy


def whole_report(folder: Path) -> str:
    """The text of all pages of a report in one: the first, scenes in their order, the others."""
    first = (folder / "report.html").read_text(encoding="utf-8")
    named = re.findall(r'href="(report/[^"#]+)"', first)
    others = sorted((folder / "report").glob("*.html"))
    files = dict.fromkeys([*named, *(f"report/{file.name}" for file in others)])
    return first + "".join((folder / file).read_text(encoding="utf-8") for file in files)


def page_data(folder: Path) -> dict[str, Any]:
    """The data of a report's scripts."""
    text = (folder / "report" / "data.js").read_text(encoding="utf-8")
    return json.loads(text.partition("stepbenchData = ")[2].rstrip(";\n"))


def whole_markdown(folder: Path) -> str:
    """The text of report.md and of its scenes in one, with addresses from the run folder."""
    index = (folder / "report.md").read_text(encoding="utf-8")
    files = dict.fromkeys(re.findall(r"\]\((report/scene-[^)#]+\.md)\)", index))
    parts = [(folder / unquote(file)).read_text(encoding="utf-8") for file in files]
    return index + "".join(part.replace("](../", "](") for part in parts)


def answer(scenes: Mapping[str, Sequence[Series]], question: Question) -> Answer:
    """The answer to one question; it is empty if no scene has the group."""
    return by_cost(scenes, question)[question]


def chart_rows(chart: dict[str, Any], name: str) -> list[dict[str, str]]:
    """The rows of a chart's data set."""
    return list(csv.DictReader(io.StringIO(chart["datasets"][name])))


class Document(HTMLParser):
    """Tables by caption, with full names for short ones; places, scripts, and the visible text."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tables: list[tuple[str, list[list[str]]]] = []
        self.places: list[tuple[str, str]] = []
        self.charts: dict[str, dict] = {}
        self.words = ""
        self.scripts: list[str] = []
        self._caption = self._cell = self._chart = None
        self._hidden = self._named = False
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        known = dict(attrs)
        self.places += [(tag, v or "") for k, v in attrs if k in ("src", "href", "action", "data")]
        if known.get("class") == "named" and self._cell is not None:
            self._cell, self._named = known["title"], True
        if tag == "table":
            self.tables.append(("", []))
        elif tag == "tr":
            self.tables[-1][1].append([])
        elif tag in ("td", "th"):
            self._cell = ""
        elif tag == "caption":
            self._caption = ""
        elif tag in ("script", "style"):
            self._hidden = True
            if tag == "script":
                self.scripts.append(known.get("src") or known.get("type") or "inline")
            self._chart = known.get("data-chart")

    def handle_endtag(self, tag: str) -> None:
        if tag == "a":
            self._named = False
        if tag in ("td", "th"):
            self.tables[-1][1][-1].append(self._cell)
            self._cell = None
        elif tag == "caption":
            self.tables[-1] = (self._caption, self.tables[-1][1])
            self._caption = None
        elif tag in ("script", "style"):
            self._hidden, self._chart = False, None

    def handle_data(self, data: str) -> None:
        if self._chart:
            self.charts[self._chart] = json.loads(data)
        elif not self._hidden:
            self.words += data
        if self._cell is not None and not self._named:
            self._cell += data
        if self._caption is not None:
            self._caption += data

    def rows(self, caption: str, place: int = 0) -> list[dict[str, str]]:
        head, *body = [rows for name, rows in self.tables if name == caption][place]
        return [dict(zip(head, row, strict=True)) for row in body]
