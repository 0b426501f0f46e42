"""Quantities that are measured of a run: groups, norms of errors, costs, and their titles.

Every list of choices, every title and every parser of such names is made from these tables.
"""

from __future__ import annotations

from collections.abc import Collection

from problems.spec import SpecError, suggest
from problems.system import GROUPS as GROUPS

#: Titles of the groups of variables in which errors are measured.
GROUP_NAMES = {
    "q": "position q",
    "v": "velocity v",
    "a": "acceleration a",
    "lam": "multiplier λ",
    "x": "controller state x",
    "y": "output y",
}


def whole(group: str) -> str:
    """Name of the error of a whole group, in the Euclidean norm of its components: "|q|"."""
    return f"|{group}|"


def error_note(group: str) -> str:
    """Name of the note of a run's rows that holds the error of a group at each: "error_q"."""
    return f"error_{group}"


#: Titles of the errors of a run. The error of a group is that of its worst component.
ERROR_NAMES = GROUP_NAMES | {whole(g): f"{name}, 2-norm" for g, name in GROUP_NAMES.items()}
#: The error that is meant where no other is named.
ERROR_MEANING = (
    "The error of a group is that of its worst component: |value - reference|, divided by the "
    "component's natural size, or where the scene states none by its largest absolute value in the "
    "reference, the largest over all steps."
)
#: Titles of the norms over time; `bench.running.errors.norms` computes them.
NORM_NAMES = {
    "max": "largest over time",
    "end": "at the end",
    "rms": "root mean square over time",
    "settled": "largest in the last quarter",
}
NORMS = tuple(NORM_NAMES)
#: Norm of every error that is shown or judged unless another is asked for.
NORM = "max"
#: Levels at which a run can violate the constraints: Phi and its two time derivatives.
LEVELS = ("position", "velocity", "acceleration")
#: Titles of the costs of a run: operations of its bill, the time in s, and counts of
#: `integrators.contract.Work`.
COST_NAMES = {
    "operations": "floating-point operations",
    "seconds": "median seconds per run",
    "residuals": "residual evaluations",
    "jacobians": "Jacobian evaluations",
    "factorisations": "factorisations",
    "newton": "Newton iterations",
    "steps": "steps",
    "solves": "linear solves",
    "rejected": "rejected steps",
}
#: Parts of a run's bill of operations; see `integrators.operations.bill`.
PARTS = ("residuals", "Jacobians", "inner solves", "factorisations", "solves")
#: Cost by which runs are compared unless another is asked for.
COST = "operations"
#: Below this many times the reference's own error, an error says nothing.
TRUST = 100.0


def group_and_norm(text: str, groups: Collection[str]) -> tuple[str, str]:
    """Read an error as a person writes it, such as "a:max" or "|a|:end".

    Parameters
    ----------
    text
        A group, a colon and a norm; without a norm, the norm is `NORM`. A group between bars means
        its 2-norm, without them its worst component.
    groups
        The groups that have errors.

    Raises
    ------
    SpecError
        If the group is not among ``groups``, or there is no such norm.
    """
    group, _, norm = (part.strip() for part in text.partition(":"))
    if group.strip("|") not in groups or group not in ERROR_NAMES:
        raise SpecError(f"There is no error of {group!r}; {suggest(group, groups)}.")
    return group, checked_norm(norm or NORM)


def checked_norm(norm: str) -> str:
    """Return the name of a norm.

    Raises
    ------
    SpecError
        If there is no such norm.
    """
    if norm not in NORMS:
        raise SpecError(f"There is no norm {norm!r}; {suggest(norm, NORMS)}.")
    return norm
