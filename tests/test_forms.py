"""The form in which a method solves constraints: known of all methods of the project, and told."""

from __future__ import annotations

from functools import cache

import pytest
from helpers import reference
from planted import planted

from bench.plugins.registry import Registry
from bench.running.errors import constraint_errors
from bench.running.inventory import Inventory, SceneFacts
from bench.running.plan import Cell
from integrators import Steps, Tolerances
from problems.scenes.pendulums import Pendulum
from reports.names import form_name

#: Methods with their options at the defaults, and changed.
FORMS = {
    "generalized_alpha[rho_inf=0.8]": "index 3",
    "generalized_alpha[rho_inf=0.8,formulation=stabilised_index2]": "GGL",
    "ida": "GGL",
    "ida[formulation=index1]": "index 1",
    "bdf2[formulation=index2]": "index 2",
    "ali3p": "index 3, projected",
    "phem56": "index 2, unprojected",
    "half_explicit_euler": "index 2, unprojected",
    "implicit_fast[erp=0.2]": "index 2, Baumgarte",
    "implicit_fast[erp=0]": "index 2, unprojected",
    "kvaerno5": "index 1, unprojected",
    "dopri8[constraints=projected]": "index 1, projected",
    "cvode[constraints=baumgarte]": "index 1, Baumgarte",
    "rodas5p": "index 1, unprojected",
    "rodas5p[formulation=index2,constraints=projected]": "index 2, projected",
    "mujoco[integrator=rk4]": "minimal coordinates, soft loops",
}


@cache
def inventory() -> Inventory:
    return Inventory()


def formulation(text: str, constrained: bool = True) -> str:
    """The formulation of a record of this method, as a run gets it."""
    scene = SceneFacts(
        spec="s", name="s", interval=(0.0, 1.0), nominal_step=0.1, constrained=constrained,
        fingerprint="",
    )  # fmt: skip
    return (
        Cell("s", text, 1.0, Steps(0.1))
        .record(scene, inventory().integrator(text), "ok")
        .formulation
    )


def form(text: str, **changes) -> str:
    known = {"formulation": text, "constraint": {"position": 1e-9}} | changes
    return form_name([None, planted("s", "m", {}, h=0.1, **known)])


def test_the_form_of_a_method_follows_from_its_options():
    for text, named in FORMS.items():
        assert form(formulation(text)) == named


def test_every_method_of_the_project_has_a_form():
    unnamed = {name for name in inventory().integrators if not form(formulation(name))}
    assert not unnamed


def test_a_form_is_told_of_constrained_scenes_and_stated_forms_alone():
    assert (formulation("ida", constrained=False), formulation("kvaerno5", constrained=False)) == (
        "unconstrained", "ode",
    )  # fmt: skip
    assert form("index3", constraint={}) == ""
    assert form("a formulation of my own") == form("") == ""
    # Stores of earlier versions do not tell whether a method on the ODE form projects.
    assert form("ode") == "index 1"


@pytest.mark.long
@pytest.mark.parametrize(
    ("text", "resolution"),
    [
        ("phem56", Tolerances(1e-4, 1e-6)),
        *((f"rodas5p[constraints={c}]", Tolerances(1e-4, 1e-6)) for c in ("index1", "projected")),
        *((f"radau_iia[formulation={f}]", Tolerances(1e-4, 1e-6)) for f in ("index3", "index2")),
        ("kvaerno5", Tolerances(1e-4, 1e-6)),
        ("ali3p", Steps(0.02)),
        ("generalized_alpha[rho_inf=0.8,formulation=stabilised_index2]", Steps(0.02)),
    ],
)
def test_runs_hold_the_constraints_that_their_form_says(text, resolution):
    """Positions are held by index 3, GGL and projections, and drift with all others."""
    known = reference(Pendulum(), 1.35)
    run = Registry().integrator(text).prepare(Pendulum(), 1.35, resolution).measure()
    violation = constraint_errors(run, known).errors["constraint"]["max"]
    name = form(formulation(text))
    holds = name in ("index 3", "GGL") or name.endswith(" projected")
    assert violation < 1e-9 if holds else 1e-8 < violation < 1e-2
