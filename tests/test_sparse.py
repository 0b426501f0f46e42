"""Sparse tangents: the runs and starts of dense ones, and work that grows like the size."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from helpers import long, nothing_compiled

from integrators.methods.generalized_alpha import HHT, GeneralizedAlpha
from integrators.methods.generalized_alpha_adaptive import GeneralizedAlphaAdaptive
from integrators.resolutions import Steps
from problems import (
    MechatronicSystem,
    State,
    Variables,
    jax,
    jnp,
    parameter,
    runtime,
    sparsity,
)
from problems.compiled import compiled
from problems.formulations import dynamics_residual
from problems.initial_values import consistent_start
from problems.projections import constrained_part
from problems.reference import Reference, ReferenceFailed
from problems.scenes.chain import Chain
from problems.scenes.full_car import FullCar
from problems.scenes.pendulum import Pendulum
from problems.scenes.quarter_car import QuarterCar
from problems.scenes.slider_crank import SliderCrank
from problems.scenes.spring_mass import SpringMass
from problems.spec import SpecError
from problems.start_equations import sparse_start

pytest.importorskip("klujax")


@dataclass(frozen=True)
class ControlledBead(MechatronicSystem):
    """A bead on a circle and a controller that uses all variables and the time."""

    interval = (0.3, 1.0)
    m: float = parameter(1.5, "kg", "mass")

    def mass(self, q):
        return self.m * jnp.eye(2)

    def force(self, q, v, t):
        return jnp.array([jnp.cos(2 * t), -9.81 * self.m]) - 0.2 * v

    def constraint(self, q, t):
        return 0.5 * (q @ q - 1.0)[None]

    def state_rate(self, z):
        parts = 0.5 * z.q[0] - z.v[1] + 0.3 * z.a[0] + 0.2 * z.lam[0] - z.x[0] + 0.7 * z.y[0]
        return jnp.sin(3 * z.t)[None] + parts

    def output(self, z):
        return jnp.tanh(z.x + 0.1 * z.a[1] - 0.4 * z.y + 0.1 * z.lam)

    def actuation(self):
        return np.array([[0.3], [1.0]])

    def initial_state(self):
        return State(q=np.array([0.6, -0.8]), v=np.array([0.4, 0.3]), x=np.array([0.2]))


SCENES = [*long(SliderCrank(), QuarterCar(), SpringMass(), Chain(links=5)), ControlledBead()]


def end(method, scene, steps, h):
    t0 = scene.interval[0]
    run = method.prepare(scene, t0 + steps * h, Steps(h)).measure()
    assert run.status == "ok", run.message
    return run


@pytest.mark.parametrize(
    "scene",
    [Chain(links=3), *long(SpringMass(), SliderCrank(), QuarterCar())],
    ids=lambda scene: scene.name,
)
@pytest.mark.parametrize("form", ["stabilised_index2", *long("index3")])
def test_sparse_and_dense_runs_are_the_same(scene, form):
    h = scene.nominal_step / 10
    sparse, dense = (
        end(GeneralizedAlpha(linear_solver=kind, formulation=form, start="corrected"), scene, 20, h)
        for kind in ("sparse", "dense")
    )
    for group in ("q", "v", "a", "lam", "x", "y"):
        one, other = getattr(sparse, group), getattr(dense, group)
        size = np.abs(other).max(initial=1e-3)
        assert one == pytest.approx(other, abs=1e-8 * size), group
    assert abs(sparse.work.newton - dense.work.newton) <= 2


def pattern_of(scene, **options):
    program, _ = GeneralizedAlpha(linear_solver="sparse", **options).program(scene)
    (pattern,) = program.patterns
    return pattern


def test_the_pattern_holds_every_entry():
    scene = Chain(links=5)
    pattern = pattern_of(scene, formulation="stabilised_index2")
    rng = np.random.default_rng(4)

    def residual(u):
        z = Variables(u[:10] * 0.01, u[:10], u[:10], u[10:], jnp.zeros(0), jnp.zeros(0), 0.0)
        rows = [dynamics_residual(scene, z), scene.constraint(z.q, 0.0)]
        return jnp.concatenate(rows)

    found = sparsity.Pattern(residual, 15)
    u = rng.normal(size=15)
    dense = np.zeros((15, 15))
    both = jax.jit(lambda u: (found.values(residual, u), jax.jacfwd(residual)(u)))
    dense[found.rows, found.columns], whole = map(np.asarray, both(u))
    assert dense == pytest.approx(whole, abs=1e-14)
    assert found._coloring.num_colors <= 9
    assert len(pattern.rows) < 0.5 * pattern.size**2


def test_colours_do_not_grow_with_the_chain():
    twelve, fifty = (pattern_of(Chain(links=n)) for n in (12, 50))
    assert twelve._coloring.num_colors == fifty._coloring.num_colors
    assert len(fifty.rows) <= 14 * 50


@pytest.mark.parametrize("scene", SCENES, ids=lambda scene: scene.name)
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
        size = np.abs(part).max()
        assert sparse.constrained_jerk == pytest.approx(part, abs=1e-8 * size)


def test_the_rates_at_the_start_are_slopes_along_the_motion():
    scene, eps = ControlledBead(), 1e-5
    start = sparse_start(scene, scene.initial_state(), scene.interval[0])
    z, xdot = start.z, start.xdot
    steps = np.array([[-eps], [eps]])
    q = z.q + steps * z.v + steps**2 / 2 * z.a
    rows = (
        np.asarray(row) for row in (q, z.v + steps * z.a, z.x + steps * xdot, z.t + steps[:, 0])
    )
    near, rates = compiled(scene).complete(scene.parameters(), *rows)
    assert start.xddot == pytest.approx(np.diff(rates, axis=0)[0] / (2 * eps), rel=1e-7)
    assert start.jerk == pytest.approx(np.diff(near.a, axis=0)[0] / (2 * eps), rel=1e-7)


@pytest.mark.long
def test_a_program_that_cannot_be_followed_is_refused_or_dense(monkeypatch):
    scene = FullCar()  # it solves equations in its steering
    start = consistent_start(scene)
    with pytest.raises(SpecError, match="linear_solver=dense"):
        GeneralizedAlpha(linear_solver="sparse").program(scene)
    monkeypatch.setattr(sparsity, "DENSE_LIMIT", 1)
    assert not is_sparse(GeneralizedAlpha(), scene)
    assert consistent_start(scene).z.a == pytest.approx(start.z.a)


def test_a_start_with_redundant_constraints_shares_the_force_among_them(monkeypatch):
    monkeypatch.setattr(sparsity, "DENSE_LIMIT", 1)
    one, two = (consistent_start(Pendulum(copies=copies)).z for copies in (1, 2))
    assert two.lam == pytest.approx(np.full(2, one.lam[0] / 2))
    assert two.a == pytest.approx(one.a)


def is_sparse(method, scene):
    return bool(method.program(scene)[0].patterns)


def test_size_and_fill_choose_the_solver():
    long, short = Chain(links=50), Chain(links=5)
    assert is_sparse(HHT(), long)
    for newton in ("full", "modified"):
        assert is_sparse(GeneralizedAlpha(newton=newton), long)
        assert is_sparse(GeneralizedAlphaAdaptive(newton=newton), long)
        assert not is_sparse(GeneralizedAlpha(newton=newton, linear_solver="dense"), long)
    assert not is_sparse(GeneralizedAlpha(), short)
    assert not GeneralizedAlpha().program(long, sparse=False)[0].patterns
    with pytest.raises(SpecError, match="linear_solver=dense"):
        GeneralizedAlpha(linear_solver="sparse").program(short, sparse=False)


@pytest.mark.long
def test_a_thousand_links_keep_their_length_and_energy():
    scene = Chain(links=1000)
    run = end(GeneralizedAlpha(rho_inf=0.8), scene, 20, 1e-3)
    assert np.abs(np.asarray(scene.constraint(jnp.asarray(run.q[-1]), 0.0))).max() < 1e-12
    energy = [
        float(scene.energy(jnp.asarray(q), jnp.asarray(v)))
        for q, v in zip(run.q, run.v, strict=True)
    ]
    kinetic = 0.5 * scene.m * (run.v[0] @ run.v[0])
    assert np.ptp(energy) < 1e-4 * kinetic
    # The chain begins to turn as one body: each mass on a circle about the pivot.
    radius = np.hypot(run.q[1, ::2], run.q[1, 1::2])
    assert radius == pytest.approx(scene.length * np.arange(1, 1001), rel=1e-6)


def test_work_is_counted_as_with_dense_tangents():
    run = end(GeneralizedAlpha(linear_solver="sparse"), Chain(links=12), 10, 1e-3)
    work = run.work
    assert work.steps == 10
    assert work.newton == work.residuals == work.jacobians == work.factorisations == work.solves
    assert 10 <= work.newton <= 40


def test_other_parameters_compile_nothing_new():
    method = GeneralizedAlpha(linear_solver="sparse")
    scenes = [Chain(links=12), Chain(links=12, m=0.3, th0=0.2)]
    kernels = [method.prepare(s, s.interval[0] + 0.01, Steps(1e-3)).kernel for s in scenes]
    assert kernels[0] is kernels[1]
    end(method, scenes[0], 10, 1e-3)
    with nothing_compiled():
        end(GeneralizedAlpha(linear_solver="sparse", rho_inf=0.5), scenes[1], 10, 1e-3)


def test_no_reference_is_made_of_a_large_scene():
    reference = Reference(Chain(links=200), 0.1)
    assert "600 unknowns" in reference.missing
    with pytest.raises(ReferenceFailed, match="600 unknowns"):
        reference(np.array([0.1]))
    assert not Reference(Chain(links=100), 0.1).missing


def test_without_the_libraries_sparse_is_refused_and_auto_is_dense(monkeypatch):
    monkeypatch.setattr(sparsity, "_NEEDED", ("no_such_library",))
    scene = Chain(links=50)
    assert not is_sparse(GeneralizedAlpha(), scene)
    with pytest.raises(SpecError, match=r"stepbench\[sparse\]"):
        GeneralizedAlpha(linear_solver="sparse").program(scene)


@pytest.mark.long
def test_a_product_that_is_not_the_mass_matrix_is_found(refused, tmp_path):
    (tmp_path / "wrong.py").write_text(
        "from dataclasses import dataclass\n"
        "from problems.scenes.chain import Chain\n"
        "@dataclass(frozen=True)\n"
        "class Wrong(Chain):\n"
        "    'A chain.'\n"
        "    def mass_product(self, q, a):\n"
        "        return 1.01 * self.m * a\n"
    )
    assert "mass_product differs" in refused("check", tmp_path / "wrong.py")


@dataclass(frozen=True)
class Dense(Chain):
    """A chain without its product: the matrix is used."""

    mass_product = Chain.__mro__[1].mass_product


@pytest.mark.long
def test_a_scene_without_a_product_takes_its_matrix():
    assert not Dense.has("mass_product")
    one = end(GeneralizedAlpha(linear_solver="sparse"), Dense(links=4), 5, 1e-3)
    other = end(GeneralizedAlpha(linear_solver="sparse"), Chain(links=4), 5, 1e-3)
    assert one.lam == pytest.approx(other.lam, rel=1e-9)


def test_who_lacks_the_extra_is_told_so_once(monkeypatch, caplog):
    monkeypatch.setattr(sparsity, "available", lambda: False)
    runtime.slower.cache_clear()
    for links in (4, 60, 70):
        assert not sparsity.prefers_sparse(Chain(links=links))
    (told,) = caplog.messages
    assert told.startswith("Large scenes take full matrices.")
    assert "pip install 'stepbench[sparse]'" in told
