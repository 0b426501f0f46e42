"""comparison.html and comparison.md: the changes from one run folder to another."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from bench.results.comparison import Comparison
from problems.whole_files import put
from reports.charts.comparison import ratio_charts
from reports.charts.rendering import draw
from reports.pages.templating import html, markdown
from reports.text.comparison_tables import comparison_tables

FIGURES = "comparison_figures"
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
    failed = draw(charts, folder / FIGURES)
    pictures = {
        f"{FIGURES}/{name}.svg": chart["title"]["text"]
        for name, chart in charts.items()
        if name not in failed
    }
    values = {
        "title": f"{comparison.old} → {comparison.new}",
        "state": comparison.state(),
        "regressions": regressions,
        "summary": comparison.summary(),
        "tables": comparison_tables(comparison),
        "charted": _CHARTED,
        "pictures": pictures,
        "failed": [picture.sentence for picture in failed.values()],
    }
    inline = [(folder / name).read_text(encoding="utf-8") for name in pictures]
    pages = {
        folder / "comparison.html": html("comparison.html.j2", **values, inline=inline),
        folder / "comparison.md": markdown("comparison.md.j2", **values),
    }
    for page, text in pages.items():
        put(page, text)
    return list(pages)
