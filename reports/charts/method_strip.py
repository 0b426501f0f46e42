"""The strip of an integrator: its state on each scene at each accuracy, as coloured cells."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from reports.charts import vega_lite as vl
from reports.formatting import number
from reports.names import scene_name
from reports.ranking import Answer
from reports.series import Series
from reports.verdicts import state_on

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
    cells = [
        (scene, answer.question.accuracy, state_on(label, own), entry.ratio)
        for answer in found
        for scene, own in answer.scenes.items()
        if (entry := own.entries.get(label))
    ]
    if not cells:
        return None
    rows = [
        {
            "scene": scene_name(scene),
            "target": accuracy,
            "state": _LOOKS[state][0],
            "text": number(float(f"{ratio:.2g}")) if state == "dearer" and ratio else "",
        }
        for scene, accuracy, state, ratio in cells
    ]
    group = found[0].question.group
    for scene, s in series.items():
        if wrong := [r for r in s.ok if r.wrong(group) and not r.message]:
            cell = {"scene": scene_name(scene), "target": "wrong", "state": _LOOKS["wrong"][0]}
            rows.append(cell | {"text": f"{len(wrong)} of {len(s.records)}"})
    used = {row["state"] for row in rows}
    looks = {title: color for title, color in _LOOKS.values() if title in used}
    scale = {"domain": [*looks], "range": [*looks.values()]}
    order = [*(answer.question.accuracy for answer in found), "wrong"]
    place = {
        "x": vl.category("target", title=None, sort=order, axis={"labelAngle": 0, "orient": "top"}),
        "y": vl.category("scene", title=None, sort=[*map(scene_name, series)]),
    }
    color = vl.category("state", scale=scale, legend={"title": None})
    ink = {"condition": {"test": "datum.target === 'wrong'", "value": "#fff"}, "value": "#1b2430"}
    data = vl.Dataset("strip", rows)
    return {
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
                "transform": [{"filter": "datum.text"}],
            },
        ],
        "width": {"step": 50},
        "height": {"step": 22},
        "config": vl.config(),
    }
