"""The terms of the report, each with a definition of one sentence."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass


@dataclass(frozen=True)
class Term:
    """A term, its definition, and the forms in which texts use it (the name itself if none)."""

    name: str
    definition: str
    forms: tuple[str, ...] = ()

    @property
    def anchor(self) -> str:
        """The anchor of the term in the glossary: term-pareto-front."""
        return "term-" + re.sub(r"\W+", "-", self.name.lower()).strip("-")


TERMS = (
    Term(
        "Acceleration error",
        "The error of the accelerations of the equations of motion at the reported times; methods "
        "often lose an order there first.",
        ("error in a", "error in the acceleration"),
    ),
    Term(
        "Accuracy asked",
        "The relative error that a run may have at most; the cheapest run below it wins.",
        ("accuracy asked", "asked accuracy", "an accuracy"),
    ),
    Term(
        "Constraint",
        "An equation Φ(q, t) = 0 that the coordinates must satisfy at all times, such as a joint.",
        ("constraints", "constraint"),
    ),
    Term(
        "Contestant",
        "All integrators that do the same on a scene, counted as one.",
        ("contestants", "contestant"),
    ),
    Term(
        "Controller state",
        "An unknown x with a differential equation of first order, such as the integral of a "
        "controller.",
        ("controller states", "controller state"),
    ),
    Term(
        "Damping ratio",
        "The part of critical damping that a method adds to an oscillation that has none.",
        ("damping ratios", "damping ratio", "numerical damping"),
    ),
    Term(
        "Drift",
        "The growth of what should stay constant: the constraint residual, or the energy of a "
        "system that conserves it.",
        ("drift",),
    ),
    Term(
        "Error",
        "The distance from the reference, divided by the component's natural size, if the scene "
        "states one, or its largest absolute value there; of a group the worst component counts.",
        ("relative error", "Relative error"),
    ),
    Term(
        "Floor",
        "A hundred times the reference's own error: below it an error says nothing.",
        ("floor",),
    ),
    Term(
        "GGL",
        "The formulation of Gear, Gupta and Leimkuhler, which holds the constraints at the level "
        "of positions and of velocities at once and has index 2.",
        ("GGL", "ggl"),
    ),
    Term(
        "Index",
        "The number of differentiations that turn equations with constraints into differential "
        "equations: 3 with constraints on positions, and the higher the harder.",
        ("index 3", "index 2", "index 1", "index3", "index2", "index1", "index"),
    ),
    Term(
        "Multiple of the best",
        "The cost of a method divided by the cost of the cheapest one that reaches the accuracy "
        "on the same scene.",
        ("multiple of the best", "multiple of the cheapest"),
    ),
    Term(
        "Multiplier",
        "An unknown λ, the force that holds a constraint.",
        ("multipliers", "multiplier"),
    ),
    Term(
        "Newton iteration",
        "A linear solve that improves the guess of an implicit step; full Newton takes a new "
        "tangent each time, modified Newton keeps an old one.",
        ("Newton iterations", "Newton iteration", "modified Newton", "full Newton"),
    ),
    Term(
        "Norm",
        "The rule that makes one number of an error over time: its largest value over all steps "
        "unless another is named.",
        ("norms", "norm"),
    ),
    Term(
        "Operations",
        "Floating-point operations of a run, counted from its equations and its linear algebra, "
        "the same on every machine.",
        ("floating-point operations", "operations"),
    ),
    Term(
        "Order",
        "The power p with which an error falls: with half the step it is 2^p times smaller.",
        ("orders", "order"),
    ),
    Term(
        "Pareto front",
        "The runs that no other run beats in accuracy and cost at once.",
        ("Pareto front", "Pareto fronts"),
    ),
    Term(
        "Performance profile",
        "The part of all tasks that a method solves at no more than so many times the cost of the "
        "best one.",
        ("performance profile", "Performance profile"),
    ),
    Term(
        "Period error",
        "The relative change of the period of an oscillation that a method computes.",
        ("period error",),
    ),
    Term(
        "Reference",
        "The solution with which runs are compared: a closed form, or a computation that is far "
        "more accurate than the runs and knows its own error.",
        ("reference",),
    ),
    Term(
        "Residual evaluation",
        "One evaluation of the equations of motion, the work that every implicit method does.",
        ("residual evaluations", "residual evaluation"),
    ),
    Term(
        "Settled",
        "The norm that takes the largest error in the last quarter of the time, when the "
        "transient of the start is over.",
        ("settled", "last quarter"),
    ),
    Term(
        "Spectral radius",
        "The factor by which a step multiplies the slowest decaying part of an error or a "
        "vibration; above 1 the solution grows.",
        ("spectral radius",),
    ),
    Term(
        "Start transient",
        "Errors of lower order in the first steps, made by starting values that do not fit the "
        "method.",
        ("start transient", "transient"),
    ),
    Term(
        "Stiff",
        "A system is stiff if it has parts that decay or oscillate much faster than the motion "
        "that is of interest.",
        ("stiffness", "stiff"),
    ),
    Term(
        "Tie",
        "Two methods tie if their costs cannot be told apart: times by the quotients within "
        "rounds of samples, operations within 10 %.",
        ("ties", "tied", "tie"),
    ),
    Term(
        "Tolerance",
        "The local error that a method with steps of its own choice allows itself in a step.",
        ("tolerances", "tolerance", "rtol"),
    ),
    Term(
        "Work-precision chart",
        "Error against cost, a line for each method from coarse to fine: further down is more "
        "accurate, further left is cheaper.",
        ("work-precision",),
    ),
)

_BY_FORM = {form: term for term in TERMS for form in term.forms or (term.name,)}
_FORMS = re.compile(
    r"(?<![\w-])("
    + "|".join(map(re.escape, sorted(_BY_FORM, key=len, reverse=True)))
    + r")(?![\w-]| statistics)"
)


def terms_in(text: str) -> Iterator[tuple[int, int, Term]]:
    """The terms that a text uses, with the places of their first and behind their last letter."""
    for found in _FORMS.finditer(text):
        yield found.start(), found.end(), _BY_FORM[found.group()]
