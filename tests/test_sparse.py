"""Sparse tangents, of native methods and of IDA: the runs and starts of dense ones, the choice."""

import numpy as np
import pytest
from helpers import long, nothing_compiled, run_of, toy
from scipy.sparse import csc_matrix

from bench.plugins.registry import Registry
from bench.stability.matrices import matrices
from bench.stability.systems import Oscillator
from integrators import Steps, Tolerances
from integrators.adapters import equations
from integrators.adapters.ida import IDA
from integrators.methods.generalized_alpha import HHT, GeneralizedAlpha
from integrators.methods.generalized_alpha_adaptive import GeneralizedAlphaAdaptive
from problems import jax, jnp, parameter
from problems.base import runtime
from problems.base.spec import SpecError
from problems.equations import sparsity
from problems.equations.compiled import compiled
from problems.equations.formulations import dae_layout
from problems.equations.initial_values import consistent_start, sparse_start
from problems.equations.kinematics import constrained_part
from problems.scenes.full_car import FullCar
from problems.scenes.oscillators import SpringMass
from problems.scenes.pendulums import Chain, Pendulum
from problems.scenes.quarter_car import QuarterCar
from problems.scenes.slider_crank import SliderCrank

pytest.importorskip("klujax")
GROUPS = ("q", "v", "a", "lam", "x", "y")
GGL, SPARSE, DENSE = "stabilised_index2", {"linear_solver": "sparse"}, {"linear_solver": "dense"}
MORE = [SpringMass(), SliderCrank(), QuarterCar()]
every_scene = pytest.mark.parametrize("scene", [Chain(links=3), *long(*MORE)], ids=str)
on_forms = pytest.mark.parametrize("form", [GGL, *long("index1", "index2", "index3")])


def rate(self, z):
    parts = 0.5 * z.q[0] - z.v[1] + 0.3 * z.a[0] + 0.2 * z.lam[0] - z.x[0] + 0.7 * z.y[0]
    return jnp.sin(3 * z.t)[None] + parts


#: A bead on a circle and a controller that uses all variables and the time.
ControlledBead = toy(
    "ControlledBead", q=[0.6, -0.8], v=[0.4, 0.3], x=[0.2], interval=(0.3, 1.0), state_rate=rate,
    m=parameter(1.5, "kg", "mass"), mass=lambda self, q: self.m * jnp.eye(2),
    force=lambda self, q, v, t: jnp.array([jnp.cos(2 * t), -9.81 * self.m]) - 0.2 * v,
    constraint=lambda self, q, t: 0.5 * (q @ q - 1.0)[None],
    output=lambda self, z: jnp.tanh(z.x + 0.1 * z.a[1] - 0.4 * z.y + 0.1 * z.lam),
    actuation=lambda self: np.array([[0.3], [1.0]]),
)  # fmt: skip


def prepared(method, scene, length, at):
    return method.prepare(scene, scene.interval[0] + length, at)


def ended(method, scene, length, at):
    return run_of(method, scene, at, scene.interval[0] + length)


def of_ida(scene, length=0.1, rtol=1e-6, **options):
    return prepared(IDA(**options), scene, length, Tolerances(rtol))


def is_sparse(method, scene):
    if isinstance(method, IDA):
        return prepared(method, scene, 0.1, Tolerances(1e-6)).given.sparsity is not None
    return bool(method.program(scene)[0].patterns)


