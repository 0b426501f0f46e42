"""Tables of ensembles, long runs, stability and the failure atlas, as commands show them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from bench.results.drift import RULE, LongRun, titled
from bench.results.experiments import CaseResult, ExperimentResult, bounds
from bench.results.table import NO_VALUE, Table, formatted

if TYPE_CHECKING:
    from bench.atlas.experiments import Experiment
    from bench.sweeps.parts import Results
    from bench.sweeps.shards import ShardRun

Parts = list[Table | str]


def ensemble_table(run: ShardRun, results: Results) -> Parts:
    """Least, median and largest end values; then statuses, work and times."""
    plan, count = run.plan, results.statuses.total()
    title = f"{plan.integrator} on {plan.problem}: {count} members at t={plan.t_end:g} s"
    columns = ("min", "median", "max")
    rows = [
        [name, *(f"{numbers[column]:.9g}" for column in columns)]
        for name, numbers in results.summary().items()
    ]
    lines = [", ".join(f"{number} {status}" for status, number in results.statuses.items())]
    lines += [
        f"{status}, first member {member}: {message}"
        for status, (member, message) in results.first.items()
        if status != "ok"
    ]
    work = ", ".join(f"{name} {counts}" for name, counts in results.work.items())
    lines.append(f"work of all: {work}")
    if run.members == count and plan.shards == 1:
        lines.append(
            f"prepared in {run.compile_s:.2g} s, run in {run.run_s:.3g} s: "
            f"{count / run.run_s:.3g} members/s"
        )
    elif run.members:
        lines.append(
            f"{run.members} members run now, in {run.wall_s:.3g} s: "
            f"{run.members / run.wall_s:.3g} members/s (shards together: prepared in "
            f"{run.compile_s:.2g} s, run in {run.run_s:.3g} s)"
        )
    return [Table(title, ["value", *columns], rows), *lines]


def drift_table(results: Sequence[LongRun]) -> Table:
    """Drift in long runs, a line for each integrator and quantity."""
    rows = []
    for run in results:
        name = f"{run.integrator}, {formatted(run.steps, 'd')} steps: {run.status}"
        for quantity, found in run.measured:
            numbers = (formatted(value, ".3e") for value in (found.largest, found.per_s))
            rows.append([name, titled(quantity), *numbers, found.verdict])
        if not run.measured:
            rows.append([name, *[NO_VALUE] * 4])
    title = f"Long runs of {results[0].problem}, h={results[0].h:g} s"
    return Table(title, ["integrator", "quantity", "largest", "per s", "drift"], rows, note=RULE)


_STABILITY_COLUMNS = ("radius", "damping", "period error", "overshoot q", "overshoot v")


def stability_tables(results: Sequence[dict[str, Any]]) -> Parts:
    """Numbers over omega h and properties, for each integrator."""
    parts: Parts = []
    for f in results:
        several = len(f["pattern"]) > 1
        name = "omega H" if several else "omega h"
        over = f"a pattern of {len(f['pattern'])} steps" if several else "a step"
        rows = []
        for omega_h, radius, *others in zip(*f["at"].values(), strict=True):
            lost = any(low <= omega_h <= high for low, high in f["unsolved"])
            size = "not solved" if lost else formatted(radius, ".12f", "inf")
            rows.append([f"{omega_h:.6g}", size, *(formatted(value, ".5e") for value in others)])
        title = f"{f['integrator']}, {f['system']}: growth over {over}"
        parts.append(Table(title, [name, *_STABILITY_COLUMNS], rows))
        parts += [f"{title}: {text}" for title, text in _properties(f, name)]
        parts.append("")
    return parts[:-1]


def _properties(f: dict[str, Any], name: str) -> list[tuple[str, str]]:
    """Titles and texts of the properties of one integrator."""
    solved = not f["unsolved"] or f["unsolved"][-1][1] < f["omega_h"][-1]
    at_infinity = "infinite" if solved else "not solved"
    properties = [
        ("radius at infinity", formatted(f["radius_at_infinity"], ".6f", at_infinity)),
        ("order", formatted(f["order"], "d")),
        (f"grows for {name} in", _ranges(f["growing"])),
        ("bifurcation", formatted(f["bifurcation"], ".6g", "none")),
    ]
    if f["unsolved"]:
        where = f"for {name} in {_ranges(f['unsolved'])}; there are no numbers there"
        properties.insert(0, ("Newton's method did not converge", where))
    if f["overshoot_orders"]:
        q, v = f["overshoot_orders"]
        properties.append(("overshoot", f"of q like ({name})^{q}, of v like ({name})^{v}"))
    for kind, words in (("alternating", "two steps in turns"), ("any", "up to six steps")):
        if kind in f["safe"]:
            ratio = formatted(f["safe"][kind]["ratio"], ".3f", "above 10")
            properties.append((f"largest safe ratio, {words}", ratio))
    return properties


def _ranges(ranges: list[tuple[float, float | None]]) -> str:
    """Ranges of omega h in words."""
    return "; ".join(f"{a:.9g} to {formatted(b, '.9g', 'infinity')}" for a, b in ranges) or "none"


def experiment_table(experiments: Sequence[Experiment]) -> Table:
    """Numbers, names and titles."""
    rows = [[str(e.number), e.name, e.title] for e in experiments]
    return Table("Failure atlas", ["", "name", "what fails"], rows)


def atlas_tables(results: Sequence[ExperimentResult]) -> Parts:
    """Every number that was measured, beside what was predicted."""
    parts: Parts = []
    for f in results:
        parts.append(f"{f.number}. {f.title}: {f.verdict}")
        for part in f.parts:
            rows = [[f"  {case.label}", *_case_columns(case)] for case in part.cases]
            parts += [part.text, Table("", ["", "found", "predicted", "", ""], rows)]
        parts.append("")
    return parts[:-1]


def _case_columns(case: CaseResult) -> list[str]:
    mark = {True: "as predicted", False: "differs", None: ""}[case.as_predicted]
    return [
        formatted(case.number, ".4g"),
        "" if case.predicted is None else bounds(case.predicted),
        "not measured" if case.stopped else mark,
        case.verdict + (f" ({case.message})" if case.message else ""),
    ]
