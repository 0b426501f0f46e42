"""Orders of methods, their errors in digits of independent programs, and constraints that hold."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np
import pytest
from helpers import long, run_of
from proofs import (
    SWING,
    TWO_RODS,
    Bent,
    CubicDamper,
    DampedPair,
    Weighed,
    levels,
    orders,
)

from bench.check.trials import ForcedOscillator
from integrators import Integrator, Steps
from integrators.methods import implicit_structural as structural
from integrators.methods import simulator_steppers as steppers
from integrators.methods.ali3p import ALI3P
from integrators.methods.bdf import BDF2
from integrators.methods.energy_momentum import EnergyMomentum
from integrators.methods.explicit_structural import CR, ExplicitGeneralizedAlpha, KRAlpha, NohBathe
from integrators.methods.half_explicit import PHEM56, HalfExplicitEuler
from integrators.methods.hht_i3 import HHTI3
from integrators.methods.radau_iia import RadauIIA
from integrators.methods.rodas5p import Rodas5P
from integrators.methods.symplectic import RATTLE, SHAKE, LobattoPair, VariationalMidpoint
from problems import MechatronicSystem
from problems.scenes.heavy_top import HeavyTop, HeavyTopR3SO3
from problems.scenes.oscillators import SpringMass
from problems.scenes.pendulums import Chain, DoublePendulum, DoublePendulumControlled
from problems.scenes.rolling import ChaplyginSleigh
from problems.scenes.slider_crank import SliderCrank, SliderCrankMinimal

FORMULATIONS = "index3", "index2", "stabilised_index2"
#: Levels of the constraints that a formulation keeps to rounding.
HELD = {"index3": "q", "index2": "v", "stabilised_index2": "qv"}


@dataclass(frozen=True)
class Case:
    """So many steps, and half of them, on one second; if none is given, orders are the claimed."""

    method: Integrator
    steps: int = 400
    on: tuple[MechatronicSystem, float] = SWING
    pattern: tuple[float, ...] = (1.0,)
    #: Orders at the end and of the largest errors, and how far others may be off.
    at_end: dict[str, float] = field(default_factory=dict)
    largest: dict[str, float] = field(default_factory=dict)
    within: float = 0.1
    #: Orders at the end, and of the largest errors, are higher than these; either those or the
    #: others are as high as claimed.
    above: dict[str, float] = field(default_factory=dict)
    above_largest: dict[str, float] = field(default_factory=dict)
    least: bool = False
    #: Errors with the finer steps at the end, the largest of lam, and how far others may be off.
    errors: dict[str, float] = field(default_factory=dict)
    largest_of_lam: float | None = None
    digits: float = 0.02
    #: Of the errors: Euclidean, or the largest entry.
    norm: Callable[[np.ndarray], np.floating] = np.linalg.norm
    #: Levels of the constraints that hold, if others than those of the formulation.
    held: str | None = None

    def __str__(self) -> str:
        return f"{self.method.spec}-{self.on[0].name}"


def same(groups: str, order: float) -> dict[str, float]:
    return dict.fromkeys(groups.split(), order)


def composite(method: type, formulation: str, lam: float) -> Case:
    of = method(formulation=formulation)
    return Case(of, largest=SECOND, within=0.05, errors={"lam": lam})


def radau(stages: int, formulation: str, errors: tuple[float, ...], lam: float) -> Case:
    of = RadauIIA(stages=stages, formulation=formulation, steps="constant")
    steps, named = 400 if stages == 2 else 80, dict(zip(("q", "v", "lam"), errors, strict=True))
    # Index 3 is what loses orders; it must show.
    largest = of.claims(SWING[0]) if formulation == "index3" else {}
    return Case(
        of, steps, least=True, largest=largest, within=0.2,
        errors=named, largest_of_lam=lam, digits=5e-3, norm=np.max,
    )  # fmt: skip


SECOND, LOST = same("q v a lam", 2), {"q": 2, "v": 2, "a": 1, "lam": 1}
OF_BDF2 = {"at_end": same("q v lam", 2), "largest": {"lam": 1}, "within": 0.12}
OF_HHT = {"at_end": same("q v lam", 2) | {"a": 1}, "largest": {"lam": 1}, "held": ""}
OF_PHEM = {"within": 0.3, "held": ""}
PHEM, ROSENBROCK = PHEM56(steps="constant"), Rodas5P(steps="constant")
COMPOSITES = structural.Bathe, structural.TRBDF2, structural.RhoInfBathe
EULERS = steppers.SemiImplicitEuler(), steppers.ImplicitFast(), steppers.LinearlyImplicitEuler()
FORCED, CONTROLLED = (ForcedOscillator(), 7.0), (DoublePendulumControlled(), 1.0)
CRANK, UNEVEN = (SliderCrankMinimal(), 1.0), (0.3, 0.7)
SHORT = [
    Case(BDF2(), **OF_BDF2),
    composite(structural.Bathe, "stabilised_index2", 5.4e-4),
    Case(ROSENBROCK, 160, largest=ROSENBROCK.claims(SWING[0]), within=0.5, held=""),
    radau(2, "stabilised_index2", (2.81e-7, 4.93e-7, 1.86e-4), 3.99e-4),
    Case(PHEM, 80, errors={"q": 2.65e-9, "v": 4.68e-9, "lam": 3.76e-7}, digits=5e-3,
         norm=np.max, **OF_PHEM),
    # An average of both sides holds its order in patterns of steps.
    Case(RATTLE(), 200, pattern=UNEVEN, largest={"lam": 2}, held="qv"),
]  # fmt: skip
MORE = [
    Case(LobattoPair(), 80, errors={"q": 8.33e-9}, largest_of_lam=7.5e-3, digits=0.05, held="qv"),
    # An independent program in NumPy gave the errors of these two.
    Case(HHTI3(alpha=-0.2, steps="constant"), errors={"q": 5.75e-5, "lam": 1.8e-3},
         largest_of_lam=0.11, digits=0.03, **OF_HHT),
    Case(EnergyMomentum(), at_end=LOST, within=0.05, largest_of_lam=0.135,
         errors={"q": 1.19e-5, "v": 7.07e-5, "lam": 2.6e-2}),
    Case(HalfExplicitEuler(), at_end=same("q v a lam", 1), held="v"),
    Case(structural.Park(), at_end=SECOND, largest={"lam": 1}, within=0.12),
    *(Case(BDF2(formulation=f), **OF_BDF2) for f in FORMULATIONS[1:]),
    *(Case(BDF2(formulation=f), on=TWO_RODS, above=same("q v lam", 1.8)) for f in FORMULATIONS),
    *(
        Case(method, largest=method.claims(on[0]), on=on, held=held)
        for on in (SWING, TWO_RODS)
        for method, held in ((RATTLE(), "qv"), (SHAKE(), ""), (VariationalMidpoint(), "qv"))
    ),
    *(Case(LobattoPair(values="equations"), 80, on, held="qv") for on in (SWING, TWO_RODS)),
    composite(structural.Bathe, "index2", 5.1e-4),
    composite(structural.TRBDF2, "stabilised_index2", 5.0e-4),
    composite(structural.RhoInfBathe, "stabilised_index2", 3.9e-4),
    composite(structural.RhoInfBathe, "index2", 3.7e-4),
    Case(structural.Bathe(values="equations"), 200, at_end={"lam": 2}),
    *(
        Case(method(formulation=f), on=TWO_RODS, within=0.12)
        for method, f in product(COMPOSITES, FORMULATIONS)
    ),
    *(Case(ALI3P(), on=on, at_end=SECOND, largest=SECOND, held="qv") for on in (SWING, TWO_RODS)),
    Case(HHTI3(alpha=-0.3, steps="constant"), errors={"q": 6e-5, "lam": 1.9e-3},
         largest_of_lam=0.11, digits=0.03, **OF_HHT),
    Case(HHTI3(steps="constant"), on=TWO_RODS, above=same("q v lam", 1.8)),
    Case(HHTI3(steps="constant", values="equations"), on=TWO_RODS, above=same("q v a lam", 1.8)),
    Case(HHTI3(steps="constant"), on=(SpringMass(), 1.0), above=same("q v x y", 1.9)),
    Case(EnergyMomentum(values="equations"), at_end=SECOND, within=0.05),
    Case(EnergyMomentum(formulation="stabilised_index2"), at_end=LOST, within=0.05),
    *(
        Case(method, 160, on, largest=method.claims(on[0]), within=0.5, held="")
        for f, values, on in product(("index1", "index2"), ("own", "equations"), (SWING, TWO_RODS))
        for method in [replace(ROSENBROCK, formulation=f, values=values)]
    ),
    # A controller with acceleration feedback.
    *(
        Case(replace(ROSENBROCK, formulation=f), 640, CONTROLLED, largest=same("q v x y", order))
        for f, order in (("index1", 5), ("index2", 3))
    ),
    # The force of "filter" follows a by a state, that of the bent one follows a and lam at once.
    *(Case(ALI3P(), n, on, largest=ALI3P().claims(on[0]), within=0.03)
      for on, n in ((CONTROLLED, 400), ((Bent(), 1.0), 100))),
    *(Case(ALI3P(), n, (scene, 0.2), largest=SECOND, within=0.15)
      for scene, n in ((ChaplyginSleigh(), 100), (HeavyTopR3SO3(), 1000))),
    *(Case(of, n, (Bent(), 1.0), largest=of.claims(Bent()), within=0.2)
      for (stages, n), f in product(((2, 80), (3, 20)), FORMULATIONS)
      for of in [RadauIIA(stages=stages, formulation=f, steps="constant")]),
    *(Case(RadauIIA(formulation=f, steps="constant"), 40, TWO_RODS, UNEVEN, {"q": 5}, within=0.3)
      for f in FORMULATIONS),
    # An output that sees the multiplier of index 3 is of first order.
    *(Case(m(), on=(Weighed(), 1.35), at_end={"y": 1}) for m in COMPOSITES),
    # Forces of both ends cost an order where the mass varies, accelerations none.
    Case(HHTI3(steps="constant"), on=CRANK, above={"q": 1.9}),
    Case(HHTI3(steps="constant", mixed="forces"), on=CRANK, at_end={"q": 1.25}, within=0.35),
    *(Case(EnergyMomentum(formulation=f), on=(Chain(links=2), 1.0),
           above={"q": 1.9, "v": 1.9, "lam": 0.9, "a": 0.9}) for f in FORMULATIONS[::2]),
    Case(PHEM, 20, (SpringMass(), 5.0), above=same("q v a x y", 4.7)),
    # Free systems: from the first step on, also in patterns.
    *(Case(m, 80, FORCED, above_largest=same("q v a", 1.9))
      for m in (structural.Houbolt(), structural.Park(),
                *(structural.WilsonTheta(**of) for of in ({}, {"theta": 2.0})))),
    *(Case(m, 40, FORCED, pattern, above_largest={"q": 1.8})
      for m, pattern in product((structural.Houbolt(), structural.Park()), (UNEVEN, (0.6, 0.4)))),
    *(Case(m(), n, on, above_largest=same("q v a x y", 1.9))
      for m, (on, n) in product((ExplicitGeneralizedAlpha, NohBathe),
                                ((FORCED, 160), ((SpringMass(), 1.0), 800)))),
    *(Case(m, 320, FORCED, largest=m.claims(FORCED[0]), within=0.15)
      for m in (*(of(start=s) for of in (KRAlpha, CR) for s in ("published", "corrected")),
                KRAlpha(start="corrected", values="equations"))),
    # Damping that changes costs an order.
    Case(KRAlpha(start="corrected"), 4000, (SliderCrankMinimal(), 0.2), largest={"q": 1}),
    Case(CR(start="corrected"), 800, (CubicDamper(), 1.0), at_end={"q": 1}),
    radau(2, "index3", (2.27e-7, 3.20e-5, 7.83e-2), 0.135),
    radau(2, "index2", (2.31e-7, 4.26e-7, 1.86e-4), 4.00e-4),
    radau(3, "stabilised_index2", (3.75e-9, 6.58e-9, 1.43e-5), 1.36e-4),
    radau(3, "index3", (5.68e-9, 6.40e-6, 3.05e-3), 1.36e-2),
    radau(3, "index2", (2.96e-9, 5.36e-9, 1.42e-5), 1.35e-4),
    *(
        Case(RadauIIA(stages=stages, formulation=f, steps="constant"), steps, TWO_RODS, least=True)
        for (stages, steps), f in product(((2, 200), (3, 80)), FORMULATIONS)
    ),
    *(Case(method, within=0.15, held="") for method in EULERS),
    *(Case(method, 3200, TWO_RODS, above=same("q v a lam", 0.85)) for method in EULERS),
    *(Case(m, 1600, (SpringMass(), 1.0), above=same("q v a x y", 0.9)) for m in EULERS),
    *(
        Case(method(formulation=f), at_end=SECOND, largest={"lam": 2}, within=0.12)
        for method, f in product((structural.Houbolt, structural.Park), FORMULATIONS)
        if (method, f) != (structural.Park, "index3")
    ),
    *(
        Case(method(formulation=f), on=TWO_RODS, above=same("q v a lam", 1.9))
        for method, f in product((structural.Houbolt, structural.Park), FORMULATIONS)
    ),
    Case(HalfExplicitEuler(), on=TWO_RODS, at_end=same("q v a lam", 1)),
    *(Case(replace(PHEM, values="equations"), 80, on, **OF_PHEM) for on in (SWING, TWO_RODS)),
]  # fmt: skip


@pytest.mark.parametrize("cases", [(*SHORT,), *long([*MORE])])
def test_orders_and_errors_are_those_claimed_and_constraints_hold(cases):
    for case in cases:
        method, (scene, t_end) = case.method, case.on
        found = orders(method, case.steps, case.on, case.pattern)
        stated = case.at_end or case.largest or case.above or case.above_largest or case.least
        claims = method.claims(scene)
        for group, got in found.items():
            for order, equal, above in (
                (got.order_at_end, case.at_end if stated else claims, case.above),
                (got.order_of_largest, case.largest, case.above_largest),
            ):
                if group in equal:
                    assert order == pytest.approx(equal[group], abs=case.within), group
                assert group not in above or order > above[group], group
            if case.least and group in claims:
                assert max(got.order_at_end, got.order_of_largest) > claims[group] - 0.12, group
        if case.errors:
            end, exact = method.prepare(scene, t_end, Steps(1 / case.steps)).measure(), scene.exact
            for group, error in case.errors.items():
                gap = abs(getattr(end, group) - exact(end.t)[group])[-1]
                assert case.norm(gap) == pytest.approx(error, rel=case.digits), group
        if case.largest_of_lam:
            assert found["lam"].largest == pytest.approx(
                case.largest_of_lam, rel=max(case.digits, 0.03)
            )
        held = HELD.get(method.formulation, "") if case.held is None else case.held
        if held and case.on is SWING:
            positions, velocities = levels(method.prepare(scene, t_end, Steps(0.01)).measure())
            assert (positions < 1e-14, velocities < 1e-13) == ("q" in held, "v" in held)


def test_claims_fall_where_theory_says_so():
    forces = HHTI3(steps="constant", mixed="forces")
    for method, scene, claims in [
        (forces, SliderCrankMinimal(), {"q": 1}),
        (forces, HeavyTop(), {"q": 1}),
        (forces, SWING[0], {"q": 2}),
        (HHTI3(steps="constant"), SliderCrankMinimal(), {"q": 2}),
        (HHTI3(steps="constant"), HeavyTop(), {"q": 2}),
        (KRAlpha(start="corrected"), SliderCrankMinimal(), same("q v a", 1)),
        (CR(start="corrected"), DampedPair(), same("q v a", 2)),
        (CR(start="corrected"), CubicDamper(), {"q": 1}),
        (structural.TRBDF2(), Weighed(), {"y": 1}),
        (structural.TRBDF2(), CONTROLLED[0], {"y": 2}),  # its output sees a state alone
        (ALI3P(), Bent(), same("q v a lam x y", 2)),
    ]:
        assert {group: method.claims(scene)[group] for group in claims} == claims, method.spec


MODIFIED, SPARSE = {"newton": "modified"}, {"linear_solver": "sparse"}
STIFF = RadauIIA(formulation="stabilised_index2", steps="constant")


@pytest.mark.long
@pytest.mark.parametrize(
    ("method", "others", "scene", "t_end", "h"),
    [
        (structural.Bathe(), (MODIFIED, MODIFIED | SPARSE), DoublePendulum(), 0.5, 0.01),
        (STIFF, (SPARSE,), SliderCrank(), 0.1, 0.005),
        (replace(STIFF, newton="modified"), (SPARSE,), SliderCrank(), 0.1, 0.005),
        (steppers.LinearlyImplicitEuler(), (SPARSE,), Chain(), 0.1, 0.005),
        (ROSENBROCK, (SPARSE,), DoublePendulum(), 1.0, 0.05),
        (RATTLE(), (MODIFIED, SPARSE), Chain(), 0.1, Chain().nominal_step),
    ],
    ids=str,
)
def test_tangents_that_are_kept_or_sparse_change_nothing(method, others, scene, t_end, h):
    one = method.prepare(scene, t_end, Steps(h)).measure()
    for options in others:
        two = run_of(replace(method, **options), scene, Steps(h), t_end)
        assert two.q == pytest.approx(one.q, abs=1e-11)
        assert two.lam == pytest.approx(one.lam, rel=1e-7, abs=1e-7)
