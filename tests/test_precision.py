"""`stepbench precision`: single, mixed and double precision of native steps."""

from __future__ import annotations

import re

import numpy as np
import pytest
from helpers import long, slope

from bench.plugins.registry import Registry
from bench.running.precision import precision_job, run_in
from bench.running.realtime import stepping
from bench.running.worker import Worker
from integrators.native import small_matrices
from integrators.native.constant_steps import grid, step_times
from integrators.native.kernel import Form
from integrators.native.lone_steps import LoneStep
from integrators.native.precision import single
from integrators.resolutions import Steps
from problems import formulations
from problems.runtime import coarseness, jax, jnp, single_floats, smallest
from problems.scenes.pendulum import Pendulum
from problems.spec import SpecError

INDEX3 = "generalized_alpha[rho_inf=0.8]"
STABILISED = "generalized_alpha[rho_inf=0.8,formulation=stabilised_index2]"
EPS = float(np.finfo(np.float32).eps)


@pytest.fixture(scope="module")
def worker():
    return Worker(Registry([]))


def step_of(worker, problem, integrator, precision, h=1e-3, steps=10):
    scene = worker.problem(problem)
    method = stepping(worker.registry.integrator(integrator), scene)
    return LoneStep(method, scene, h, steps, precision=precision)


def run_of(worker, problem, integrator, precision, h, steps):
    scene = worker.problem(problem)
    method = stepping(worker.registry.integrator(integrator), scene)
    return run_in(precision, method, scene, h, steps)


@pytest.mark.long
def test_multipliers_of_index_3_grow_like_the_inverse_square_of_the_step(worker):
    t_end = worker.problem("pendulum").interval[0] + 0.1
    steps = [1e-3, 2.5e-4]
    runs = precision_job(worker, "pendulum", INDEX3, steps, t_end)
    of = {(run.precision, run.steps): run.errors for run in runs}
    lam = [of["single", count]["lam"] for count in (100, 400)]
    assert 4 < lam[1] / lam[0] < 64
    assert lam[1] > 100 * of["double", 400]["lam"]
    assert of["single", 400]["q"] < 1e-4  # positions look right
    for count in (100, 400):
        for group, error in of["double", count].items():
            assert of["mixed", count][group] == pytest.approx(error, rel=1e-5)


# ---- programs ----------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("problem", "integrator"),
    [
        ("pendulum", INDEX3),
        *long(
            ("pendulum", "radau_iia[steps=constant]"),
            ("pendulum", "rodas5p[steps=constant]"),
            ("pendulum", "half_explicit_euler"),
            ("pendulum", "ali3p"),
            ("quarter_car", "bdf2[newton=modified]"),
            ("slider_crank", "rattle"),
            ("heavy_top_so3", "generalized_alpha_lie"),
            ("rolling_disc", INDEX3),
            ("slider_crank", "linearly_implicit_euler"),
            ("full_car", INDEX3),
        ),
    ],
)
def test_single_has_no_float_of_64_bits(worker, problem, integrator):
    step = step_of(worker, problem, integrator, "single")
    compiled = step._compiled.advance
    text = compiled.lower(step.first, step._packed).as_text().splitlines()
    wide = [line.strip() for line in text if "f64" in line]
    # The packed arguments of a run have 64 bits, and are rounded first.
    assert len(wide) == 2
    assert re.fullmatch(r"%\w+ = stablehlo.convert %arg1 : \(.*xf64>\) -> .*xf32>", wide[1])
    assert step.first.dtype == jnp.float32
    assert step(step.first).dtype == jnp.float32


