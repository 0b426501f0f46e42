"""The time loop of a small scene is one compiled function, and counts in programs are exact."""

import re
from collections import Counter
from concurrent.futures import ThreadPoolExecutor

import jax
import pytest
from helpers import forget_programs, long

from integrators import Steps, Tolerances
from integrators.adapters.counting import Counts, run_counted, watch
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
        (Pendulum(), "full"),
        (Pendulum(), GeneralizedAlphaAdaptive(newton="modified")),
        *long(
            *((scene, "full") for scene in (SliderCrank(), QuarterCar(), Chain(), HeavyTop())),
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


# ---- counting in compiled programs -------------------------------------------------------
def evaluations(times: int):
    """A compiled program that evaluates a watched function so often, and drops the values."""
    watched = watch(lambda t, s, p: s)

    def once(_, s):
        watched(0.0, 1.0, None)
        return s

    return jax.jit(lambda: jax.lax.fori_loop(0, times, once, 1.0))


def test_neither_loops_nor_equal_calls_nor_unused_results_escape():
    watched = watch(lambda t, s, p: p * s)

    def once(_, s):
        watched(0.0, 1.0, 2.0)  # equal in each turn
        watched(0.0, 1.0, 2.0)  # equal to the one before
        return watched(0.0, s, 2.0)

    program = jax.jit(lambda turns: jax.lax.fori_loop(0, turns, once, 1.0))
    assert run_counted(program, 5) == (2.0**5, Counts(15, 0))
    assert run_counted(program, 3) == (2.0**3, Counts(9, 0))


def test_a_linearisation_counts_once_however_many_directions_follow():
    watched = watch(lambda t, s, p: s**2)
    program = jax.jit(jax.jacfwd(lambda s: watched(0.0, s, None)))
    jacobian, counts = run_counted(program, jnp.arange(3.0))
    assert jnp.diag(jacobian).tolist() == [0.0, 2.0, 4.0]
    assert counts == Counts(0, 1)


def test_the_branch_that_is_not_taken_does_not_count():
    watched = watch(lambda t, s, p: s)
    program = jax.jit(lambda s: jax.lax.cond(s > 0, lambda: watched(0.0, s, None), lambda: s))
    assert [run_counted(program, s)[1].evaluations for s in (-1.0, 1.0)] == [0, 1]


def test_runs_in_several_threads_keep_their_counts_apart():
    programs = [evaluations(times) for times in (100, 200, 300, 400)]
    with ThreadPoolExecutor(4) as threads:
        counts = [c.evaluations for _, c in threads.map(run_counted, programs)]
    assert counts == [100, 200, 300, 400]
