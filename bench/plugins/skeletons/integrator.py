"""A time integrator for stepbench: change it, and check it with `stepbench check`."""

from dataclasses import dataclass
from typing import ClassVar

from integrators import Reading, StepMethod, option
from problems.equations.formulations import complete


@dataclass(frozen=True)
class NewIntegrator(StepMethod):
    """Two-stage explicit Runge-Kutta of order two, on the ODE form of any scene."""

    family = "NewIntegrator"  # methods of one family share a colour in the report
    formulation = "ode"
    # Claimed orders, which `stepbench check` measures; leave out groups without a claim.
    orders: ClassVar = {"q": 2, "v": 2, "a": 2, "lam": 2, "x": 2, "y": 2}
    source = ""  # where it is published, with its DOI

    place: float = option(0.5, "place of the inner stage: 1/2 midpoint, 1 Heun", low=0.1, high=1.0)

    def supports(self, scene):
        return None  # or the reason, in a sentence, why it cannot take the scene

    def begin(self, scene, start, h):
        z = start.z  # consistent values at the start, with a, lam and y
        return Reading(z.q, z.v, z.a, z.lam, z.x, start.xdot, z.y)

    def step(self, scene, state, t, h, work):
        # Float options such as self.place are traced: other values compile nothing new.
        s, c = state, self.place
        weight = 1 / (2 * c)  # of the inner stage
        # The state s belongs to t - h; `complete` solves for a, lam, y and xdot at q, v, x.
        v = s.v + c * h * s.a
        z, xdot = complete(scene, s.q + c * h * s.v, v, s.x + c * h * s.xdot, t - h + c * h)
        end, xdot = complete(
            scene,
            s.q + h * ((1 - weight) * s.v + weight * v),
            s.v + h * ((1 - weight) * s.a + weight * z.a),
            s.x + h * ((1 - weight) * s.xdot + weight * xdot),
            t,
        )
        work.count(residuals=2)  # work is counted where it happens
        return Reading(end.q, end.v, end.a, end.lam, end.x, xdot, end.y)

    def read(self, scene, state):
        return state  # the variables in a state, as they are reported
