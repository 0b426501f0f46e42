"""Charts as pictures, drawn by vl-convert in this process."""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from html import escape
from pathlib import Path

import vl_convert

from problems.base.text import clean
from problems.base.usage import cores
from reports.charts.vega_lite import Spec, chart_json


@dataclass(frozen=True)
class Picture:
    """The content of a picture's file, or the reason why there is none."""

    content: bytes = b""
    reason: str = ""

    @property
    def svg(self) -> str:
        """The picture in a page; a sentence if there is none."""
        return self.content.decode() if self.content else f"<p>{escape(self.sentence)}</p>"

    @property
    def sentence(self) -> str:
        """The reason as a sentence."""
        return f"This chart cannot be drawn: {self.reason}."


def draw(charts: Mapping[str, Spec], folder: Path) -> dict[str, Picture]:
    """Write every chart into the folder as name.svg; SVG files of an earlier time are deleted.

    Returns
    -------
    dict
        The charts that cannot be drawn, with the reason; they have no file.
    """
    for old in folder.glob("*.svg"):
        old.unlink()
    failed = {}
    for name, drawn in pictures({n: _plain(chart) for n, chart in charts.items()}).items():
        if drawn.content:
            folder.mkdir(parents=True, exist_ok=True)
            (folder / f"{name}.svg").write_bytes(drawn.content)
        else:
            failed[name] = drawn
    return failed


def pictures(charts: Mapping[str, Spec], form: str = "svg", **options: float) -> dict[str, Picture]:
    """Draw charts by name as "svg", "png" or "pdf", with options of vl-convert for this form."""
    with ThreadPoolExecutor(cores()) as pool:
        drawn = pool.map(lambda chart: picture(chart, form, **options), charts.values())
        return dict(zip(charts, drawn, strict=True))


def picture(chart: Spec, form: str = "svg", **options: float) -> Picture:
    """Draw one chart; see ``pictures``.

    The text of a chart is clean: at a null character the library would end this process.
    """
    try:
        content = getattr(vl_convert, f"vegalite_to_{form}")(chart_json(chart), **options)
    except ValueError as error:
        reason = clean(str(error)).strip().partition("\n")[0][:300].rstrip(".")
        return Picture(reason=reason or type(error).__name__)
    return Picture(content.encode() if isinstance(content, str) else content)


def _plain(chart: Spec) -> Spec:
    """The chart without slow options that a picture does not need.

    These are a description of every point for screen readers, and limits of label lengths, for
    which every label would be measured twice.
    """
    config = chart.get("config", {})
    axis = config.get("axis", {}) | {"labelLimit": 0, "titleLimit": 0}
    legend = config.get("legend", {}) | {"labelLimit": 0}
    return chart | {"config": config | {"aria": False, "axis": axis, "legend": legend}}
