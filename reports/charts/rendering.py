"""Charts as pictures. Engines draw them: guarded processes, which end with this one.

The library that draws may end its process. That costs the picture, never the page: the engine is
replaced.
"""

from __future__ import annotations

import atexit
import os
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

from bench.guard.limits import Limits
from bench.guard.process import GuardedProcess, NoAnswer
from problems.plain_text import clean
from problems.usage import cores
from reports.charts.vega_lite import Spec, chart_json

if TYPE_CHECKING:
    from bench.guard.serve import Notify

#: Characters of charts per engine; one takes a third of a second to start.
PART_SIZE = 240_000
#: An engine that computes at one chart for longer, in s, is stopped.
LONGEST_DRAWING = 120.0


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
    for name, picture in pictures({n: _plain(chart) for n, chart in charts.items()}).items():
        if picture.content:
            folder.mkdir(parents=True, exist_ok=True)
            (folder / f"{name}.svg").write_bytes(picture.content)
        else:
            failed[name] = picture
    return failed


def pictures(charts: Mapping[str, Spec], form: str = "svg", **options: float) -> dict[str, Picture]:
    """Draw charts by name, several at a time when there are many.

    Parameters
    ----------
    charts
        The charts by name.
    form
        "svg", "png" or "pdf".
    **options
        Those of vl-convert for this form: ``scale``, ``ppi``.
    """
    texts = {name: chart_json(chart) for name, chart in charts.items()}
    if not texts:
        return {}
    # The largest ones first, so that no engine waits for another at the end.
    order = sorted(texts, key=lambda name: -len(texts[name]))
    engines = max(1, min(cores(), sum(map(len, texts.values())) // PART_SIZE))
    draw_one = partial(_drawn, by=f"vegalite_to_{form}", options=options)
    with ThreadPoolExecutor(min(engines, len(texts))) as pool:
        drawn = dict(zip(order, pool.map(draw_one, [texts[name] for name in order]), strict=True))
    return {name: drawn[name] for name in charts}


def picture(chart: Spec, form: str = "svg", **options: float) -> Picture:
    """Draw one chart; see ``pictures``."""
    return pictures({"": chart}, form, **options)[""]


# ---- engines -----------------------------------------------------------------------------
def _plain(chart: Spec) -> Spec:
    """The chart without slow options that a picture does not need.

    These are a description of every point for screen readers, and limits of label lengths, for
    which every label would be measured twice.
    """
    config = chart.get("config", {})
    axis = config.get("axis", {}) | {"labelLimit": 0, "titleLimit": 0}
    legend = config.get("legend", {}) | {"labelLimit": 0}
    return chart | {"config": config | {"aria": False, "axis": axis, "legend": legend}}


#: Engines without work. They are kept, as starting one takes longer than drawing a small chart.
_idle: list[GuardedProcess] = []


@atexit.register
def _end_engines() -> None:
    while _idle:
        _idle.pop().end()


if hasattr(os, "register_at_fork"):  # the child must not talk to the engines of its parent
    os.register_at_fork(after_in_child=_idle.clear)


def _engine() -> GuardedProcess:
    while _idle:
        engine = _idle.pop()
        if engine.alive:
            return engine
    return GuardedProcess(_ready, limits=Limits(LONGEST_DRAWING))


def _drawn(text: str, by: str, options: Mapping[str, float]) -> Picture:
    """A picture of text by a function of vl-convert."""
    engine = _engine()
    answer = engine.ask(_converted, text, by, options)
    if not engine.alive:
        # Somebody else may have ended it: the chart is guilty if a second one dies of it.
        engine = _engine()
        answer = engine.ask(_converted, text, by, options)
    _idle.append(engine)
    return Picture(reason=answer.message.rstrip(".")) if isinstance(answer, NoAnswer) else answer


# ---- in an engine ------------------------------------------------------------------------
def _ready(notify: Notify) -> bool:
    import vl_convert  # noqa: F401

    return True


def _converted(state: bool, text: str, by: str, options: dict[str, float]) -> Picture:
    import vl_convert

    try:
        content = getattr(vl_convert, by)(text, **options)
    except BaseException as error:  # a panic of the library is no Exception
        reason = clean(str(error)).strip().partition("\n")[0][:300].rstrip(".")
        return Picture(reason=reason or type(error).__name__)
    return Picture(content.encode() if isinstance(content, str) else content)
