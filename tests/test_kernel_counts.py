"""Properties of compiled programs that make small scenes fast, independent of the machine's load.

The time loop of a small scene is one compiled function: XLA splits no loop in it into pieces, no
loop calls a library, and other numbers compile nothing new. ``make bench`` measures the times.
"""

from __future__ import annotations

import re
from collections import Counter

import jax
import pytest
from helpers import forget_programs, long

from integrators import Steps, Tolerances
from integrators.adapters.counting import run_counted, watch
from integrators.methods.generalized_alpha import GeneralizedAlpha
from integrators.methods.generalized_alpha_adaptive import GeneralizedAlphaAdaptive
from integrators.methods.half_explicit import PHEM56, HalfExplicitEuler
from integrators.methods.radau_iia import RadauIIA
from integrators.native.algebra import small_matrices
from problems import jnp
from problems.scenes.heavy_top import HeavyTop
from problems.scenes.pendulums import Chain, Pendulum
from problems.scenes.quarter_car import QuarterCar
from problems.scenes.slider_crank import SliderCrank


class Program:
    """The optimised program of a prepared run, as XLA prints it."""

    def __init__(self, run) -> None:
        arguments = run.end_only
        lowered = run.kernel.run.lower(run.arguments, *arguments)
        self.lines: dict[str, list[str]] = {}
        for line in lowered.compile().as_text().splitlines():
            head = re.match(r"(ENTRY )?%([\w.\-]+) \(.*\{$", line)
            if head:
                name = "ENTRY" if head[1] else head[2]
                self.lines[name] = []
            elif line.startswith("  "):
                self.lines[name].append(line)

    def operations(self, name: str) -> Counter:
        found = (re.search(r"= .*? ([a-z][a-z\-]*)\(", line) for line in self.lines[name])
        return Counter(match[1] for match in found if match)

    def loops(self) -> list[Counter]:
        """Operations in the body of each loop, innermost loops first."""
        bodies = [
            re.search(r"body=%([\w.\-]+)", line)[1]
            for lines in self.lines.values()
            for line in lines
            if " while(" in line
        ]
        return [self.operations(name) for name in bodies]

    def joined(self) -> bool:
        """Whether every loop is within one function, and no loop calls a library."""
        run_by_pieces = self.operations("ENTRY")["while"]
        libraries = sum(body["custom-call"] for body in self.loops())
        custom = any("kind=kCustom" in line for lines in self.lines.values() for line in lines)
        return not (run_by_pieces or libraries or custom)


def prepared(scene, method="full", steps=400):
    if isinstance(method, str):
        method = GeneralizedAlpha(newton=method)
    t0, t_end = scene.interval
    at = Steps((t_end - t0) / steps) if method.controls == "step" else Tolerances(1e-4)
    return method.prepare(scene, t_end, at)


@pytest.mark.parametrize(
    ("scene", "method"),
    [
        (SliderCrank(), "full"),
        (Pendulum(), GeneralizedAlphaAdaptive(newton="modified")),
        *long(
            *((scene, "full") for scene in (QuarterCar(), Chain(), HeavyTop())),
            *((s, "modified") for s in (SliderCrank(), QuarterCar(), Chain(), HeavyTop())),
            *((SliderCrank(), method) for method in (HalfExplicitEuler(), PHEM56())),
        ),
    ],
    ids=lambda of: getattr(of, "name", of),
)
def test_the_march_of_a_small_scene_is_one_function(scene, method):
    assert Program(prepared(scene, method)).joined()


@pytest.mark.long
@pytest.mark.skipif(
    jax.__version_info__ < (0, 10, 1), reason="Before, XLA joined loops with such products, too."
)
def test_a_product_that_is_left_to_a_library_takes_it_apart(monkeypatch):
    assert Program(prepared(QuarterCar(), RadauIIA())).joined()
    monkeypatch.setattr(small_matrices, "without_products", lambda function: function)
    forget_programs()
    try:
        assert not Program(prepared(QuarterCar(), RadauIIA())).joined()
    finally:
        forget_programs()


def test_a_tangent_is_kept_over_many_steps_and_full_newton_takes_two_iterations_in_each():
    run = prepared(SliderCrank(), "modified", steps=20_000).measure()
    work = run.work
    assert run.status == "ok"
    assert work.factorisations == work.jacobians < 0.03 * work.steps
    assert work.residuals == work.newton == work.solves < 2.7 * work.steps
    work = prepared(SliderCrank(), steps=20_000).measure().work
    assert work.residuals == work.newton == work.jacobians == work.factorisations
    assert 1.9 * work.steps < work.residuals <= 2 * work.steps


class Watched(Pendulum):
    """A pendulum whose force is counted where it is evaluated and linearised."""

    def force(self, q, v, t):
        force = watch(lambda t, s, p: p * jnp.array([0.0, -1.0]) + 0.0 * s)
        return force(t, v, self.m * self.g)


@pytest.mark.parametrize("newton", ["modified", *long("full")])
def test_what_is_counted_is_what_was_done(newton):
    run = prepared(Watched(), newton, steps=50)
    work = run.measure().work
    _, counts = run_counted(run.execute)
    # Full Newton has the residual from the linearisation.
    assert counts == (work.residuals if newton == "modified" else 0, work.jacobians)
