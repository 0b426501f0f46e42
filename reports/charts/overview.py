"""Charts over all scenes: the heat table of costs and the performance profile."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from reports.charts.vega import (
    GREY,
    Data,
    Spec,
    View,
    arrange,
    by_series,
    config,
    dimmed,
    menu,
    pick,
    quantity,
    short,
)
from reports.series import GROUP_NAMES, Look, number
from reports.text.ranking import COSTS, JUDGED, TARGETS, Standing

#: Costs beyond this many times the best are drawn alike.
_FAR = 100.0
_START = {"group": "a", "target": "0.0001", "cost": "residuals"}


def heat(found: Sequence[Standing], interactive: bool) -> Spec | None:
    """Cost relative to the best, integrator by scene; None if nothing could be judged."""
    rows = [
        {
            "scene": s.scene,
            "series": s.label,
            "group": s.group,
            "target": str(s.target),
            "cost": s.cost,
            "ratio": short(s.ratio),
            "value": short(s.value),
            "run": s.run.resolution if s.run else "cost not known" if s.reached else "not reached",
            "text": "–" if s.ratio is None else number(float(f"{s.ratio:.2g}")),  # noqa: RUF001
        }
        for s in found
        if interactive or _is_start(s)
    ]
    if not rows:
        return None
    data = Data("standings", rows)
    sort = list(dict.fromkeys(s.label for s in found))
    place = {
        "x": {
            "field": "scene",
            "type": "nominal",
            "title": None,
            "sort": list(dict.fromkeys(s.scene for s in found)),
            "axis": {"labelAngle": -35},
        },
        "y": {
            "field": "series",
            "type": "nominal",
            "title": None,
            "sort": sort,
            "axis": {"labelLimit": 420},
        },
    }
    tips = [
        {"field": "series", "type": "nominal", "title": "integrator"},
        {"field": "scene", "type": "nominal"},
        {"field": "run", "type": "nominal", "title": "cheapest run"},
        quantity("value", title="cost", format=".3g"),
        quantity("ratio", title="times the best", format=".3g"),
    ]
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
        **quantity("ratio", scale=shade, legend=legend),
    }
    ink = {"condition": {"test": "!isValid(datum.ratio)", "value": GREY}, "value": "#fff"}
    chart: Spec = {
        "datasets": {data.name: data.text},
        "params": _menus() if interactive else [],
        "data": data.source,
        "transform": _chosen() if interactive else [],
        "layer": [
            {
                "mark": {"type": "rect", "stroke": "#80808060"},
                "encoding": place | {"color": color, "tooltip": tips},
            },
            {
                "mark": {"type": "text", "fontSize": 11},
                "encoding": place | {"text": {"field": "text", "type": "nominal"}, "color": ink},
            },
        ],
        "width": {"step": 58},
        "height": {"step": 22},
    }
    return chart | {"config": config()}


def profile(found: Sequence[Standing], looks: Mapping[str, Look], interactive: bool) -> Spec | None:
    """Part of the scenes on which an integrator costs at most tau times the best.

    Dolan & More (2002), doi:10.1007/s101070100263. None for fewer than two scenes.
    """
    cases: dict[tuple[str, float, str], dict[str, list[float]]] = {}
    scenes: dict[tuple[str, float, str], set[str]] = {}
    for s in found:
        case = (s.group, s.target, s.cost)
        if interactive or _is_start(s):
            scenes.setdefault(case, set()).add(s.scene)
            ratios = cases.setdefault(case, {}).setdefault(s.label, [])
            ratios += [s.ratio] if s.ratio is not None else []
    rows = []
    for (group, target, cost), by_label in cases.items():
        count = len(scenes[group, target, cost])
        for label, ratios in by_label.items() if count > 1 else ():
            named = {"series": label, "group": group, "target": str(target), "cost": cost}
            steps = [(1.0, 0), *((r, i) for i, r in enumerate(sorted(ratios), 1))]
            steps.append((_FAR, sum(r <= _FAR for r in ratios)))
            rows += [
                {**named, "tau": short(tau), "part": short(done / count)}
                for tau, done in steps
                if tau <= _FAR
            ]
    if not rows:
        return None
    labels = list(dict.fromkeys(row["series"] for row in rows))
    view = View({label: looks[label] for label in labels}, interactive=interactive)
    data = Data("profile", rows)
    layer: Spec = {
        "data": data.source,
        "transform": _chosen() if interactive else [],
        "mark": {"type": "line", "interpolate": "step-after", "strokeWidth": 2},
        "encoding": {
            "x": quantity(
                "tau", title="times the best cost", scale={"type": "log", "domain": [1, _FAR]}
            ),
            "y": quantity("part", title="part of the scenes", scale={"domain": [0, 1]}),
            "color": by_series(view.colors, view),
            "strokeDash": by_series(view.dashes, view),
            "opacity": dimmed(1.0, view),
            "order": quantity("tau"),
        },
    }
    if interactive:
        layer["params"] = [pick()]
    return arrange([{"layer": [layer]}], [data], 1, params=_menus() if interactive else ())


def _is_start(s: Standing) -> bool:
    return (s.group, str(s.target), s.cost) == tuple(_START.values())


def _menus() -> list[Spec]:
    """Choices of what is to be reached, and of what it costs."""

    return [
        menu("group", _START["group"], {g: GROUP_NAMES[g] for g in JUDGED}, "error in "),
        menu("target", _START["target"], {str(t): f"{t:.0e}" for t in TARGETS}, " of at most "),
        menu("cost", _START["cost"], COSTS, " at the cost of "),
    ]


def _chosen() -> list[Spec]:
    return [{"filter": f"datum.{name} === {name}"} for name in _START]