# ---- the same runs ---------------------------------------------------------------------
def assert_agree(run, other, steps, h):
    """Newton leaves newton_tol, or what rounding of q (and, stabilised, of v) makes of a; the
    recurrences of a stable method add up what is left in each of the steps."""
    s, eps, largest = GeneralizedAlpha().scheme(), np.finfo(float).eps, {}
    for group in GROUPS:
        largest[group] = np.abs(getattr(other, group)).max(initial=1.0 if group in "qv" else 1e-3)
    slope = (1 - s.alpha_f) / (1 - s.alpha_m)
    rounding = largest["q"] / (h**2 * s.beta * slope) + largest["v"] / (h * s.gamma * slope)
    of_a = 1e-12 * largest["a"] + 16 * eps * rounding
    for group, size in largest.items():
        left = {"q": h**2 * of_a, "v": h * of_a}.get(group, of_a / largest["a"] * size)
        gap = np.abs(getattr(run, group) - getattr(other, group)).max(initial=0)
        assert gap <= steps * left + 4 * eps * size, group


@every_scene
@pytest.mark.parametrize("form", [GGL, *long("index3")])
def test_sparse_runs_are_those_of_dense_tangents_whether_these_are_kept_or_not(scene, form):
    steps, h = 40, scene.nominal_step / 10
    # On index 3 kept tangents leave more in the first steps after a corrected start.
    start = "corrected" if form == GGL else "consistent"
    dense, full, kept = (
        ended(GeneralizedAlpha(**of, formulation=form, start=start), scene, steps * h, Steps(h))
        for of in (DENSE, SPARSE, SPARSE | {"newton": "modified"})
    )
    for sparse in (full, kept):
        assert_agree(sparse, dense, steps, h)
    assert abs(full.work.newton - dense.work.newton) <= 2


@every_scene
@pytest.mark.parametrize("form", [GGL, *long("index1", "index2")])
def test_those_of_ida_take_the_same_steps_also_where_they_are_timed(scene, form):
    runs = [of_ida(scene, 15 * scene.nominal_step, formulation=form, **s) for s in (SPARSE, DENSE)]
    sparse, dense = (run.measure() for run in runs)
    assert sparse.status == dense.status == "ok"
    assert sparse.work == dense.work
    # Rounding moves the steps, as their size is made of small differences; the end is the same.
    for part in GROUPS:
        one, other = getattr(sparse, part)[-1], getattr(dense, part)
        assert one == pytest.approx(other[-1], abs=1e-9 * np.abs(other).max(initial=1e-3)), part
    end, timed = runs[0].execute()
    assert end == sparse.t[-1]
    assert timed[dae_layout(scene.sizes, form).q].tolist() == sparse.q[-1].tolist()


def test_rows_of_large_scenes_are_completed_by_sparse_algebra(monkeypatch):
    scene = Chain(links=3)
    z = ended(IDA(), scene, 0.05, Tolerances(1e-6))
    states = scene, z.t, z.q, z.v, z.x
    dense = equations.trajectory_from_states(*states)
    monkeypatch.setattr(sparsity, "DENSE_LIMIT", 1)
    monkeypatch.setattr(equations, "compiled", None)
    sparse = equations.trajectory_from_states(*states)
    for name in ("t", *GROUPS, "xdot"):
        found, values = getattr(sparse, name), getattr(dense, name)
        assert found.shape == values.shape
        assert found == pytest.approx(values, abs=1e-10 * np.abs(values).max(initial=1.0))


def test_work_is_counted_as_with_dense_tangents_and_other_parameters_compile_nothing_new():
    method, step = GeneralizedAlpha(**SPARSE), Steps(1e-3)
    scenes = [Chain(links=3), Chain(links=3, m=0.3, th0=0.2)]
    work = ended(method, scenes[0], 0.01, step).work
    assert work.steps == 10
    assert work.newton == work.residuals == work.jacobians == work.factorisations == work.solves
    assert 10 <= work.newton <= 40
    of_ida(scenes[0], 0.01, **SPARSE).measure()
    with nothing_compiled():
        ended(GeneralizedAlpha(rho_inf=0.5, **SPARSE), scenes[1], 0.01, step)
        assert of_ida(scenes[1], 0.01, **SPARSE).measure().status == "ok"
    kernels = [prepared(method, scene, 0.01, step).kernel for scene in scenes]
    assert kernels[0] is kernels[1]


