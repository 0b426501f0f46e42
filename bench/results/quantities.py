"""Quantities that are measured of a run: groups, norms of errors, costs, and their titles.

Every list of choices and every title is made from these tables.
"""

from __future__ import annotations

from typing import NamedTuple

from problems.variables import GROUPS as GROUPS

#: Titles of the groups of variables in which errors are measured.
GROUP_NAMES = {
    "q": "position q",
    "v": "velocity v",
    "a": "acceleration a",
    "lam": "multiplier λ",
    "x": "controller state x",
    "y": "output y",
    "xd": "held value xd",
}


def whole(group: str) -> str:
    """Name of the error of a whole group, in the Euclidean norm of its components: "|q|"."""
    return f"|{group}|"


def quantity(group: str) -> str:
    """The group of a question in words, without its letter: "acceleration"."""
    return ERROR_NAMES[group].rpartition(" ")[0]


def error_note(group: str) -> str:
    """Name of the note of a run's rows that holds the error of a group at each: "error_q"."""
    return f"error_{group}"


def point_notes(name: str, count: int) -> list[str]:
    """Names of the notes of a run's rows with the coordinates of a named point in m."""
    return [f"{name} {axis} [m]" for axis in "xyz"[:count]]


#: Titles of the violations of the constraints that are asked for like errors of groups.
VIOLATIONS = {"constraint": "constraints Φ", "constraint_velocity": "constraint velocities dΦ/dt"}
#: All whose errors are compared and asked for, by the name in records, commands and addresses.
ASKED = (*GROUPS, *VIOLATIONS)
#: Titles of the errors of a run. The error of a group is that of its worst component.
ERROR_NAMES = GROUP_NAMES | VIOLATIONS
ERROR_NAMES |= {whole(g): f"{name}, 2-norm" for g, name in GROUP_NAMES.items()}
#: The error that is meant where no other is named.
ERROR_MEANING = (
    "The error of a group is that of its worst component: |value - reference|, divided by the "
    "component's natural size, or where the scene states none by its largest absolute value in the "
    "reference, the largest over all steps."
)
#: Titles of the norms over time; `bench.running.errors.norms` computes them.
NORMS = {
    "max": "largest over time",
    "end": "at the end",
    "rms": "root mean square over time",
    "settled": "largest in the last quarter",
}
#: Norm of every error that is shown or judged unless another is asked for.
NORM = "max"
#: Levels at which a run can violate the constraints: Phi and its two time derivatives.
LEVELS = ("position", "velocity", "acceleration")


class Cost(NamedTuple):
    """The words by which pages speak of a cost of a run.

    The ``title`` stands in charts and menus, ``words`` and the ``least`` of them in sentences, the
    ``unit`` behind numbers. ``tie`` is the quotient up to which two costs are equal; times have
    intervals of their own, too.
    """

    title: str
    words: str
    least: str
    unit: str
    tie: float = 1.0


#: Costs of a run by name, by each of which integrators are ranked: operations of its bill, the time
#: in s, and a count of `integrators.contract.Work`.
COSTS = {
    # The model of operations is no more exact than 10 %. One program takes several per cent
    # more or less time in another process, because its memory lies elsewhere.
    "operations": Cost(
        "floating-point operations", "operations", "fewest operations", "operations", 1.1
    ),
    "seconds": Cost("median seconds per run", "time", "least time", "s", 1.1),
    "residuals": Cost(
        "residual evaluations", "residual evaluations", "fewest residual evaluations", "evaluations"
    ),
}
#: Parts of a run's bill of operations; see `integrators.program_costs.bill`.
PARTS = ("residuals", "Jacobians", "inner solves", "factorisations", "solves", "method")
#: Cost by which runs are compared unless another is asked for.
COST = "operations"
#: A run that ends well with a larger error than this has nothing right.
WRONG = 0.1
#: Below this many times the reference's own error, an error says nothing.
TRUST = 100.0
