"""Still charts over all scenes, of the first question: a heat map of costs, and the profile."""

from __future__ import annotations

from collections.abc import Mapping

from reports.charts import vega_lite as vl
from reports.charts.line_styles import LineStyle
from reports.formatting import NO_VALUE, number
from reports.questions.answers import Answer
from reports.questions.profile import profiles

#: Costs beyond this many times the cheapest are drawn alike.
_FAR = 100.0


def cost_heat_map(found: Answer, styles: Mapping[str, LineStyle]) -> vl.Spec | None:
    """Cost relative to the cheapest, integrator by scene; None for fewer than two integrators."""
    rows = [
        {
            "scene": scene,
            "series": label,
            "ratio": vl.short(entry.ratio),
            "text": NO_VALUE if entry.ratio is None else number(float(f"{entry.ratio:.2g}")),
        }
        for scene, own in found.scenes.items()
        for label, entry in own.entries.items()
    ]
    if len({row["series"] for row in rows}) < 2:
        return None
    data = vl.Dataset("ranking", rows)
    axis = {"labelLimit": 420, "labelExpr": vl.short_label(styles)}
    place = {
        "x": vl.category("scene", title=None, sort=list(found.scenes), axis={"labelAngle": -35}),
        "y": vl.category("series", title=None, sort=list(styles), axis=axis),
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


def performance_profile(found: Answer, styles: Mapping[str, LineStyle]) -> vl.Spec | None:
    """Part of the scenes on which an integrator costs at most tau times the cheapest.

    Counted are scenes with several contestants, of these for each integrator those on which it was
    tried and its cost is known if it reached the target. None for fewer than two scenes.
    Source: Dolan & More (2002), doi:10.1007/s101070100263.
    """
    own = profiles([found])
    drawn = {k: p for k, p in own.methods.items() if p.pairs} if own.pairs > 1 else {}
    rows = [
        {"series": label, "tau": vl.short(tau), "part": vl.short(profile.part(tau))}
        for label, profile in drawn.items()
        for tau in (1.0, *(r for r in profile.ratios if r <= _FAR), _FAR)
    ]
    if not rows:
        return None
    options = vl.ChartOptions({label: styles[label] for label in drawn})
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
