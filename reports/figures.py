"""Single figures: one panel of a page's chart for a paper, as wide as a column; for notebooks."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from inspect import signature
from pathlib import Path
from typing import Any

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
_PAPER: Spec = {
    "background": "white",
    "font": "Helvetica, Arial, Liberation Sans, sans-serif",
    "view": {"stroke": "black", "strokeWidth": 0.5},
    "axis": {
        **{"labelFontSize": 8, "titleFontSize": 8, "titleFontWeight": "normal"},
        **{"tickColor": "black", "labelColor": "black", "titleColor": "black"},
        **{"tickWidth": 0.5, "tickSize": 3, "titlePadding": 4, "grid": False, "domain": False},
    },
    "legend": {
        **{"labelFontSize": 8, "titleFontSize": 8, "titleFontWeight": "normal"},
        **{"orient": "bottom", "direction": "vertical", "columns": 1, "offset": 6},
        **{"rowPadding": 1, "symbolSize": 30, "symbolStrokeWidth": 0.9},
        "labelLimit": _WIDTH - 30,
    },
}


def _work_precision(chosen: Selection, error: str = "q", cost: str = COST) -> Spec:
    """Error against cost, a line per integrator."""
    runs = ok_runs(chosen.series)
    known = [c for c in COSTS if c == "seconds" or any(r.cost(c) is not None for r in runs)]
    return _errors(chosen, chosen.series, error, one_of(cost, known, "cost"))


def _convergence(chosen: Selection, error: str = "q") -> Spec:
    """Error against step size."""
    return _errors(chosen, [s for s in chosen.series if s.controls == "step"], error, "h")


def _trajectory(chosen: Selection, component: str = "q:1") -> Spec:
    """A component over time, of the finest run of each integrator."""
    names = chosen.scene.components if chosen.scene else {}
    runs = [(s.label, chosen.rows(s.finest)) for s in chosen.series]
    place = group_and_place(component, runs[0][1].values, names)
    reference = chosen.scene.reference if chosen.scene else None
    styles = line_styles(s.label for s in chosen.series)
    chart = trajectory_chart(runs, reference, place[:1], styles, names, [[place]])
    return chart or {}


def _errors_over_time(chosen: Selection, error: str = "q") -> Spec:
    """Error of a group over time, of the finest run of each integrator."""
    note = error_note(one_of(error, GROUPS, "group"))
    runs = [(s.label, chosen.rows(s.finest)) for s in chosen.series]
    chart = histories(runs, line_styles(s.label for s in chosen.series), notes=[note])
    if chart is None:
        raise SpecError(f"No chosen run on {chosen.name} has stored errors of {error} over time.")
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
    return _on_paper(_KINDS[kind](Selection(folder, scene, integrators, t_end), **more))


def write_figure(kind: str, folder: Path, path: Path, **chosen: Any) -> Path:
    """Write a figure; the suffix of ``path`` says SVG, PNG, PDF or JSON (Vega-Lite).

    Raises
    ------
    SpecError
        As ``figure``, which takes ``chosen``, or if the suffix is another.
    """
    if path.suffix not in FORMATS:
        raise SpecError(f"{path.name} is no figure; give a name that ends in {', '.join(FORMATS)}.")
    path.write_bytes(_file_content(figure(kind, folder, **chosen), path.suffix))
    return path


def _errors(chosen: Selection, series: Sequence[Series], error: str, across: str) -> Spec:
    group, norm = group_and_norm(error, {g for r in ok_runs(chosen.series) for g in r.errors})
    styles = line_styles(s.label for s in series)
    chart = error_charts(series, [group], [across], styles, norm)
    if chart is None:
        raise SpecError(
            f"No chosen run on {chosen.name} has both an error of {group} ({norm}) and "
            f"{ACROSS[across]}: nothing to draw."
        )
    return chart


# ---- on paper ----------------------------------------------------------------------------
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


def _file_content(figure: Spec, suffix: str) -> bytes:
    """Return the content of a figure's file; ``suffix`` is one of `FORMATS`.

    Raises
    ------
    SpecError
        If the figure cannot be drawn.
    """
    if suffix == ".json":
        return f"{chart_json(figure, indent=1)}\n".encode()
    options = {"ppi": _PNG_PER_INCH} if suffix == ".png" else {}
    drawn = picture(figure, suffix[1:], **options)
    if drawn.sentence:
        raise SpecError(drawn.sentence)
    if suffix != ".svg":
        return drawn.content
    # A pixel of the drawing is a point on paper, as it is in the PDF.
    return re.sub(rb'(?<= )(width|height)="([\d.]+)"', rb'\1="\2pt"', drawn.content, count=2)


# ---- in notebooks ------------------------------------------------------------------------
def solution_chart(label: str, rows: Rows, names: Mapping[str, Sequence[str]]) -> str | None:
    """Return the first components of each group of a run over time; None if there is no chart."""
    groups = [group for group in GROUPS if rows.values.get(group) and rows.values[group][0]]
    return _svg(trajectory_chart([(label, rows)], None, groups, line_styles([label]), names))


def orders_chart(records: Sequence[Record]) -> str | None:
    """Return errors over step sizes with the fitted orders; None if there is no chart."""
    series = series_of(records)
    styles = line_styles(label_of(r) for r in records)
    return _svg(convergence_chart(series, groups_of(ok_runs(series)), styles))


def _svg(chart: Spec | None) -> str | None:
    return picture(chart).svg if chart else None


class Selection:
    """The runs of one scene that reached the end, as series.

    Parameters
    ----------
    folder
        The run folder.
    scene
        The scene; may be None if the folder has one.
    integrators
        Names, full specs or labels of the integrators; all if empty.
    t_end
        The end of the interval in s, if the folder has the scene over several.

    Raises
    ------
    SpecError
        If a name is not known or not unique, or no run is left.
    bench.results.store.StoreError
        If the folder holds no readable store.
    """

    def __init__(
        self,
        folder: str | Path,
        scene: str | None = None,
        integrators: Sequence[str] = (),
        t_end: float | None = None,
    ) -> None:
        self.folder = Path(folder)
        with Store(self.folder) as store:
            records, scenes = list(store.records().values()), store.scenes()
        key = _one_scene(dict.fromkeys((r.problem, r.t_end) for r in records), scene, t_end)
        self.name = key[0]
        self.scene: SceneRecord | None = scenes.get(key)
        chosen = _chosen([r for r in records if (r.problem, r.t_end) == key], integrators)
        self.series: list[Series] = [s for s in series_of(chosen) if s.ok]
        if not self.series:
            raise SpecError(f"None of these runs on {self.name} reached the end.")

    def rows(self, record: Record) -> Rows:
        """The sampled values of a run."""
        with Store(self.folder) as store:
            return store.rows(record.key)


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
    place = place or "1"
    if place not in names:
        raise SpecError(f"{group} has no component {place!r}; {suggest(place, names)}.")
    return group, names[place]


def _one_scene(
    keys: Iterable[tuple[str, float]], scene: str | None, t_end: float | None
) -> tuple[str, float]:
    keys = list(keys)
    known = list(dict.fromkeys(problem for problem, _ in keys))
    if not known:
        raise SpecError("The store holds no finished run.")
    if scene is None and len(known) > 1:
        raise SpecError(f"Several scenes are stored; choose one with --scene: {', '.join(known)}.")
    name = known[0] if scene is None else scene.strip()
    if name not in known:
        # The bare name is enough if it means one scene.
        meant = [problem for problem in known if problem.partition("[")[0] == name]
        if len(meant) != 1:
            raise SpecError(f"There is no scene {name!r}; {suggest(name, known)}.")
        (name,) = meant
    ends = [end for problem, end in keys if problem == name]
    if t_end is None and len(ends) == 1:
        return name, ends[0]
    if t_end not in ends:
        listed = ", ".join(f"{end:g}" for end in ends)
        raise SpecError(f"{name} is stored to t={listed} s; choose one with --t-end.")
    return name, t_end


def _chosen(records: Sequence[Record], integrators: Sequence[str]) -> list[Record]:
    known = list(dict.fromkeys(label_of(r) for r in records))
    wanted = dict.fromkeys(label for text in integrators for label in named_labels(text, known))
    order = list(wanted) or known
    return [r for label in order for r in records if label_of(r) == label]
