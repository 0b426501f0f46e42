"""Seconds and operations of native methods: do they order the methods of a scene alike?

``make bench`` prints a table for each scene, the rank correlation of time and operations of an
attempted step, and pairs of methods that they order differently by more than a factor of two, each
with the reason. Methods take constant steps where they can.
"""

from __future__ import annotations

from functools import partial
from itertools import combinations
from typing import Any

from frame import (
    Contestant,
    NotHere,
    Row,
    at_constant_steps,
    contestant,
    native_methods,
    options,
    race,
    table,
    write,
)
from scipy.stats import spearmanr

from bench.plugins.registry import Registry
from integrators import Steps, Tolerances
from problems.base.runtime import use_threads
from problems.system import MechatronicSystem

#: Scenes: free and constrained, smooth and stiff, with and without a controller.
SCENES = ("duffing", "pendulum", "car_axis", "slider_crank", "quarter_car")
STEPS, RTOL = 20_000, 1e-9
#: Methods beside all native ones with their default options.
MORE = [f"{name}[newton=modified]" for name in ("generalized_alpha", "rattle", "lobatto_iiia_iiib")]
#: Pairs that are ordered differently by more than this factor are listed.
_APART = 2.0


def made(spec: str, scene: MechatronicSystem) -> Contestant:
    """A method at constant steps, or at a tolerance."""
    start, end = scene.interval
    try:
        return at_constant_steps(spec, Steps((end - start) / STEPS), None, scene)
    except NotHere as reason:
        if "no constant steps" not in str(reason):
            raise
    return contestant(spec, Tolerances(RTOL), None, scene)


def costs(row: Row) -> tuple[float, float]:
    """Least seconds and operations of an attempted step."""
    attempts = row["steps"] + (row["work"].get("rejected") or 0)
    return min(row["seconds"]) / attempts, row["operations"] / attempts


def pairs(rows: list[Row]) -> list[tuple[Row, Row]]:
    """Pairs of which the first takes fewer operations and more time, by more than a factor of two
    together."""
    ordered = [sorted(two, key=lambda row: costs(row)[1]) for two in combinations(rows, 2)]
    found = []
    for few, many in ordered:
        (slow, little), (fast, much) = costs(few), costs(many)
        if slow > fast and slow * much > _APART * fast * little:
            found.append((few, many))
    return found


def reason(slow: Row, fast: Row) -> str:
    """Why an operation of one method takes longer than one of another."""

    def more(one: Row, other: Row, *parts: str) -> bool:
        shares = [sum(r["bill"].get(p, 0.0) for p in parts) / r["operations"] for r in (one, other)]
        return shares[0] - shares[1] > 0.1

    if "newton=modified" in slow["contestant"]:
        return "beside choices and branches, which are free, it does few operations by old tangents"
    if more(slow, fast, "inner solves"):
        return "it solves the equations of motion in each evaluation, with a search for pivots"
    if more(fast, slow, "factorisations", "solves"):
        return "the other's matrices are full, and go several numbers in an instruction"
    if more(fast, slow, "Jacobians"):
        return "the other's products with the tangent do not wait for each other"
    return "its vectors are short, and each operation waits for the one before"


def comparison(rows: list[Row]) -> str:
    """The rank correlation (Spearman's) of seconds and operations, and the pairs."""
    seconds, operations = zip(*map(costs, rows), strict=True)
    found: Any = spearmanr(seconds, operations)[0]
    lines = [f"Rank correlation of seconds and operations: {found:.3f}.", ""]
    for few, many in pairs(rows):
        (slow, little), (fast, much) = costs(few), costs(many)
        lines.append(
            f"- `{few['contestant']}` takes {slow / fast:.1f} times as long as "
            f"`{many['contestant']}`, which takes {much / little:.1f} times as many operations: "
            f"{reason(few, many)}."
        )
    return "\n".join([*lines, ""])


def main() -> None:
    """Measure, print the tables, write the JSON."""
    given, rows = options(__doc__, 9, "stepbench-ranks.json"), []
    for name in SCENES:
        scene = Registry().problem(name)
        found = race(name, [partial(made, s, scene) for s in (*native_methods(), *MORE)],
                     given.rounds)  # fmt: skip
        found = [row for row in found if "left_out" not in row]
        print(table(found), comparison(found), sep="\n", flush=True)
        rows += found
    write(rows, given.out)


if __name__ == "__main__":
    use_threads(1)
    main()
