"""Values over time, or over each other: components of the variables, and notes such as steps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from bench.results.quantities import GROUP_NAMES, error_note
from bench.results.records import Rows
from problems.variables import INVARIANTS
from reports.charts import vega_lite as vl
from reports.charts.line_styles import LineStyle
from reports.formatting import component_title

#: Components of a group that are drawn if no others are chosen.
COMPONENTS_SHOWN = 3
#: Field and title of the horizontal axis.
TIME = ("t", "time in s")
#: Notes of a run by name: title of the axis, and whether it is logarithmic.
ERRORS = {error_note(group): (f"error in {name}", True) for group, name in GROUP_NAMES.items()}
HISTORIES = ERRORS | {
    "h": ("step size h in s", True),
    "gamma": ("weight gamma", False),
    "position": ("constraint residual, position", True),
    "velocity": ("constraint residual, velocity", True),
    **{block: (f"relative change of the {block}", True) for block in INVARIANTS},
}

#: Rows of a run that a chart shows.
MOST_ROWS = 150
#: A run is drawn until a value exceeds the reference's largest one by this factor.
_OUT_OF_SCALE = 5
#: A group and the place of a component in it, counted from 0.
Component = tuple[str, int]


def trajectory_chart(
    runs: Sequence[tuple[str, Rows]],
    reference: Rows,
    groups: Sequence[str],
    styles: Mapping[str, LineStyle],
    names: Mapping[str, Sequence[str]],
    chosen: Sequence[Sequence[Component]] = (),
) -> vl.Spec | None:
    """Components of the groups over time, the reference as a broad grey line behind.

    Parameters
    ----------
    runs
        Label and sampled values of each run.
    names
        Names of the components by group, with units.
    chosen
        Components that are drawn over time, or a component and a second one over which it is drawn;
        the first few of every group if empty: of q, v, a for each coordinate, then the others.
    """
    few = range(COMPONENTS_SHOWN)
    motion = [[(g, i)] for i in few for g in groups if g in "qva"]
    chosen = chosen or motion + [[(g, i)] for g in groups if g not in "qva" for i in few]
    needed = list(dict.fromkeys(place for places in chosen for place in places))
    # One wide table serves all panels, so that the page stays small.
    rows = [row for label, run in runs for row in time_rows(run, label, needed)]
    drawn = vl.Dataset("runs", rows)
    behind = vl.Dataset("reference", time_rows(reference, "reference", needed))
    broad = {"type": "line", "color": vl.GREY, "strokeWidth": 5, "opacity": 0.4, "clip": True}
    panels: list[vl.Spec] = []
    for places in chosen:
        axes = [(f"{g}{i}", component_title(g, i, names)) for g, i in places]
        (name, title), over = axes[0], axes[1] if len(axes) > 1 else TIME
        layers = []
        if {name, over[0]} <= set(behind.columns):
            encoding = _places(name, title, over)
            layers.append({"data": behind.source, "mark": broad, "encoding": encoding})
        if {name, over[0]} <= set(drawn.columns):
            layers.append(_run_lines(drawn, name, title, vl.Lines(styles), not panels, over))
        panels += [{"layer": layers}] if layers else []
    return vl.arrange(panels, [drawn, behind], min(3, len(panels)), height=150)


def histories(
    runs: Sequence[tuple[str, Rows]], styles: Mapping[str, LineStyle], notes: Sequence[str]
) -> vl.Spec | None:
    """Notes of runs over time, such as step sizes, a panel each; constant ones are left out."""
    runs = [(label, run) for label, run in runs if any(map(run.notes.get, notes))]
    lines = vl.Lines({label: styles[label] for label, _ in runs})
    rows = [row for label, run in runs for row in time_rows(run, label, notes=notes)]
    data, panels = vl.Dataset("histories", rows), []
    for name in notes:
        noted = [[v for v in run.notes.get(name, []) if v is not None] for _, run in runs]
        if any(v and max(v) - min(v) > 1e-9 * max(map(abs, v)) for v in noted):
            panels.append({"layer": [note_lines(data, name, lines, first=not panels)]})
    return vl.arrange(panels, [data], min(3, len(panels)), height=170)


def note_lines(data: vl.Dataset, name: str, lines: vl.Lines, first: bool) -> vl.Spec:
    """One of `HISTORIES` over time, a line per run."""
    title, logarithmic = HISTORIES[name]
    layer = _run_lines(data, name, title, lines, first, TIME)
    if logarithmic:
        values = [abs(v) for row in data.rows if (v := row.get(name))]
        layer["transform"] = [{"filter": f"datum.{name} > 0"}]
        layer["encoding"]["y"] = vl.log_quantity(name, values or [1.0], ".0e", title=title)
    return layer


def _run_lines(
    data: vl.Dataset, field: str, title: str, lines: vl.Lines, first: bool, over: tuple[str, str]
) -> vl.Spec:
    """One component over time or another one, a line per run."""
    legend = {"symbolType": "stroke", "symbolSize": 400}
    looks = {"color": lines.channel("color", **legend), "opacity": vl.PICKED}
    looks["strokeDash"] = lines.channel("dash", **legend)
    return {
        "data": data.source,
        "params": vl.moves(f"zoom_{field}_{over[0]}", first),
        "mark": {"type": "line", "strokeWidth": 1.4, "clip": True},
        "encoding": _places(field, title, over) | looks,
    }


def _places(field: str, title: str, over: tuple[str, str]) -> vl.Spec:
    return {
        "x": vl.quantity(over[0], title=over[1], scale={"nice": False, "zero": False}),
        "y": vl.quantity(field, title=title, scale={"zero": False}),
        "order": vl.quantity(TIME[0]),  # else a line joins its points from left to right
    }


# ---- rows of a run that a chart shows ----------------------------------------------------
def time_rows(
    rows: Rows, label: str, components: Sequence[Component] = (), notes: Sequence[str] = ()
) -> list[dict[str, Any]]:
    """A row per time with these components and notes, as far as the run has them."""
    table = []
    for k, t in enumerate(rows.t):
        row: dict[str, Any] = {"t": vl.short(t), "series": label}
        for group, i in components:
            values = rows.values.get(group) or []
            if k < len(values) and i < len(values[k]):
                row[f"{group}{i}"] = vl.short(values[k][i])
        row |= {name: vl.short(own[k]) for name in notes if (own := rows.notes.get(name))}
        table.append({name: value for name, value in row.items() if value is not None})
    return table


def thinned(rows: Rows) -> Rows:
    """At most about ``MOST_ROWS`` rows, evenly chosen, the last among them."""
    stride = -(-len(rows.t) // MOST_ROWS)
    return _chosen(rows, [*range(0, len(rows.t) - 1, stride), len(rows.t) - 1] if rows.t else [])


def before_divergence(rows: Rows, reference: Rows) -> Rows | None:
    """The first rows, as long as they fit the reference's scale; None for fewer than two.

    The values of a run that diverges would flatten all other lines.
    """
    limits = {
        name: _OUT_OF_SCALE * max((abs(x) for row in values for x in row), default=0.0)
        for name, values in reference.values.items()
    }
    keep = 0
    while keep < len(rows.t) and all(
        abs(x) <= limits[name]
        for name, values in rows.values.items()
        if name in limits
        for x in values[keep]
    ):
        keep += 1
    return _chosen(rows, range(keep)) if keep > 1 else None


def _chosen(rows: Rows, places: Sequence[int]) -> Rows:
    return Rows(
        t=[rows.t[k] for k in places],
        values={name: [table[k] for k in places] for name, table in rows.values.items() if table},
        notes={name: [column[k] for k in places] for name, column in rows.notes.items() if column},
    )
