"""Still charts over all scenes, of the first question: a heat map of costs, and the profile."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from bench.results.quantities import COST
from reports.charts import vega_lite as vl
from reports.charts.line_styles import LineStyle
from reports.formatting import NO_VALUE, number
from reports.ranking import GROUP, TARGET, RankEntry, several_contestants

#: Costs beyond this many times the cheapest are drawn alike.
_FAR = 100.0


def cost_heat_map(entries: Sequence[RankEntry], styles: Mapping[str, LineStyle]) -> vl.Spec | None:
    """Cost relative to the cheapest, integrator by scene; None if there is nothing to draw."""
    rows = [
        {
            "scene": s.scene,
            "series": s.label,
            "ratio": vl.short(s.ratio),
            "text": NO_VALUE if s.ratio is None else number(float(f"{s.ratio:.2g}")),
        }
        for s in entries
        if _asked_first(s)
    ]
    if not rows:
        return None
    data = vl.Dataset("ranking", rows)
    labels = list(dict.fromkeys(s.label for s in entries))
    scenes = list(dict.fromkeys(s.scene for s in entries))
    axis = {"labelLimit": 420, "labelExpr": vl.short_label(styles)}
    place = {
        "x": vl.category("scene", title=None, sort=scenes, axis={"labelAngle": -35}),
        "y": vl.category("series", title=None, sort=labels, axis=axis),
    }
    shade = {
        "type": "log",
        "domain": [1, _FAR],
        "clamp": True,
        "range": ["#1a7f5a", "#d9c26a", "#c0543c"],
        "interpolate": "lab",
    }
    legend = {"title": "times the best cost", "direction": "horizontal", "gradientLength": 300}
    color = {
        "condition": {"test": "!isValid(datum.ratio)", "value": "#80808030"},
        **vl.quantity("ratio", scale=shade, legend=legend),
    }
    ink = {"condition": {"test": "!isValid(datum.ratio)", "value": vl.GREY}, "value": "#fff"}
    chart: vl.Spec = {
        "datasets": vl.datasets([data]),
        "data": data.source,
        "layer": [
            {
                "mark": {"type": "rect", "stroke": "#80808060"},
                "encoding": place | {"color": color},
            },
            {
                "mark": {"type": "text", "fontSize": 11},
                "encoding": place | {"text": vl.category("text"), "color": ink},
            },
        ],
        "width": {"step": 58},
        "height": {"step": 22},
    }
    return chart | {"config": vl.config()}


def performance_profile(
    entries: Sequence[RankEntry], styles: Mapping[str, LineStyle]
) -> vl.Spec | None:
    """Part of the scenes on which an integrator costs at most tau times the cheapest.

    Counted are scenes with several contestants, of these for each integrator those on which it was
    tried and its cost is known if it reached the target. None for fewer than two scenes.
    Source: Dolan & More (2002), doi:10.1007/s101070100263.
    """
    several = several_contestants(entries)
    asked = [s for s in entries if s.scene in several and _asked_first(s)]
    scenes, rows = len({s.scene for s in asked}), []
    for label in dict.fromkeys(s.label for s in asked) if scenes > 1 else ():
        own = [s for s in asked if s.label == label and not (s.reached and s.value is None)]
        ratios = sorted(s.ratio for s in own if s.ratio is not None and s.ratio <= _FAR)
        steps = [(1.0, 0), *((r, i) for i, r in enumerate(ratios, 1)), (_FAR, len(ratios))]
        rows += [
            {"series": label, "tau": vl.short(tau), "part": vl.short(done / len(own))}
            for tau, done in (steps if own else ())
        ]
    if not rows:
        return None
    labels = list(dict.fromkeys(row["series"] for row in rows))
    options = vl.ChartOptions({label: styles[label] for label in labels})
    data = vl.Dataset("profile", rows)
    scale = {"type": "log", "domain": [1, _FAR]}
    layer: vl.Spec = {
        "data": data.source,
        "mark": {"type": "line", "interpolate": "step-after", "strokeWidth": 2},
        "encoding": {
            "x": vl.quantity("tau", title="times the best cost", scale=scale),
            "y": vl.quantity("part", title="part of the scenes tried", scale={"domain": [0, 1]}),
            "color": options.colors(),
            "strokeDash": options.dashes(),
            "opacity": options.opacity(),
            "order": vl.quantity("tau"),
        },
    }
    return vl.arrange([{"layer": [layer]}], [data], 1)


def _asked_first(s: RankEntry) -> bool:
    return (s.group, s.target, s.cost) == (GROUP, TARGET, COST)
