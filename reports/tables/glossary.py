"""The terms of the report, each with a definition of one sentence."""

from __future__ import annotations

import re
from collections.abc import Iterator


class Term:
    """A term with its definition, and other words for it beside its plural."""

    def __init__(self, definition: str, name: str, *also: str) -> None:
        self.definition, self.name, self.also = definition, name, also

    @property
    def title(self) -> str:
        """The term, with other words for it behind."""
        return self.name + (f" ({', '.join(self.also)})" if self.also else "")

    @property
    def anchor(self) -> str:
        """The anchor of the term in the glossary: term-relative-error."""
        return "term-" + re.sub(r"\W+", "-", self.name.lower())


#: The definitions by the term and other words for it.
_DEFINITIONS = {
    "Baumgarte": "Constraints that are not solved but pulled back: their violation decays like a "
    "damped oscillation.",
    "Constraint": "An equation Φ(q, t) = 0 that the coordinates must satisfy at all times, such as "
    "a joint.",
    "Controller state": "An unknown x with a differential equation of first order, such as the "
    "integral of a controller.",
    "Corrected start, start=corrected, plain start": "A shifted acceleration with which a "
    "generalized-α method begins, so that its first steps have full order; the plain start, the "
    "exact acceleration, costs them one.",
    "Damping ratio, numerical damping": "The part of critical damping that a method adds to an "
    "oscillation that has none.",
    "Drift": "The growth of what should stay constant: the constraint residual, or the energy of a "
    "system that conserves it.",
    "GGL": "The formulation of Gear, Gupta and Leimkuhler, which holds the constraints at the "
    "level of positions and of velocities at once and has index 2.",
    "Index, index 1, index 2, index 3, index1, index2, index3": "The number of differentiations "
    "that turn equations with constraints into differential equations: 3 with constraints on "
    "positions, and the higher the harder.",
    "Multiplier": "An unknown λ, the force that holds a constraint.",
    "Newton iteration, modified Newton, full Newton": "A linear solve that improves the guess of "
    "an implicit step; full Newton computes its matrix (tangent) anew each time, modified "
    "Newton keeps it.",
    "Norm": "The rule that makes one number of an error over time: its largest value over all "
    "steps unless another is named.",
    "ODE form": "The equations solved for the accelerations, constraints differentiated twice "
    "(index 1).",
    "Operations, floating-point operations": "Floating-point operations of a run, counted from the "
    "program of its steps, the same on every machine; those of library codes are an estimate: "
    "their own arithmetic is taken from published formulas.",
    "Order": "The power p with which an error falls: with half the step it is 2^p times smaller.",
    "Performance profile": "The part of all tasks that a method solves at no more than so many "
    "times the cost of the best one.",
    "Period error": "The relative change of the period of an oscillation that a method computes.",
    "Projected, unprojected": "After each step the values are moved back onto the constraints; "
    "unprojected: they drift off.",
    "Reference": "The solution with which runs are compared: a closed form, or a computation that "
    "is far more accurate than the runs and knows its own error.",
    "Relative error": "The distance from the reference, divided by the component's natural size, "
    "if the scene states one, or its largest absolute value there; of a group the worst component "
    "counts; of constraints |Φ| or |dΦ/dt|, divided by the change that positions or velocities "
    "make if each changes by its size, an angle by at most 1 rad.",
    "Residual evaluation": "One evaluation of the equations of motion, the work that every "
    "implicit method does.",
    "rho_inf, ρ∞": "The spectral radius ρ∞ of a method at steps of infinite length: 1 damps "
    "nothing, 0 all that steps cannot resolve.",
    "Settled, last quarter": "The norm that takes the largest error in the last quarter of the "
    "time, when the transient of the start is over.",
    "Silently wrong": "A run that reaches the end with an error above 0.1 (largest over time) and "
    "no warning.",
    "Spectral radius": "The factor by which a step multiplies the slowest decaying part of an "
    "error or a vibration; above 1 the solution grows.",
    "Start transient, transient": "Errors of lower order in the first steps, made by starting "
    "values that do not fit the method.",
    "Stiff, stiffness": "A system is stiff if it has parts that decay or oscillate much faster "
    "than the motion that is of interest.",
    "Tie, tied, significant": "Two methods tie if their costs do not differ "
    "significantly: times by the median of their quotients in rounds of samples (with fewer than "
    "six beyond a factor of 2), operations by 10 %; a "
    "method that is among the cheapest from a later start of the runs ties, too.",
    "Tolerance, rtol": "The local error that a method with steps of its own choice allows itself "
    "in a step: rtol, relative to the value, and atol, which is rtol/100 unless another is named.",
    "Verdict fails, spared": "In the failure atlas a method fails if it shows the failure, its "
    "number outside of the interval in which methods pass, and is spared if it does not.",
}
TERMS = [Term(text, *words.split(", ")) for words, text in _DEFINITIONS.items()]
_BY_FORM = {
    form.lower(): term for term in TERMS for form in (term.name, f"{term.name}s", *term.also)
}
_FORMS = re.compile(
    rf"(?<![\w-])({'|'.join(sorted(map(re.escape, _BY_FORM), key=len, reverse=True))})"
    r"(?![\w-]| statistics)",
    re.IGNORECASE,
)


def terms_in(text: str) -> Iterator[tuple[int, int, Term]]:
    """The terms that a text uses, with the places of their first and behind their last letter."""
    for found in _FORMS.finditer(text):
        yield found.start(), found.end(), _BY_FORM[found.group().lower()]
