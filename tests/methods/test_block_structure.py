"""Facts of scenes and methods: dependence of blocks, work in a step, options, refusals."""

import numpy as np
import pytest
from helpers import long, toy
from proofs import SWING, TWO_RODS

from bench.check.trials import ForcedOscillator
from bench.plugins.registry import Registry
from integrators import Steps
from integrators.methods import simulator_steppers as steppers
from integrators.methods.explicit_structural import CR, ExplicitGeneralizedAlpha, KRAlpha, NohBathe
from integrators.methods.half_explicit import PHEM56, HalfExplicitEuler
from integrators.methods.implicit_structural import WilsonTheta
from integrators.methods.rodas5p import Rodas5P
from integrators.methods.symplectic import StormerVerlet
from problems import jax, jnp
from problems.base.spec import SpecError
from problems.equations.programs import (
    damping_varies,
    force_takes_velocities,
    mass_varies,
    output_takes,
    states_follow_accelerations,
)
from problems.scenes.oscillators import SpringMass
from problems.scenes.pendulums import Pendulum

REGISTRY = Registry()


#: Two masses on springs with dampers, and an output of the positions.
BLOCKS = {
    "mass": lambda self, q: jnp.diag(
        jnp.where(jnp.array([True, False]), 2.0, jnp.cos(0.0 * jnp.ones(2)))
    ),
    "force": lambda self, q, v, t: (
        jnp.sin(t) - jax.jit(lambda q, v: q**3 + jnp.array([1.0, 2.0]) * v)(q, v)
    ),
    "output": lambda self, z: z.q[:1] + z.x,
    "state_rate": lambda self, z: z.a[:1],
    "actuation": lambda self: np.ones((2, 1)),
}
#: All depends on differences, which no common shift of the variables changes.
COUPLED = BLOCKS | {
    "mass": lambda self, q: jnp.eye(2) * (2 + jnp.cos(q[0] - q[1])),
    "force": lambda self, q, v, t: (v[0] - v[1]) ** 3 * jnp.array([-1.0, 1.0]) - q,
    "output": lambda self, z: (z.a[0] - z.a[1] + z.y[0])[None],
}
UNDAMPED = BLOCKS | {"force": lambda self, q, v, t: jnp.sin(t) - q**3}
DRIFTING_DAMPER = BLOCKS | {"force": lambda self, q, v, t: -q - jnp.exp(-t) * v}
#: The controller state follows its own value and the output.
FOLLOWS = {"state_rate": lambda self, z: z.y - z.x}


def stating(blocks):
    return toy("Blocks", q=[1.0, 1.0], x=[0.0], **blocks)()


def test_a_dependence_is_found_in_the_program_not_in_values():
    for scene, velocities, damping, mass, seen in [
        (stating(BLOCKS), True, False, False, "qx"),
        (stating(COUPLED), True, True, True, "ay"),
        (stating(UNDAMPED), False, False, False, "qx"),
        (stating(DRIFTING_DAMPER), True, True, False, "qx"),
    ]:
        assert force_takes_velocities(scene) == velocities
        assert damping_varies(scene) == damping
        assert mass_varies(scene) == mass
        groups = ("q", "v", "a", "lam", "x", "y", "t")
        assert [group for group in groups if output_takes(scene, group)] == list(seen)
        assert output_takes(scene, "lam", seen[0])
    for blocks, follows in [(BLOCKS, True), (UNDAMPED | FOLLOWS, False), (COUPLED | FOLLOWS, True)]:
        assert states_follow_accelerations(stating(blocks)) == follows


# ---- work --------------------------------------------------------------------------------
#: Their outputs see q and v alone, or the acceleration, too.
Held, HeldByAcceleration = (
    toy("Held", base=ForcedOscillator, actuation=lambda self: np.ones((1, 1)), output=output)
    for output in (lambda self, z: -z.q - 0.2 * z.v, lambda self, z: -z.q - 0.1 * z.a)
)
FREE, NONE = (ForcedOscillator(), 7.0), dict.fromkeys(("newton", "factorisations", "solves"), 0)
ONCE = {"newton": 0} | dict.fromkeys(("residuals", "jacobians", "factorisations", "solves"), 1)


