"""CVODE of SUNDIALS: variable-order multistep methods on the explicit ODE."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from integrators.adapters.equations import given_ode
from integrators.adapters.library_runs import ODESolver
from integrators.adapters.sundials import SundialsRun
from integrators.contract import PreparedRun, option
from integrators.program_costs import dense
from integrators.resolutions import Tolerances
from problems.system import MechatronicSystem

#: The highest orders of CVODE's formulas.
_HIGHEST = {"bdf": 5, "adams": 12}


@dataclass(frozen=True)
class CVODE(ODESolver):
    """BDF of order 1 to 5, or Adams-Moulton of order 1 to 12, with adaptive steps on the ODE.

    CVODE takes neither a mass matrix nor a constraint, so that a scene is taken in its ODE form:
    accelerations and multipliers are solved from the index-1 equations in every evaluation of the
    right-hand side. The Jacobian is exact (automatic differentiation); CVODE keeps it over several
    factorisations. Reported q, v and x are the solver's own, at the ends of its own steps; a, lam,
    y and xdot solve the equations of motion there. A projection of every step is not offered.

    CVODE calls equations in C, which are made of the scene's traced equations, or through Python.
    ``residuals`` are evaluations of the right-hand side, counted there; a run that uses up
    ``max_calls`` of them ends with status budget_exceeded, and a value that is not finite ends it
    as diverged.
    """

    family: ClassVar[str] = "cvode"
    source: ClassVar[str] = "Hindmarsh et al. (2005), SUNDIALS, doi:10.1145/1089014.1089020"

    method: str = option(
        "bdf",
        "formulas: bdf, backward differences, for stiff equations; adams, of Adams and Moulton",
        choices=("bdf", "adams"),
    )

    def prepare(
        self, scene: MechatronicSystem, t_end: float, resolution: Tolerances
    ) -> PreparedRun:
        given = given_ode(scene, self.baumgarte(scene))
        options = {
            "method": self.method,
            "max_order": _HIGHEST[self.method],
            "rtol": resolution.rtol,
            "atol": np.full(given.size, resolution.atol),
        }
        return SundialsRun(self, given, t_end, dense(given.size), options)
