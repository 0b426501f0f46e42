"""comparison.html and comparison.md: the changes from one run folder to another."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from bench.results.comparison import LEAST_CHANGE, Change, ComparedCell, Comparison, factor, shown
from bench.results.table import Table
from problems.whole_files import put
from reports.charts.comparison import ratio_charts
from reports.charts.rendering import draw
from reports.formatting import file_name
from reports.pages.page import Link, Page, write_page
from reports.pages.templating import markdown

_FIGURES = "comparison_figures"
_RUN = ["integrator", "scene", "run"]
_CHARTED = (
    "Every run that came to the end in both, by the ratio of new to old that is furthest from one: "
    "over groups and norms for errors, over counts for work. Upwards is worse. The grey bar holds "
    "the runs that did not change; pale are times from different machines or versions."
)


def write_comparison(
    comparison: Comparison, regressions: Sequence[str], folder: Path
) -> list[Path]:
    """Write comparison.html and comparison.md into a folder.

    Parameters
    ----------
    comparison
        The result of ``bench.results.compare.compare_folders``.
    regressions
        A sentence for each change that is worse than allowed.
    """
    folder.mkdir(parents=True, exist_ok=True)
    charts = ratio_charts(comparison)
    failed = draw(charts, folder / _FIGURES)
    pictures = {
        f"{_FIGURES}/{name}.svg": chart["title"]["text"]
        for name, chart in charts.items()
        if name not in failed
    }
    values = {
        "title": f"{comparison.old} → {comparison.new}",
        "state": comparison.state(),
        "regressions": regressions,
        "summary": comparison.summary(),
        "tables": _tables(comparison),
        "charted": _CHARTED,
        "pictures": pictures,
        "failed": [picture.sentence for picture in failed.values()],
    }
    put(folder / "comparison.md", markdown("comparison.md.j2", **values))
    values["inline"] = [(folder / name).read_text(encoding="utf-8") for name in pictures]
    page = Page("comparison.html", "comparison", values["title"], values=values)
    links = [Link(f"#{file_name(t.caption)}", t.caption) for t in values["tables"]]
    return [write_page(page, folder, links), folder / "comparison.md"]


def _tables(comparison: Comparison) -> list[Table]:
    """Tables of everything that changed, the worst first; no table without rows."""
    endings = [
        [*_run(e.run), e.before, e.run.status, e.run.message or "no message"]
        for e in comparison.endings
    ]
    made = [
        Table("Runs that end in another way", [*_RUN, "before", "now", "message"], endings),
        *(
            _changes(kind, [c for c in comparison.changes if c.kind == kind])
            for kind in LEAST_CHANGE
        ),
    ]
    for folder, runs in (
        (comparison.old, comparison.vanished),
        (comparison.new, comparison.appeared),
    ):
        rows = [[*_run(run), run.status] for run in runs]
        made.append(Table(f"Runs only in {folder}", [*_RUN, "ending"], rows))
    return [table for table in made if table.rows]


def _changes(kind: str, changes: Sequence[Change]) -> Table:
    # Errors have a group and a norm, work has a count; times need no further name.
    caption, named, unit = {
        "error": ("Relative errors that changed", ["group", "norm"], ""),
        "work": ("Counted work that changed", ["count"], ""),
        "time": ("Times that changed, beyond the noise of both", [], " in s"),
    }[kind]
    rows = []
    for c in sorted(changes, key=lambda c: -1.0 if c.ratio is None else -c.ratio):
        ratio = factor(c.ratio) + ("" if c.comparable else ", not comparable")
        names = [c.name, c.norm][: len(named)]
        rows.append([*_run(c.run), *names, shown(c.old), shown(c.new), ratio])
    return Table(caption, [*_RUN, *named, f"before{unit}", f"now{unit}", "ratio"], rows)


def _run(run: ComparedCell) -> list[str]:
    return [run.integrator, run.scene, run.resolution]
