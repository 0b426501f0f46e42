"""Errors of a run from later starts of the same motion: how much of an error is luck.

The places of the steps, and the steps that are rejected, change with the start, and errors with
them: those of an adaptive method on a sensitive scene by a factor of ten. A later start needs no
reference of its own.
"""

from __future__ import annotations

import numpy as np

from bench.results.quantities import NORM
from bench.running import measure
from bench.running.errors import constraint_errors, relative_errors
from integrators import answers
from integrators.contract import Integrator
from integrators.resolutions import Steps, Tolerances
from problems.initial_values import InconsistentStart, NoConsistentStart
from problems.reference import Reference
from problems.system import State
from problems.usage import computed_seconds

#: The later starts, in parts of the interval.
LATER = (0.01, 0.02, 0.03)
#: Processor time in s up to which a run is repeated.
_LONGEST = 0.25


def errors_from_later_starts(
    integrator: Integrator, resolution: Steps | Tolerances, reference: Reference
) -> list[dict[str, float | None]]:
    """Run from later starts; return the errors of all groups in the norm by which runs are judged.

    A run that does not reach the end has no errors. The list is empty if a start does not exist or
    a run takes long.
    """
    scene, t_end, found = reference.scene, reference.t_end, []
    for part in LATER:
        t = scene.interval[0] + part * (t_end - scene.interval[0])
        z = reference(np.array([t]))
        later = scene.later(t, State(*(z[group][0] for group in ("q", "v", "x"))))
        try:
            run = answers.checked_run(integrator.prepare(later, t_end, resolution))
        except (InconsistentStart, NoConsistentStart):
            return []
        begun = computed_seconds()
        answer = answers.checked_trajectory(run.measure(), scene.sizes, t, t_end)
        if computed_seconds() - begun > _LONGEST:
            return []
        errors = {}
        if measure.checked(answer, t_end).status == "ok":
            tables = relative_errors(answer, reference), constraint_errors(answer, reference)
            errors = {g: norms[NORM] for each in tables for g, norms in each.errors.items()}
        found.append(errors)
    return found