# ---- patterns --------------------------------------------------------------------------
def difference(scene, formulation, sparse):
    """Largest difference of IDA's two Jacobians at random states and cj, relative."""
    at, n = np.array([*scene.parameters().values()]), dae_layout(scene.sizes, formulation).size
    dense = equations.packed_jacobian(scene.template(), formulation).bind(at)
    jacobian, entries = sparse
    values, rng, worst = jacobian.bind(at), np.random.default_rng(3), 0.0
    for cj in 10.0 ** rng.uniform(-2, 6, size=3):
        state = float(rng.normal()), rng.normal(size=n), rng.normal(size=n), cj
        built = csc_matrix((np.array(values(*state)), *entries), (n, n))
        full = np.asarray(dense(*state)).T
        worst = max(worst, np.abs(built.toarray() - full).max() / np.abs(full).max())
    return worst


@every_scene
@on_forms
def test_the_sparse_jacobian_is_the_dense_one_as_superlu_wants_it(scene, form):
    sparse = equations.sparse_jacobian(scene.template(), form)
    assert difference(scene, form, sparse) < 1e-14
    rows, starts = of_ida(scene, 1.0, formulation=form, **SPARSE).given.sparsity
    assert csc_matrix((np.ones(len(rows)), rows, starts)).has_canonical_format
    assert (rows.tolist(), starts.tolist()) == tuple(k.tolist() for k in sparse[1])


def test_the_pattern_holds_every_entry_and_its_colours_do_not_grow_with_the_chain():
    few, twelve, fifty = (
        GeneralizedAlpha(**SPARSE).program(Chain(links=n))[0].patterns[0] for n in (5, 12, 50)
    )
    assert twelve._coloring.num_colors == fifty._coloring.num_colors <= 9
    assert len(few.rows) < 0.5 * few.size**2
    assert len(fifty.rows) <= 14 * 50

    def residual(u):
        return jnp.concatenate([u[:2] * u[1:3] ** 2, jnp.sin(u[2:]) + u[0]])

    pattern, u = sparsity.Pattern(residual, 5), np.random.default_rng(4).normal(size=5)
    dense, both = np.zeros((5, 5)), jax.jit(lambda u: (pattern.values(residual, u),
                                                       jax.jacfwd(residual)(u)))  # fmt: skip
    dense[pattern.rows, pattern.columns], whole = map(np.asarray, both(u))
    assert dense == pytest.approx(whole, abs=1e-14)


# ---- starts ----------------------------------------------------------------------------
@pytest.mark.parametrize("scene", [ControlledBead(), *long(*MORE, Chain(links=5))], ids=str)
def test_the_start_by_sparse_algebra_is_the_dense_one(scene):
    dense = consistent_start(scene)
    sparse = sparse_start(scene, scene.initial_state(), scene.interval[0])
    for one, other in zip((*sparse.z, *sparse[1:4]), (*dense.z, *dense[1:4]), strict=True):
        size = np.abs(other).max(initial=1.0)
        assert np.asarray(one) == pytest.approx(np.asarray(other), abs=1e-9 * size)
    assert dense.constrained_jerk is None
    if scene.sizes.nl:
        at = (jnp.asarray(part) for part in (dense.z.q, dense.z.t, dense.jerk))
        part = np.asarray(jax.jit(lambda *at: constrained_part(scene, *at))(*at))
        assert sparse.constrained_jerk == pytest.approx(part, abs=1e-8 * np.abs(part).max())


def test_the_rates_at_the_start_are_slopes_along_the_motion():
    scene, eps = ControlledBead(), 1e-5
    start = sparse_start(scene, scene.initial_state(), scene.interval[0])
    z, xdot, steps = start.z, start.xdot, np.array([[-eps], [eps]])
    q = z.q + steps * z.v + steps**2 / 2 * z.a
    rows = map(np.asarray, (q, z.v + steps * z.a, z.x + steps * xdot, z.t + steps[:, 0]))
    near, rates = compiled(scene).complete(scene.parameters(), *rows)
    assert start.xddot == pytest.approx(np.diff(rates, axis=0)[0] / (2 * eps), rel=1e-7)
    assert start.jerk == pytest.approx(np.diff(near.a, axis=0)[0] / (2 * eps), rel=1e-7)


