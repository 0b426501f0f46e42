"""Charts over all scenes: a heat map of costs, and the performance profile."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from bench.results.quantities import COST, GROUP_NAMES
from reports.charts import vega_lite as vl
from reports.charts.line_styles import LineStyle
from reports.formatting import NO_VALUE, number
from reports.ranking import (
    GROUP,
    RANKED_COSTS,
    RANKED_GROUPS,
    TARGET,
    TARGETS,
    RankEntry,
    several_contestants,
)

#: Costs beyond this many times the cheapest are drawn alike.
_FAR = 100.0
_FIRST = {"group": GROUP, "target": str(TARGET), "cost": COST}


def cost_heat_map(entries: Sequence[RankEntry], interactive: bool) -> vl.Spec | None:
    """Cost relative to the cheapest, integrator by scene; None if there is nothing to draw."""
    rows = [
        {
            "scene": s.scene,
            "series": s.label,
            "group": s.group,
            "target": str(s.target),
            "cost": s.cost,
            "ratio": vl.short(s.ratio),
            "value": vl.short(s.value),
            "run": s.run.resolution if s.run else "cost not known" if s.reached else "not reached",
            "text": NO_VALUE if s.ratio is None else number(float(f"{s.ratio:.2g}")),
        }
        for s in entries
        if interactive or _shown_first(s)
    ]
    if not rows:
        return None
    data = vl.Dataset("ranking", rows)
    labels = list(dict.fromkeys(s.label for s in entries))
    scenes = list(dict.fromkeys(s.scene for s in entries))
    place = {
        "x": vl.category("scene", title=None, sort=scenes, axis={"labelAngle": -35}),
        "y": vl.category("series", title=None, sort=labels, axis={"labelLimit": 420}),
    }
    tooltip = [
        vl.category("series", title="integrator"),
        vl.category("scene"),
        vl.category("run", title="cheapest run"),
        vl.quantity("value", title="cost", format=".3g"),
        vl.quantity("ratio", title="times the best", format=".3g"),
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
        **vl.quantity("ratio", scale=shade, legend=legend),
    }
    ink = {"condition": {"test": "!isValid(datum.ratio)", "value": vl.GREY}, "value": "#fff"}
    chart: vl.Spec = {
        "datasets": vl.datasets([data]),
        "params": _menus() if interactive else [],
        "data": data.source,
        "transform": _menu_filters() if interactive else [],
        "layer": [
            {
                "mark": {"type": "rect", "stroke": "#80808060"},
                "encoding": place | {"color": color, "tooltip": tooltip},
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
    entries: Sequence[RankEntry], styles: Mapping[str, LineStyle], interactive: bool
) -> vl.Spec | None:
    """Part of the scenes on which an integrator costs at most tau times the cheapest.

    Counted are scenes with several contestants, of these for each integrator those on which it was
    tried and its cost is known if it reached the target. None for fewer than two scenes.
    Source: Dolan & More (2002), doi:10.1007/s101070100263.
    """
    several = several_contestants(entries)
    cases: dict[tuple[str, float, str], list[RankEntry]] = {}
    for s in entries:
        if s.scene in several and (interactive or _shown_first(s)):
            cases.setdefault((s.group, s.target, s.cost), []).append(s)
    rows = []
    for (group, target, cost), case in cases.items():
        scenes = len({s.scene for s in case})
        for label in dict.fromkeys(s.label for s in case) if scenes > 1 else ():
            own = [s for s in case if s.label == label and not (s.reached and s.value is None)]
            if not own:
                continue
            ratios = sorted(s.ratio for s in own if s.ratio is not None)
            named = {"series": label, "group": group, "target": str(target), "cost": cost}
            named["tried"] = f"{len(own)} of {scenes} scenes (reached on {len(ratios)})"
            steps = [(1.0, 0), *((r, i) for i, r in enumerate(ratios, 1))]
            steps.append((_FAR, sum(r <= _FAR for r in ratios)))
            rows += [
                {**named, "tau": vl.short(tau), "part": vl.short(done / len(own))}
                for tau, done in steps
                if tau <= _FAR
            ]
    if not rows:
        return None
    labels = list(dict.fromkeys(row["series"] for row in rows))
    options = vl.ChartOptions({label: styles[label] for label in labels}, interactive=interactive)
    data = vl.Dataset("profile", rows)
    scale = {"type": "log", "domain": [1, _FAR]}
    layer: vl.Spec = {
        "data": data.source,
        "transform": _menu_filters() if interactive else [],
        "mark": {"type": "line", "interpolate": "step-after", "strokeWidth": 2},
        "encoding": {
            "x": vl.quantity("tau", title="times the best cost", scale=scale),
            "y": vl.quantity("part", title="part of the scenes tried", scale={"domain": [0, 1]}),
            "color": options.colors(),
            "strokeDash": options.dashes(),
            "opacity": options.opacity(),
            "order": vl.quantity("tau"),
            "tooltip": [
                vl.category("series", title="integrator"),
                vl.category("tried"),
                vl.quantity("tau", title="times the best", format=".3g"),
                vl.quantity("part", title="part of the scenes tried", format=".3g"),
            ],
        },
    }
    if interactive:
        layer["params"] = [vl.pick()]
    return vl.arrange([{"layer": [layer]}], [data], 1, params=_menus() if interactive else ())


def _shown_first(s: RankEntry) -> bool:
    return (s.group, str(s.target), s.cost) == tuple(_FIRST.values())


def _menus() -> list[vl.Spec]:
    """Menus for group, target and cost."""
    return [
        vl.menu("group", _FIRST["group"], {g: GROUP_NAMES[g] for g in RANKED_GROUPS}, "error in "),
        vl.menu("target", _FIRST["target"], {str(t): f"{t:.0e}" for t in TARGETS}, " of at most "),
        vl.menu("cost", _FIRST["cost"], RANKED_COSTS, " at the cost of "),
    ]


def _menu_filters() -> list[vl.Spec]:
    return [{"filter": f"datum.{name} === {name}"} for name in _FIRST]
