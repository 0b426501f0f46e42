"""Radau IIA with two stages, order 3; tests use it as a plugin file."""

from dataclasses import dataclass

from integrators import ImplicitStepMethod, Reading
from problems import jnp
from problems.equations.formulations import dae_layout, dae_residual


@dataclass(frozen=True)
class Radau2(ImplicitStepMethod):
    """Radau IIA with two stages on the stabilised index-2 equations."""

    formulation = "stabilised_index2"
    source = "Hairer & Wanner (1996), doi:10.1007/978-3-642-05221-7, sec. IV.5 and VII.4"

    def claims(self, scene):
        algebraic = 2 if scene.sizes.nl else 3
        return {"q": 3, "v": 3, "x": 3} | dict.fromkeys(("a", "lam", "y"), algebraic)

    def begin(self, scene, start, h):
        at, z = dae_layout(scene.sizes, self.formulation), start.z
        mu = jnp.zeros(at.mu.stop - at.mu.start)
        w = jnp.concatenate([z.q, z.v, z.x, z.lam, z.y, mu])
        return w, jnp.zeros_like(w).at[at.v].set(z.a).at[at.x].set(start.xdot)

    def step(self, scene, state, t, h, work):
        w0, _ = state

        def rates(stages):
            one, two = jnp.split(stages - jnp.tile(w0, 2), 2)
            return (1.5 * one + 0.5 * two) / h, (2.5 * two - 4.5 * one) / h

        def residual(stages):
            times, values = (t - 2 * h / 3, t), jnp.split(stages, 2)
            parts = zip(times, values, rates(stages), strict=True)
            return jnp.concatenate([dae_residual(scene, self.formulation, *p) for p in parts])

        stages = work.solve(residual, jnp.tile(w0, 2))
        return jnp.split(stages, 2)[1], rates(stages)[1]

    def read(self, scene, state):
        (w, wdot), at = state, dae_layout(scene.sizes, self.formulation)
        return Reading(w[at.q], w[at.v], wdot[at.v], w[at.lam], w[at.x], wdot[at.x], w[at.y])