@pytest.mark.long
def test_other_precisions_change_no_program_in_double(worker):
    scene, method = worker.problem("pendulum"), worker.registry.integrator(INDEX3)

    def program():
        run = method.prepare(scene, scene.interval[1], Steps(1e-2))
        step = step_of(worker, "pendulum", INDEX3, "double")
        alone = step._compiled.advance.lower(step.first, step._packed)
        return run.kernel.run.lower(run.arguments, *run.end_only).as_text() + alone.as_text()

    before = program()
    assert "f32" not in before
    for precision in ("single", "mixed"):
        step = step_of(worker, "pendulum", INDEX3, precision)
        step(step.first)
        alone = step._compiled.advance.lower(step.first, step._packed).as_text()
        narrow = [line for line in alone.splitlines() if "f32" in line]
        wide = [line for line in alone.splitlines() if "f64" in line and "f32" not in line]
        assert (len(narrow) > len(wide)) == (precision == "single")
        assert len(narrow) > 30
    assert program() == before


def test_loops_branches_and_constants_become_narrow():
    table = np.array([1 / 3, 2 / 3])  # as scenes have them: 64 bits

    def function(x, k):
        def once(carry):
            n, y = carry
            y = jax.lax.cond(y[0] > 2.0, lambda y: y - 1.0, lambda y: y + jnp.asarray(table), y)
            return n + 1, jax.lax.fori_loop(0, 3, lambda j, y: y * np.float64(0.1) + j, y)

        n, y = jax.lax.while_loop(lambda carry: carry[0] < k, once, (jnp.asarray(0), x))
        _, sums = jax.lax.scan(lambda s, y: (s + y, s), jnp.zeros(()), y)
        return n, y, sums, jnp.zeros(2) + jnp.arange(2, dtype=float)

    x = np.array([0.7, 1.9])
    wide, narrow = jax.jit(function)(x, 5), jax.jit(single(function))(x.astype("f4"), 5)
    assert [part.dtype for part in narrow] == ["int64", "float32", "float32", "float32"]
    for exact, rounded in zip(wide, narrow, strict=True):
        assert np.asarray(rounded) == pytest.approx(np.asarray(exact), rel=8 * EPS)
    assert np.abs(np.asarray(narrow[1], float) - wide[1]).max() > 1e-12  # indeed rounded


def test_an_inverse_in_single_takes_the_largest_pivot():
    a = np.array([[3.0, 0.0, 1.0], [1.0, 4.0, 1e-9], [1e-9, 1.0, 2.0]])
    found = jax.jit(single(small_matrices.inverse))(jnp.asarray(a, jnp.float32))
    assert found.dtype == jnp.float32
    assert np.asarray(found) @ a == pytest.approx(np.eye(3), abs=16 * EPS)


def test_equations_of_motion_are_solved_as_far_as_32_bits_go():
    def root(guess):
        return formulations._newton(
            lambda u: u * u - jnp.array([2.0, 3.0]), guess, jnp.linalg.solve
        )

    found, iterations = jax.jit(single(root))(jnp.ones(2, jnp.float32))
    assert np.asarray(found) == pytest.approx(np.sqrt([2, 3]), rel=2 * EPS)
    assert iterations < 10


def test_time_in_single_does_not_add_up():
    clock, steps = grid(0.0, 100.0, Steps(1e-4))
    form = Form.of(clock)

    def times(packed, n):
        return step_times(form.unpack(packed)[0], n.astype(int))

    for n in (0, 77_777, steps - 1):
        exact, h = step_times(clock, n)
        t, size = jax.jit(single(times))(form.pack(clock), jnp.asarray(n, jnp.float32))
        assert t.dtype == jnp.float32
        assert float(t) == pytest.approx(exact, rel=2 * EPS)
        assert float(size) == pytest.approx(h, rel=2 * EPS)


def test_tolerances_follow_the_floats_while_a_program_is_traced():
    assert (coarseness(), smallest()) == (1.0, 1e-300)
    with single_floats():
        assert coarseness() == EPS / np.finfo(float).eps
        assert 0 < np.float32(smallest()) < 1e-30
    assert coarseness() == 1.0


