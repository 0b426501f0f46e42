"""Seconds and operations of native methods: do they order the methods of a scene alike?

``make bench`` prints a table for each scene, with time and operations of an attempted step, the
rank correlation of both, and pairs of methods that they order differently by more than a factor of
two, each with the reason. Methods take constant steps where they can. Times are the least of
several runs; they are not checked.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from itertools import combinations
from typing import Any, NamedTuple

from opponents import options, timed

from bench.plugins.registry import Registry
from integrators import Steps, Tolerances
from integrators.native.step_method import NativeMethod
from problems.runtime import use_threads
from problems.spec import SpecError

#: Scenes: free and constrained, smooth and stiff, with and without a controller.
SCENES = ("duffing", "pendulum", "car_axis", "slider_crank", "quarter_car")
STEPS, RTOL, RUNS = 20_000, 1e-9, 9
#: Methods beside all native ones with their default options.
MORE = tuple(
    f"{name}[newton=modified]" for name in ("generalized_alpha", "rattle", "lobatto_iiia_iiib")
)
#: Pairs that are ordered differently by more than this factor are listed.
_APART = 2.0


class Timed(NamedTuple):
    """A method on a scene: time in s and operations of an attempted step, these by part."""

    method: str
    seconds: float
    bill: dict[str, float]

    @property
    def operations(self) -> float:
        """All operations."""
        return sum(self.bill.values())

    def share(self, *parts: str) -> float:
        """Parts of the bill over all of it."""
        return sum(self.bill.get(part, 0.0) for part in parts) / self.operations


def measured(spec: str, scene: str, runs: int) -> Timed | None:
    """Time a method; None if it does not take the scene, or does not come to the end."""
    registry = Registry()
    problem, method = registry.problem(scene), registry.integrator(spec)
    start, end = problem.interval
    method = method.at_constant_steps() or method
    size = Steps((end - start) / STEPS) if method.controls == "step" else Tolerances(RTOL)
    try:
        run = method.prepare(problem, end, size)
    except SpecError:
        return None
    found = run.measure()
    if found.status != "ok":
        return None
    attempts = (found.work.steps or 0) + (found.work.rejected or 0)
    least = min(timed(run.execute)() for _ in range(runs))
    bill = {part: value / attempts for part, value in run.bill(found).items()}
    return Timed(method.spec, least / attempts, bill)


def natives() -> list[str]:
    """All native methods with their default options, and some others."""
    registry = Registry()
    methods = map(registry.integrator, registry.integrators)
    return [*(one.spec for one in methods if isinstance(one, NativeMethod)), *MORE]


def correlation(found: Sequence[Timed]) -> float:
    """The rank correlation of seconds and operations (Spearman's)."""
    from scipy.stats import spearmanr

    return float(spearmanr([one.seconds for one in found], [one.operations for one in found])[0])


def pairs(found: Sequence[Timed]) -> list[tuple[Timed, Timed]]:
    """Pairs of which the first takes fewer operations and more time, by more than a factor of two
    together."""
    ordered = [sorted(two, key=lambda one: one.operations) for two in combinations(found, 2)]
    return [
        (few, many)
        for few, many in ordered
        if few.seconds > many.seconds
        and few.seconds * many.operations > _APART * many.seconds * few.operations
    ]


def reason(slow: Timed, fast: Timed) -> str:
    """Why an operation of one method takes longer than one of another."""
    if "newton=modified" in slow.method:
        return "beside choices and branches, which are free, it does few operations by old tangents"
    if slow.share("inner solves") - fast.share("inner solves") > 0.1:
        return "it solves the equations of motion in each evaluation, with a search for pivots"
    if fast.share("factorisations", "solves") - slow.share("factorisations", "solves") > 0.1:
        return "the other's matrices are full, and go several numbers in an instruction"
    if fast.share("Jacobians") - slow.share("Jacobians") > 0.1:
        return "the other's products with the tangent do not wait for each other"
    return "its vectors are short, and each operation waits for the one before"


def row(one: Timed) -> str:
    """A method in the table."""
    speed = 1e9 * one.seconds / one.operations
    return f"| `{one.method}` | {one.operations:.0f} | {1e6 * one.seconds:.2f} | {speed:.2f} |"


def table(scene: str, found: Sequence[Timed]) -> str:
    """Methods from few to many operations, the correlation, and the pairs."""
    head = f"| {scene}: method | operations/step | µs/step | ns/operation |"
    lines = [head, "|---|---:|---:|---:|", *map(row, sorted(found, key=lambda one: one.operations))]
    lines += ["", f"Rank correlation of seconds and operations: {correlation(found):.3f}.", ""]
    for few, many in pairs(found):
        time, work = few.seconds / many.seconds, many.operations / few.operations
        lines.append(
            f"- `{few.method}` takes {time:.1f} times as long as `{many.method}`, which takes "
            f"{work:.1f} times as many operations: {reason(few, many)}."
        )
    return "\n".join([*lines, ""])


def main() -> None:
    """Measure, print the tables, write the JSON."""
    given = options(__doc__, RUNS, "stepbench-ranks.json")
    rows: dict[str, list[dict[str, Any]]] = {}
    for scene in SCENES:
        tried = (measured(one, scene, given.rounds) for one in natives())
        found = [one for one in tried if one]
        print(table(scene, found), flush=True)
        rows[scene] = [one._asdict() for one in found]
        given.out.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    print(f"Written to {given.out}.")


if __name__ == "__main__":
    use_threads(1)
    main()
