"""The command for a run of one integrator on one scene: `stepbench solve`."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import click
import msgspec
import numpy as np

from bench.commands import completion, options, sweeps
from bench.results.published import published_table
from bench.results.quantities import IMPACTS, NORMS
from bench.results.records import Record, Rows
from bench.results.table import NO_VALUE, Table, formatted

#: Components of a group that a table has at most: those of a planar mechanism of three bodies.
_SHOWN = 9


@click.command("solve")
@click.argument("problem", shell_complete=completion.scenes)
@click.argument("integrator", shell_complete=completion.integrators)
@click.option("--step", type=float, help="Step size h in s (with --pattern: the macro step H).")
@options.with_pattern
@options.with_tolerances
@options.with_t_end
@options.with_set
@sweeps.with_ensemble
@options.with_budget
@options.with_plugins
@options.with_as_json
def solve_(
    problem: str,
    integrator: str,
    step: float | None,
    pattern: tuple[float, ...] | None,
    rtol: float | None,
    atol: float | None,
    t_end: float | None,
    settings: dict[str, str],
    ensemble: int | None,
    vary: tuple[str, ...],
    seed: int | None,
    cluster: str | None,
    out: Path | None,
    budget: float,
    plugins: tuple[str, ...],
    as_json: bool,
) -> None:
    """Run one integrator on one scene.

    The table has the values at the end, errors and work. With --ensemble, run many members; --vary
    says how they differ.

    \b
    Examples:
      stepbench solve spring_mass "generalized_alpha[rho_inf=0.8]" --step 0.1 --t-end 5
      stepbench solve pendulum ida --rtol 1e-8 --set th0=3.0 --json
      stepbench solve quarter_car generalized_alpha --ensemble 1000 --vary k:2e4..3e4 -o cars.csv
      stepbench solve quarter_car newmark --ensemble 1000000 --vary k:2e4..3e4 -o cars.parquet
    """
    given = {"step": step, "pattern": pattern, "rtol": rtol, "atol": atol}
    if ensemble is not None:
        from bench.sweeps.jobs import EnsembleRequest

        _, scene, method = options.asked_for(problem, integrator, settings, plugins)
        common = scene.spec, method.spec, given, t_end, budget
        request = EnsembleRequest(*common, ensemble, vary, seed or 0)
        sources = scene.sources | method.sources
        sweeps.solve_ensemble(sources, request, cluster, out, as_json)
        return
    sweeps.refuse_alone(vary, seed, cluster, out)
    from bench.commands.terminal import RunProgress, show
    from bench.running.solve import Request, solve

    request = Request(problem, integrator, settings, **given, t_end=t_end)
    with RunProgress() as progress:
        (record, rows), names = solve(request, plugins, budget, progress)
    if as_json:
        click.echo(json.dumps(_solution(record, rows), indent=2))
    else:
        published = published_table(record.published)
        show(_end_values(record, rows, names), *filter(None, [published]), *_facts(record))
    if record.status != "ok":
        raise click.ClickException(f"{record.status}: {record.message}")


def _solution(record: Record, rows: Rows) -> dict[str, Any]:
    """Return end values, errors, work and times of a run, for JSON."""
    last = {name: values[-1] for name, values in rows.values.items() if rows.t}
    return {
        "problem": record.problem,
        "integrator": record.integrator,
        "resolution": record.resolution,
        "formulation": record.formulation,
        "status": record.status,
        "message": record.message,
        "notes": record.notes,
        "t": rows.t[-1] if rows.t else None,
        **{name: last.get(name, []) for name in ("q", "v", "a", "lam", "x", "xdot", "y")},
        "xd": last.get("xd", []),
        "events": record.events,
        "points": record.points,
        "published": [
            msgspec.to_builtins(digits) | {"difference": digits.difference}
            for digits in record.published
        ],
        "errors": record.errors,
        "reference_error": record.reference_error,
        "constraint": record.constraint,
        "energy_drift": record.energy_drift,
        "history_error": record.history_error,
        "work": record.work,
        "time": {
            "compile_s": record.compile_s,
            "run_s": record.run_s,
            "run_s_median": record.seconds,
        },
    }


def _end_values(record: Record, rows: Rows, names: Mapping[str, Sequence[str]]) -> Table:
    """The values at the end with their errors; ``names`` are those of components by group.

    Of a group with many components it has those with the largest errors.
    """
    cells, left_out = [], False
    for group, values in rows.values.items() if rows.t else ():
        errors = record.components.get(group, {})
        largest = [-(error or 0.0) for error in errors.get("max", [0.0] * len(values[-1]))]
        shown = sorted(np.argsort(largest, kind="stable")[:_SHOWN])
        left_out |= len(shown) < len(largest)
        for i in shown:
            own = (formatted(errors[norm][i] if norm in errors else None, ".2e") for norm in NORMS)
            cells.append([group, names[group][i], f"{values[-1][i]:.10g}", *own])
    end = f"at t={rows.t[-1]:.6g} s" if rows.t else "at the end"
    places = [
        [name, f"{axis} [m]", f"{value:.10g}", *(NO_VALUE for _ in NORMS)]
        for name, place in record.points.items()
        for axis, value in zip("xyz", place, strict=False)
    ]
    cells += places[: 3 * _SHOWN]
    left_out |= len(places) > 3 * _SHOWN
    title = f"{record.integrator} on {record.problem}, {record.resolution}: {record.status}"
    note = f"The {_SHOWN} components of a group with the largest errors; --json has all."
    head = ["group", "component", end, *NORMS]
    return Table(title, head, cells, note=note if left_out else "")


def _facts(record: Record) -> list[str]:
    """Lines on the meaning of errors, constraints, work, energy and times of a run."""
    lines = []
    if record.components:
        steps = record.work.get("steps") or 0
        where = f", at {record.rows} of {steps} steps" if record.rows < steps else ""
        lines = [f"{', '.join(NORMS)}: errors relative to the component's largest value{where}"]
    for title, numbers in (
        ("constraint residual", record.constraint),
        ("work", record.work),
        ("floating-point operations", record.operations),
    ):
        known = [
            f"{name} {value:.4g}" if isinstance(value, float) else f"{name} {value}"
            for name, value in numbers.items()
            if value is not None
        ]
        if known:
            lines.append(f"{title}: {', '.join(known)}")
    lines += [f"note: {note}" for note in record.notes]
    if record.events:
        number, expected, time = (record.events[k] for k in ("events", "expected", "time"))
        found = f"events: {number:g} of {expected:g}, their times off by at most {time:.3g} s"
        more = [f"{k} {record.events[k]:.1e}" for k in IMPACTS if k in record.events]
        lines.append(f"{found}; relative errors: {', '.join(more)}" if more else found)
    if record.history_error is not None:
        lines.append(f"error of the named points, IFToMM's rule: {record.history_error:.3g}")
    if record.energy_drift is not None:
        lines.append(f"energy drift: {record.energy_drift:.3g}")
    prepared = f"prepared in {formatted(record.compile_s, '.2g')} s of processor time"
    if record.run_s:
        lines.append(f"{prepared}, run in {record.seconds:.3g} s (median of {len(record.run_s)})")
    elif record.compile_s:
        lines.append(f"{prepared}; `stepbench run` takes the times of runs")
    return lines
