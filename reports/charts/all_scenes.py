"""Charts over all scenes: a heat map of costs, the profile, and one integrator's states."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Mapping, Sequence

from reports.charts import vega_lite as vl
from reports.charts.line_styles import LineStyle
from reports.formatting import NO_VALUE, number
from reports.names import scene_name
from reports.questions.method_card import state_on
from reports.ranking import Answer
from reports.series import Series

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
    axis = {"labelLimit": 420, "labelExpr": vl.names_of(styles)}
    x = vl.category("scene", title=None, sort=list(found.scenes), axis={"labelAngle": -35})
    y = vl.category("series", title=None, sort=list(styles), axis=axis)
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
    return _grid(vl.Dataset("ranking", rows), {"x": x, "y": y}, color, ink, 58)


def _grid(data: vl.Dataset, place: vl.Spec, color: vl.Spec, ink: vl.Spec, width: int) -> vl.Spec:
    """A coloured cell with its text for each row."""
    box = {"mark": {"type": "rect", "stroke": "#80808060"}, "encoding": place | {"color": color}}
    written = place | {"text": vl.category("text"), "color": ink}
    text = {"mark": {"type": "text", "fontSize": 11}, "encoding": written}
    text |= {"transform": [{"filter": "datum.text"}]}
    return {
        "datasets": vl.datasets([data]),
        "data": data.source,
        "layer": [box, text],
        "width": {"step": width},
        "height": {"step": 22},
        "config": vl.config(),
    }


def performance_profile(found: Answer, styles: Mapping[str, LineStyle]) -> vl.Spec | None:
    """Part of the scenes on which an integrator costs at most tau times the cheapest.

    Counted are all scenes with several integrators. None for fewer than two scenes.
    Source: Dolan & More (2002), doi:10.1007/s101070100263.
    """
    drawn: dict[str, list[float]] = {}
    scenes = [own for own in found.scenes.values() if len(own.series) > 1]
    for label, entry in (pair for own in scenes for pair in own.entries.items()):
        drawn.setdefault(label, []).extend([] if entry.ratio is None else [entry.ratio])
    rows = []
    for label, own in drawn.items() if len(scenes) > 1 else ():
        ratios = sorted(own)
        for tau in (1.0, *(r for r in ratios if r <= _FAR), _FAR):
            part = bisect_right(ratios, tau) / len(scenes)
            rows.append({"series": label, "tau": vl.short(tau), "part": vl.short(part)})
    if not rows:
        return None
    lines = vl.Lines({label: styles[label] for label in drawn})
    data = vl.Dataset("profile", rows)
    scale = {"type": "log", "domain": [1, _FAR]}
    layer: vl.Spec = {
        "data": data.source,
        "mark": {"type": "line", "interpolate": "step-after", "strokeWidth": 2},
        "encoding": {
            "x": vl.quantity("tau", title="times the best cost", scale=scale),
            "y": vl.quantity("part", title="part of the scenes", scale={"domain": [0, 1]}),
            "color": lines.colors(),
            "strokeDash": lines.dashes(),
            "order": vl.quantity("tau"),
        },
    }
    return vl.arrange([{"layer": [layer]}], [data], 1)


#: Looks of an integrator's states on a scene: title and colour.
_LOOKS = {
    "alone": ("cheapest alone", "#1a7f5a"),
    "tied": ("tied for the cheapest", "#7fc4a3"),
    "dearer": ("dearer, by this factor", "#d9c26a"),
    "single": ("reached, with none to compare", "#8fb3d9"),
    "unknown": ("reached, cost not measured", "#8fb3d9"),
    "far": ("not reached", "#80808030"),
    "failed": ("no run reaches the end", "#c0543c"),
    "wrong": ("runs wrong without a note", "#8e2a6b"),
}


def method_strip(
    label: str, found: Sequence[Answer], series: Mapping[str, Series]
) -> vl.Spec | None:
    """Wins, ties, losses and failures of an integrator: a row per scene, a column per accuracy.

    The last column counts its runs that are wrong without a note.
    """
    rows = [
        {
            "scene": scene_name(scene),
            "target": answer.question.accuracy,
            "state": _LOOKS[state := state_on(label, own)][0],
            "text": number(float(f"{entry.ratio:.2g}"))
            if state == "dearer" and entry.ratio
            else "",
        }
        for answer in found
        for scene, own in answer.scenes.items()
        if (entry := own.entries.get(label))
    ]
    if not rows:
        return None
    group = found[0].question.group
    for scene, s in series.items():
        wrong = [r for r in s.ok if r.wrong(group) and not r.message]
        state, text = _LOOKS["wrong"][0], f"{len(wrong)} of {len(s.records)}"
        cell = {"scene": scene_name(scene), "target": "wrong", "state": state, "text": text}
        rows += [cell] if wrong else []
    used = {row["state"] for row in rows}
    looks = [look for look in _LOOKS.values() if look[0] in used]
    scale = dict(zip(("domain", "range"), map(list, zip(*looks, strict=True)), strict=True))
    order = [*(answer.question.accuracy for answer in found), "wrong"]
    x = vl.category("target", title=None, sort=order, axis={"labelAngle": 0, "orient": "top"})
    y = vl.category("scene", title=None, sort=[*map(scene_name, series)])
    color = vl.category("state", scale=scale, legend={"title": None})
    ink = {"condition": {"test": "datum.target === 'wrong'", "value": "#fff"}, "value": "#1b2430"}
    return _grid(vl.Dataset("strip", rows), {"x": x, "y": y}, color, ink, 50)
