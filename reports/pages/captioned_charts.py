"""Charts with a caption, the figures of a page."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from reports.charts.vega_lite import Spec

#: The topic of charts that pages draw themselves: Markdown alone has them.
PAPER = "paper"


@dataclass
class CaptionedCharts:
    """Charts by name (an anchor, a file name) that share a caption.

    ``topic`` is the part of a scene's page that they belong to: its cost, the motion over time, the
    drift of what should stay constant, or the steps.
    """

    caption: str
    charts: dict[str, Spec]
    topic: str = "cost"


def captioned(
    caption: str, charts: Mapping[str, Spec | None], topic: str = "cost"
) -> CaptionedCharts | None:
    """The charts that hold something, with a caption; None if none does."""
    drawn = {name: chart for name, chart in charts.items() if chart is not None}
    return CaptionedCharts(caption, drawn, topic) if drawn else None