def test_a_start_with_redundant_constraints_shares_the_force_among_them(monkeypatch):
    monkeypatch.setattr(sparsity, "DENSE_LIMIT", 1)
    one, stated = consistent_start(Pendulum()).z, toy("Stated", base=Pendulum, redundant=1)
    for scene in (Pendulum(copies=2), stated(copies=2)):
        two = consistent_start(scene).z
        assert two.lam == pytest.approx(np.full(2, one.lam[0] / 2))
        assert two.a == pytest.approx(one.a)


# ---- the choice ------------------------------------------------------------------------
def test_size_and_fill_choose_the_solver(monkeypatch):
    assert sparsity.prefers_sparse(Chain(links=50))
    monkeypatch.setattr(sparsity, "DENSE_LIMIT", 50)
    large, small, full = Chain(links=20), Chain(links=5), SpringMass()
    for method in (HHT(newton="modified"), GeneralizedAlphaAdaptive(), IDA()):
        assert is_sparse(method, large)
        assert not is_sparse(method, small)
    for cls in (GeneralizedAlpha, IDA):
        assert not is_sparse(cls(**DENSE), large)
        assert is_sparse(cls(**SPARSE), small)
    with pytest.raises(SpecError, match="linear_solver=dense"):
        matrices(GeneralizedAlpha(**SPARSE), Oscillator(), [1.0])
    with pytest.raises(SpecError, match="auto, dense, sparse"):
        Registry().integrator("ida[linear_solver=klu]")
    monkeypatch.setattr(sparsity, "DENSE_LIMIT", 1)
    pattern = equations.dae_pattern(full.template(), "index1")
    assert len(pattern.rows) > 0.1 * pattern.size**2
    assert not is_sparse(IDA(), full)


#: A scene that solves equations, which is not followed.
Solving = toy(
    "Solving", base=SpringMass,
    force=lambda self, q, v, t: jnp.linalg.solve(self.mass(q), SpringMass.force(self, q, v, t)),
)  # fmt: skip


@pytest.mark.parametrize("scene", [Solving(), *long(FullCar())], ids=str)
def test_a_program_that_cannot_be_followed_is_refused_or_dense(scene, monkeypatch):
    for method in (GeneralizedAlpha, IDA):
        with pytest.raises(SpecError, match="linear_solver=dense"):
            is_sparse(method(**SPARSE), scene)
    start = consistent_start(scene)
    monkeypatch.setattr(sparsity, "DENSE_LIMIT", 1)
    assert not is_sparse(GeneralizedAlpha(), scene)
    assert not is_sparse(IDA(), scene)
    assert consistent_start(scene).z.a == pytest.approx(start.z.a)


def test_without_the_libraries_sparse_is_refused_and_auto_is_dense_and_told_once(
    monkeypatch, caplog
):
    monkeypatch.setattr(sparsity, "_NEEDED", ("no_such_library",))
    monkeypatch.setattr(sparsity, "DENSE_LIMIT", 50)
    runtime.slower.cache_clear()
    for method in (GeneralizedAlpha, IDA):
        assert not is_sparse(method(), Chain(links=20))
        with pytest.raises(SpecError, match=r"stepbench\[sparse\]"):
            is_sparse(method(**SPARSE), Chain(links=5))
    for links in (4, 60, 70):
        assert not sparsity.prefers_sparse(Chain(links=links))
    (told,) = [text for text in caplog.messages if "full matrices" in text]
    assert told.startswith("Large scenes take full matrices.")
    assert "pip install 'stepbench[sparse]'" in told
