"""Single figures: one panel of a page's chart for a paper, as wide as a column; for notebooks."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from inspect import signature
from pathlib import Path
from typing import Any, NamedTuple

from bench.results.quantities import COST, COSTS, GROUPS, error_note, group_and_norm
from bench.results.records import Record, Rows, SceneRecord
from bench.results.store import Store
from problems.base.spec import SpecError, one_of, suggest
from reports.charts.errors import ACROSS, convergence_chart, error_charts
from reports.charts.line_styles import line_styles
from reports.charts.over_time import histories, trajectory_chart
from reports.charts.rendering import picture
from reports.charts.vega_lite import Spec, chart_json
from reports.formatting import words
from reports.names import named_labels
from reports.scenes import stored_runs
from reports.series import Series, groups_of, label_of, ok_runs, series_of

#: Width of a column in points (88 mm), and height of the panel without its legend.
_WIDTH, _HEIGHT = 250, 165
_PNG_PER_INCH = 300
FORMATS = (".svg", ".png", ".pdf", ".json")
_SCHEMA = "https://vega.github.io/schema/vega-lite/v6.json"
_THIN: dict[str, Spec] = {
    "line": {"strokeWidth": 0.9},
    "point": {"size": 24},
    "rule": {"strokeWidth": 0.5},
    "text": {"fontSize": 7, "dx": -3, "dy": -3},
}

#: Black on white, thin axes without a grid, 8 points of text.
_TEXT = {"labelFontSize": 8, "titleFontSize": 8, "titleFontWeight": "normal"}
_PAPER: Spec = {
    "background": "white",
    "font": "Helvetica, Arial, Liberation Sans, sans-serif",
    "view": {"stroke": "black", "strokeWidth": 0.5},
    "axis": {
        **_TEXT,
        **dict.fromkeys(("tickColor", "labelColor", "titleColor"), "black"),
        **{"tickWidth": 0.5, "tickSize": 3, "titlePadding": 4, "grid": False, "domain": False},
    },
    "legend": {
        **_TEXT,
        **{"orient": "bottom", "direction": "vertical", "columns": 1, "offset": 6},
        **{"rowPadding": 1, "symbolSize": 30, "symbolStrokeWidth": 0.9},
        "labelLimit": _WIDTH - 30,
    },
}


class _Chosen(NamedTuple):
    """The runs of one scene that reached the end, as series."""

    folder: Path
    name: str
    scene: SceneRecord | None
    series: list[Series]

    def finest(self) -> list[tuple[str, Rows]]:
        """The sampled values of the finest run of each integrator."""
        with Store(self.folder) as store:
            return [(s.label, store.rows(s.finest.key)) for s in self.series]


def _work_precision(chosen: _Chosen, error: str = "q", cost: str = COST) -> Spec:
    """Error against cost, a line per integrator."""
    runs = ok_runs(chosen.series)
    known = [c for c in COSTS if c == "seconds" or any(r.cost(c) is not None for r in runs)]
    return _errors(chosen, chosen.series, error, one_of(cost, known, "cost"))


def _convergence(chosen: _Chosen, error: str = "q") -> Spec:
    """Error against step size."""
    return _errors(chosen, [s for s in chosen.series if s.controls == "step"], error, "h")


def _errors(chosen: _Chosen, series: Sequence[Series], error: str, across: str) -> Spec:
    group, norm = group_and_norm(error, {g for r in ok_runs(chosen.series) for g in r.errors})
    styles = line_styles(s.label for s in series)
    chart = error_charts(series, [group], [across], styles, norm)
    return _drawn(chart, chosen, f"both an error of {group} ({norm}) and {ACROSS[across]}")


def _trajectory(chosen: _Chosen, component: str = "q:1") -> Spec:
    """A component over time, of the finest run of each integrator."""
    names = chosen.scene.components if chosen.scene else {}
    runs = chosen.finest()
    place = group_and_place(component, runs[0][1].values, names)
    reference = chosen.scene.reference if chosen.scene else None
    styles = line_styles(s.label for s in chosen.series)
    chart = trajectory_chart(runs, reference, place[:1], styles, names, [[place]])
    return _drawn(chart, chosen, f"values of {component}")


def _errors_over_time(chosen: _Chosen, error: str = "q") -> Spec:
    """Error of a group over time, of the finest run of each integrator."""
    note = error_note(one_of(error, GROUPS, "group"))
    styles = line_styles(s.label for s in chosen.series)
    chart = histories(chosen.finest(), styles, notes=[note])
    return _drawn(chart, chosen, f"stored errors of {error} over time")


def _drawn(chart: Spec | None, chosen: _Chosen, lacking: str) -> Spec:
    if chart is None:
        raise SpecError(f"No chosen run on {chosen.name} has {lacking}: nothing to draw.")
    return chart


#: The figures by name: functions of the runs that are shown, and of options of their own.
_KINDS: dict[str, Callable[..., Spec]] = {
    draw.__name__[1:]: draw
    for draw in (_work_precision, _convergence, _trajectory, _errors_over_time)
}


def figure(
    kind: str,
    folder: Path,
    *,
    scene: str | None = None,
    integrators: Sequence[str] = (),
    t_end: float | None = None,
    **more: str,
) -> Spec:
    """Return a figure in Vega-Lite, which Altair takes by ``LayerChart.from_dict``.

    Parameters
    ----------
    kind
        "work_precision" (error against cost), "convergence" (against step size), "trajectory" or
        "errors_over_time", both of the finest run of each integrator.
    folder
        The run folder.
    scene
        The scene; may be left out if the folder has one.
    integrators
        Names or full specs of those to show; all if empty.
    t_end
        The end of the interval in s, if the folder has the scene over several.
    **more
        ``error``: a group and a norm, such as "a:max", over time a group; ``cost``: "operations",
        "seconds", or a count such as "steps"; ``component``: a group and a number or the name of a
        coordinate, such as "a:Y".

    Raises
    ------
    SpecError
        If a name is not known, the figure does not take an option, or there is nothing to draw.
    bench.results.store.StoreError
        If the folder holds no readable store.
    """
    _, *allowed = signature(_KINDS[one_of(kind, _KINDS, "figure")]).parameters
    for name in more:
        if name not in allowed:
            raise SpecError(f"The figure {kind} has no --{name}; it takes {words(allowed)}.")
    return _on_paper(_KINDS[kind](_choose(folder, scene, integrators, t_end), **more))


def write_figure(kind: str, folder: Path, path: Path, **chosen: Any) -> Path:
    """Write a figure; the suffix of ``path`` says SVG, PNG, PDF or JSON (Vega-Lite).

    Raises
    ------
    SpecError
        As ``figure``, which takes ``chosen``, if the suffix is another, or it cannot be drawn.
    """
    if path.suffix not in FORMATS:
        raise SpecError(f"{path.name} is no figure; give a name that ends in {', '.join(FORMATS)}.")
    chart = figure(kind, folder, **chosen)
    if path.suffix == ".json":
        content = f"{chart_json(chart, indent=1)}\n".encode()
    else:
        options = {"ppi": _PNG_PER_INCH} if path.suffix == ".png" else {}
        content, wrong = picture(chart, path.suffix[1:], **options)
        if wrong:
            raise SpecError(wrong)
    if path.suffix == ".svg":  # a pixel of the drawing is a point on paper, as it is in the PDF
        content = re.sub(rb'(?<= )(width|height)="([\d.]+)"', rb'\1="\2pt"', content, count=2)
    path.write_bytes(content)
    return path


def _on_paper(chart: Spec) -> Spec:
    """The only panel of a chart, as wide as a column; its lines and points get thinner."""
    (panel,) = chart["concat"]
    for layer in panel["layer"]:
        layer["encoding"].get("y", {}).get("axis", {}).pop("minExtent", None)
        mark = layer["mark"]
        # A broad line behind the others stays broader.
        mark |= {"strokeWidth": 3} if mark.get("strokeWidth", 0) > 3 else _THIN[mark["type"]]
        for channel in ("color", "strokeDash"):
            if (layer["encoding"].get(channel, {}).get("legend") or {}).get("symbolSize"):
                layer["encoding"][channel]["legend"]["symbolSize"] = 160
    return panel | {
        "$schema": _SCHEMA,
        "datasets": chart["datasets"],
        "width": _WIDTH,
        "height": _HEIGHT,
        "autosize": {"type": "fit-x", "contains": "padding"},
        "padding": 2,
        "config": _PAPER,
    }


# ---- in notebooks ------------------------------------------------------------------------
def solution_chart(label: str, rows: Rows, names: Mapping[str, Sequence[str]]) -> str | None:
    """Return the first components of each group of a run over time; None if there is no chart."""
    groups = [group for group in GROUPS if rows.values.get(group) and rows.values[group][0]]
    chart = trajectory_chart([(label, rows)], None, groups, line_styles([label]), names)
    return picture(chart).svg if chart else None


def orders_chart(records: Sequence[Record]) -> str | None:
    """Return errors over step sizes with the fitted orders; None if there is no chart."""
    series = series_of(records)
    styles = line_styles(label_of(r) for r in records)
    chart = convergence_chart(series, groups_of(ok_runs(series)), styles)
    return picture(chart).svg if chart else None


# ---- choice ------------------------------------------------------------------------------
def _choose(
    folder: Path, scene: str | None, integrators: Sequence[str], t_end: float | None
) -> _Chosen:
    """The runs of a scene, whose bare name is enough if it means one, in the order asked for."""
    stored = stored_runs(folder)
    titles = {key: title for key, title in stored.titles.items() if stored.series[title]}
    known, name = list(dict.fromkeys(problem for problem, _ in titles)), (scene or "").strip()
    if not known:
        raise SpecError("The store holds no finished run.")
    meant = [k for k in known if scene is None or name == k]
    meant = meant or [k for k in known if name == k.partition("[")[0]]
    if not meant:
        raise SpecError(f"There is no scene {name!r}; {suggest(name, known)}.")
    if len(meant) > 1:
        raise SpecError(f"Several scenes are stored; choose one with --scene: {', '.join(meant)}.")
    ends = {end: title for (problem, end), title in titles.items() if problem == meant[0]}
    end = next(iter(ends)) if t_end is None and len(ends) == 1 else t_end
    if end not in ends:
        listed = ", ".join(f"{end:g}" for end in ends)
        raise SpecError(f"{meant[0]} is stored to t={listed} s; choose one with --t-end.")
    own = {s.label: s for s in stored.series[ends[end]]}
    wanted = dict.fromkeys(label for text in integrators for label in named_labels(text, own))
    series = [own[label] for label in wanted or own if own[label].ok]
    if not series:
        raise SpecError(f"None of these runs on {meant[0]} reached the end.")
    return _Chosen(folder, meant[0], stored.scenes.get(ends[end]), series)


def group_and_place(
    text: str,
    values: Mapping[str, Sequence[Sequence[float]]],
    components: Mapping[str, Sequence[str]],
) -> tuple[str, int]:
    """Read "a:Y" or "lam:1": a group with values and a place in it, counted from 0.

    Raises
    ------
    SpecError
        If there is no such group or component.
    """
    group, _, place = (part.strip() for part in text.partition(":"))
    known = [name for name, rows in values.items() if rows]
    if group not in known:
        raise SpecError(f"There is no component {group!r}; {suggest(group, known)}.")
    names = {str(i + 1): i for i in range(len(values[group][0]))}
    names |= {text.partition(" [")[0]: i for i, text in enumerate(components.get(group, ()))}
    if (place or "1") not in names:
        raise SpecError(f"{group} has no component {place!r}; {suggest(place, names)}.")
    return group, names[place or "1"]
