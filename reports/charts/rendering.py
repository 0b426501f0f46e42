"""Charts as pictures, drawn by vl-convert in this process."""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from html import escape
from pathlib import Path
from typing import NamedTuple

import vl_convert

from problems.base.text import clean
from problems.base.usage import cores
from reports.charts.vega_lite import Spec, chart_json


class Picture(NamedTuple):
    """The content of a picture's file, or the reason why there is none, as a sentence."""

    content: bytes = b""
    sentence: str = ""

    @property
    def svg(self) -> str:
        """The picture in a page; a sentence if there is none."""
        return self.content.decode() if self.content else f"<p>{escape(self.sentence)}</p>"


def draw(charts: Mapping[str, Spec], folder: Path) -> dict[str, Picture]:
    """Write every chart into the folder as name.svg; SVG files of an earlier time are deleted.

    They have no description of each point for screen readers, which takes up to a third of the
    time.

    Returns
    -------
    dict
        The charts that cannot be drawn, with the reason; they have no file.
    """
    for old in folder.glob("*.svg"):
        old.unlink()
    plain = {n: c | {"config": c.get("config", {}) | {"aria": False}} for n, c in charts.items()}
    drawn = pictures(plain)
    for name, own in drawn.items():
        if own.content:
            folder.mkdir(parents=True, exist_ok=True)
            (folder / f"{name}.svg").write_bytes(own.content)
    return {name: own for name, own in drawn.items() if not own.content}


def pictures(charts: Mapping[str, Spec]) -> dict[str, Picture]:
    """Draw charts by name as SVG."""
    with ThreadPoolExecutor(cores()) as pool:
        return dict(zip(charts, pool.map(picture, charts.values()), strict=True))


def picture(chart: Spec, form: str = "svg", **options: float) -> Picture:
    """Draw one chart as "svg" or "png", with options of vl-convert for this form.

    The text of a chart is clean: at a null character the library would end this process.
    """
    try:
        content = getattr(vl_convert, f"vegalite_to_{form}")(chart_json(chart), **options)
    except ValueError as error:
        reason = clean(str(error)).strip().partition("\n")[0][:300].rstrip(".")
        return Picture(b"", f"This chart cannot be drawn: {reason or type(error).__name__}.")
    return Picture(content.encode() if isinstance(content, str) else content)