# ---- what precisions cost ----------------------------------------------------------------
def by_hand(h, form, seconds=1.0, residuals=np.float32, solves=np.float32):
    """Largest errors of lam and q of generalized-alpha (rho_inf = 0.8) on the pendulum, index 3.

    Algorithm 1 of Bruels & Arnold (2008) in NumPy. ``form`` is plain, scaled (equations and
    multiplier by beta h^2), or increments: the step's increment of q is the unknown, the constraint
    is its exact difference over the step, and the sum of increments is compensated.
    """
    f, (alpha_m, alpha_f) = residuals, (1 / 3, 4 / 9)
    gamma = 0.5 + alpha_f - alpha_m
    beta = (gamma + 0.5) ** 2 / 4
    of_a, of_v = (1 - alpha_m) / (h * h * beta * (1 - alpha_f)), gamma / (h * beta)
    exact = Pendulum().exact(0.35 + h * np.arange(round(seconds / h) + 1))
    q, v, rate = (exact[name][0].astype(f) for name in ("q", "v", "a"))
    a, low, gravity = rate.copy(), np.zeros(2, f), np.array([0, -9.81], f)
    scale = f(1 if form == "plain" else beta * h * h)
    found = {"lam": [float(exact["lam"][0, 0])], "q": [q]}
    for _ in exact["q"][1:]:
        d, v, lam = f(h) * v + f(h * h * (0.5 - beta)) * a, v + f(h * (1 - gamma)) * a, f(0)
        a = (f(alpha_f) * rate - f(alpha_m) * a) / f(1 - alpha_m)
        d, v, rate = d + f(h * h * beta) * a, v + f(h * gamma) * a, np.zeros(2, f)
        for _ in range(6):
            end = q + d
            phi = q @ d + f(0.5) * (d @ d) if form == "increments" else f(0.5) * (end @ end - f(1))
            r = np.append(scale * (rate + end * lam - gravity), phi)
            tangent = np.zeros((3, 3))
            tangent[:2, :2] = float(scale) * (of_a + float(lam)) * np.eye(2)
            tangent[:2, 2] = tangent[2, :2] = end
            x = np.linalg.solve(tangent.astype(solves), -r.astype(solves)).astype(f)
            d, v, rate = d + x[:2], v + f(of_v) * x[:2], rate + f(of_a) * x[:2]
            lam = lam + x[2] / scale
        a = a + f((1 - alpha_f) / (1 - alpha_m)) * rate
        total = q + (d - low)
        low = (total - q) - (d - low) if form == "increments" else low
        q = total
        found["lam"].append(float(lam))
        found["q"].append(q)
    lam, q = np.array(found["lam"]) - exact["lam"][:, 0], np.array(found["q"], float) - exact["q"]
    return np.abs(lam).max(), np.abs(q).max()


@pytest.mark.long
def test_by_hand_scaling_is_no_cure_but_increments_and_refinement_are():
    steps = [2e-3, 1e-3, 5e-4, 2.5e-4]
    for form in ("plain", "scaled"):
        lam, q = zip(*(by_hand(h, form) for h in steps), strict=True)
        assert slope(steps, lam) == pytest.approx(-2, abs=0.4)
        assert lam[-1] > 50
        assert max(q) < 1e-4
    exact, _ = by_hand(2.5e-4, "plain", residuals=np.float64, solves=np.float64)
    mixed, _ = by_hand(2.5e-4, "plain", residuals=np.float64)
    assert mixed == pytest.approx(exact, rel=1e-3)
    assert by_hand(2.5e-4, "increments")[0] < 2


@pytest.mark.long
@pytest.mark.parametrize(
    ("integrator", "power"),
    [
        (INDEX3, -2),
        ("bdf2", -2),
        ("radau_iia[formulation=index3,stages=3,steps=constant]", -2),
        ("generalized_alpha[rho_inf=0.8,formulation=stabilised_index2,start=corrected]", -1),
        ("radau_iia[formulation=stabilised_index2,stages=3,steps=constant]", -1),
        ("radau_iia[formulation=index2,stages=3,steps=constant]", -1),
    ],
)
def test_the_index_decides_how_rounding_grows(worker, integrator, power):
    steps = [5e-4, 2.5e-4, 1.25e-4, 6.25e-5]
    t_end = worker.problem("pendulum").interval[0] + 0.25
    runs = precision_job(worker, "pendulum", integrator, steps, t_end, "rms", ["single"])
    assert slope(steps, [run.errors["lam"] for run in runs]) == pytest.approx(power, abs=0.4)