@pytest.mark.parametrize(
    ("method", "on", "each"),
    [
        # The equations of motion are solved for a within an evaluation, as in any ODE.
        (ExplicitGeneralizedAlpha(), FREE, NONE | {"residuals": 1}),
        (NohBathe(), FREE, NONE | {"residuals": 2}),
        (StormerVerlet(), FREE, {"residuals": 1, "solves": 1}),
        (steppers.SemiImplicitEuler(), SWING, ONCE),
        *long(
            *((m(), SWING, ONCE) for m in (steppers.ImplicitFast, steppers.LinearlyImplicitEuler)),
            (PHEM56(steps="constant"), SWING, {"residuals": 6, "solves": 6}),
            # Outputs are iterated only where they depend on what a stage solves for.
            (HalfExplicitEuler(), (Held(), 3.0), {"newton": 0, "residuals": 1, "solves": 1}),
            (HalfExplicitEuler(), (HeldByAcceleration(), 3.0), None),
            *(
                (Rodas5P(steps="constant", linear_solver=solver), TWO_RODS,
                 {"factorisations": 1, "jacobians": 1, "solves": 8, "residuals": 8})
                for solver in ("dense", "sparse")
            ),
        ),
    ],
)  # fmt: skip
def test_the_work_of_all_steps_is_the_same_and_there_is_no_iteration(method, on, each):
    work = method.prepare(*on, Steps(0.1)).measure().work
    assert each or work.newton == work.residuals >= work.steps
    for name, count in (each or {}).items():
        assert getattr(work, name) == count * work.steps, name


# ---- options and refusals ----------------------------------------------------------------
def test_an_option_without_effect_is_refused_with_what_it_needs():
    for spec, said in [
        ("rodas5p[alpha=5]", "alpha=5.0 decides nothing without constraints=baumgarte"),
        ("dopri8[constraints=projected,beta=5]", "beta=5.0 decides nothing without constraints="),
        ("hht_i3[steps=constant,control=chrono]", "control=chrono decides nothing without steps="),
        ("phem56[steps=constant,max_steps=5]", "max_steps=5 decides nothing without steps="),
        ("rattle[multiplier=one_sided,values=equations]", "one_sided decides nothing without val"),
    ]:
        with pytest.raises(SpecError, match=said):
            REGISTRY.integrator(spec)
    assert REGISTRY.integrator("rodas5p[alpha=20,beta=20,max_steps=1000000]").spec == "rodas5p"
    for spec in (
        "rodas5p[constraints=baumgarte,alpha=5.0]",
        "hht_i3[alpha=-0.2,control=chrono]",
        "radau_iia[formulation=index3,stages=3,max_steps=7]",
        "variational_midpoint[multiplier=one_sided]",
    ):
        assert REGISTRY.integrator(spec).spec.count(",") == spec.count(",")
    constant = REGISTRY.integrator("radau_iia[max_steps=7]").at_constant_steps()
    assert constant is not None  # it forgets what chose its steps
    assert constant.spec == REGISTRY.integrator("radau_iia[steps=constant]").spec


def test_what_methods_cannot_take_is_refused_with_a_reason():
    for method in (ExplicitGeneralizedAlpha(), NohBathe(), KRAlpha(), CR()):
        assert "constraints" in method.supports(Pendulum())
    assert "controller" in KRAlpha().supports(SpringMass())
    assert "houbolt" in WilsonTheta().supports(Pendulum())
    refused = Rodas5P(formulation="index2", constraints="baumgarte")
    assert "constraints=projected" in refused.supports(Pendulum())
    assert refused.supports(ForcedOscillator()) is None
    with pytest.raises(SpecError, match=r"does not take pendulum: .*constraints"):
        KRAlpha().prepare(Pendulum(), 1.0, Steps(0.01))