@pytest.mark.long
@pytest.mark.parametrize("problem", ["slider_crank", "quarter_car", "full_car"])
@pytest.mark.parametrize("newton", ["full", "modified"])
def test_mixed_gives_the_states_of_double(worker, problem, newton):
    name = f"generalized_alpha[newton={newton}]"
    double, mixed = (run_of(worker, problem, name, p, 1e-3, 200) for p in ("double", "mixed"))
    assert (double.status, mixed.status) == ("ok", "ok")
    for group in ("q", "v", "x"):
        exact = getattr(double, group)
        assert np.abs(getattr(mixed, group) - exact).max(initial=0) <= 1e-8 * (
            1 + abs(exact).max(initial=0)
        )
    assert (mixed.q != double.q).any()


@pytest.mark.long
@pytest.mark.parametrize("integrator", [INDEX3, "bdf2", "generalized_alpha[newton=modified]"])
@pytest.mark.parametrize("problem", ["pendulum", "oscillator", "quarter_car", "slider_crank"])
@pytest.mark.parametrize("h", [1e-2, 1e-4])
def test_newton_ends_where_32_bits_end(worker, problem, integrator, h):
    run = run_of(worker, problem, integrator, "single", h, 200)
    assert (run.status, run.message) == ("ok", "")
    assert run.t[-1] == pytest.approx(run.t[0] + 200 * h, rel=1e-14)


@pytest.mark.long
def test_newton_ends_where_updates_no_longer_shrink(worker):
    run = run_of(worker, "quarter_car", INDEX3, "single", 2.5e-4, 4000)
    assert (run.status, run.message) == ("ok", "")


@pytest.mark.long
@pytest.mark.parametrize(
    ("problem", "integrator"),
    [
        ("quarter_car", "rodas5p[steps=constant]"),  # solves for accelerations and outputs
        ("quarter_car", "half_explicit_euler"),  # solves for outputs by itself
        ("spring_mass[q0=0]", INDEX3),  # all is zero
        ("slider_crank", "radau_iia[formulation=index3,stages=2,steps=constant]"),
        ("pendulum[copies=2]", "ali3p[values=own]"),
    ],
)
def test_other_iterations_end_in_single_near_double(worker, problem, integrator):
    double, narrow = (
        run_of(worker, problem, integrator, p, 1e-3, 100) for p in ("double", "single")
    )
    assert (narrow.status, narrow.message) == ("ok", "")
    assert len(narrow.t) == 101
    for group in ("q", "v", "x"):
        exact = getattr(double, group)
        size = 1 + np.abs(exact).max(initial=0)
        assert np.abs(getattr(narrow, group) - exact).max(initial=0) < 1e-2 * size


@pytest.mark.parametrize(
    ("problem", "integrator", "words"),
    [
        ("pendulum", "ida", "chooses its own steps"),
        ("pendulum", "dopri8[steps=constant]", "library holds"),
        ("bouncing_ball", "newmark", "jump at samples or events"),
        ("heavy_top_se3", "bdf2", "states kinematics, .* which the method does not handle"),
        ("pendulum", "generalized_alpha[linear_solver=sparse]", "nor in single or mixed precision"),
    ],
)
def test_what_has_no_such_step_is_refused(worker, problem, integrator, words):
    with pytest.raises(SpecError, match=words):
        precision_job(worker, problem, integrator, [0.01], 1.0, precisions=["single"])


def test_too_many_steps_are_refused(worker):
    with pytest.raises(SpecError, match="take 10000000 steps; give steps that make at most"):
        precision_job(worker, "pendulum", INDEX3, [0.01, 1e-7], 1.35)
