"""Scenes of SymPy models: the equations of scenes by hand, as text that needs no SymPy."""

from __future__ import annotations

import inspect
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import sympy as sm
from helpers import long
from sympy.physics.mechanics import (
    KanesMethod,
    LagrangesMethod,
    Particle,
    Point,
    ReferenceFrame,
    System,
    dynamicsymbols,
)

from bench.check.checker import CHECKS, examine
from bench.check.verdicts import FAILED
from bench.plugins.fingerprint import fingerprint
from bench.plugins.registry import Registry
from problems import from_sympy, jnp
from problems.base.spec import SpecError
from problems.equations.initial_values import consistent_start
from problems.mechanics import lagrange

T = dynamicsymbols._t
M, K, C = sm.symbols("m k c")
X, Y, F = dynamicsymbols("x y f")
OSCILLATOR = M * X.diff(T) ** 2 / 2 - K * X**2 / 2


def scene_of(method, **given):
    return from_sympy(method, **{"interval": (0, 1), "nominal_step": 0.01, **given})


def spring(**given):
    usual = {"constants": {M: 2.0, K: 8.0}, "initial": {X: 1.0}}
    return scene_of(LagrangesMethod(OSCILLATOR, [X]), **{**usual, **given})


def rod(*constraints, **given):
    """A point on a massless rod of length c."""
    lagrangian = M * (X.diff(T) ** 2 + Y.diff(T) ** 2) / 2 - 9.81 * M * Y
    method = LagrangesMethod(lagrangian, [X, Y], hol_coneqs=constraints or [X**2 + Y**2 - C**2])
    usual = {"constants": {M: 1.0, C: 2.0}, "initial": {X: 1.2}, "guess": {Y: -1.0}}
    return scene_of(method, **{**usual, **given})


TEXT = (Path(__file__).parent.parent / "docs" / "models.md").read_text(encoding="utf-8")
EXAMPLES = {
    block.split("\n", 1)[0].removeprefix("# "): block
    for block in re.findall(r"```python\n(.*?)```", TEXT, re.DOTALL)
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("examples")
    for name, code in EXAMPLES.items():
        (path / name).write_text(code, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def registry(folder):
    return Registry([folder])


# ---- the document ------------------------------------------------------------------------
@pytest.mark.parametrize("name", ["cart_pendulum", *long("four_bar", "n_link")])
def test_the_examples_pass_every_check(registry, name):
    findings = [examine(registry, "problems", name, check) for check in CHECKS["problems"]]
    assert [finding.text for finding in findings if finding.verdict == FAILED] == []


@pytest.mark.long
def test_the_commands_of_the_document_run_in_processes_of_their_own(folder):
    (block,) = re.findall(r"```sh\n(.*?)```", TEXT, re.DOTALL)
    for line in block.splitlines():
        command = [sys.executable, "-m", "bench", *line.split()[1:]]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=280)
        assert done.returncode == 0, done.stdout + done.stderr


# ---- the same equations as by other ways ---------------------------------------------------
def test_the_closed_loop_is_the_built_in_one_which_moves_as_in_mujoco(registry):
    made, own = (consistent_start(scene).z for scene in (
        registry.problem("four_bar"), Registry([]).problem("sympy_four_bar")
    ))  # fmt: skip
    for one, other in zip(made, own, strict=True):
        assert one == pytest.approx(other, rel=1e-12, abs=1e-12)
    assert np.abs(made.a).max() > 1
    # The constraint is the way from the last joint to its support.
    q = made.q + 0.1
    gap = [1.0, 2.0, 2.0] @ np.stack([np.cos(q), np.sin(q)], axis=1) - [2.5, 0.0]
    assert np.asarray(registry.problem("four_bar").constraint(q, 0.0)) == pytest.approx(gap)


def cart(n):
    """Energies of SymPy's pendulum on a cart, whose angles count from the vertical."""

    def kinetic(q, v):
        x = jnp.cumsum(jnp.concatenate([v[:1], -0.5 * jnp.cos(q[1:]) * v[1:]]))
        y = jnp.cumsum(jnp.concatenate([jnp.zeros(1), -0.5 * jnp.sin(q[1:]) * v[1:]]))
        return jnp.sum(x**2 + y**2) / 2

    def potential(q):
        return 9.81 * jnp.sum(jnp.cumsum(0.5 * jnp.cos(q[1:])))

    return kinetic, potential


@pytest.mark.parametrize("n", [2, *long(5)])
def test_an_n_link_pendulum_has_the_equations_of_its_energies(n):
    exec(
        EXAMPLES["n_link.py"].replace("LINKS = 2", f"LINKS = {n}"), space := {"__name__": "n_link"}
    )
    scene, (kinetic, potential) = space["NLink"](), cart(n)
    q, v = np.linspace(-1, 2, n + 1), np.linspace(3, -1, n + 1)
    own = lagrange.mass(kinetic, q), lagrange.force(kinetic, potential, q, v)
    for found, wanted in zip((scene.mass(q), scene.force(q, v, 0.0)), own, strict=True):
        assert np.asarray(found) == pytest.approx(np.asarray(wanted), rel=1e-12, abs=1e-12)


def kane(order=(0, 1), **constraints):
    """Two masses on a line with a spring between them; speeds in the given order."""
    u = dynamicsymbols("u1 u2")
    frame, origin = ReferenceFrame("N"), Point("O")
    origin.set_vel(frame, 0)
    points = [origin.locatenew(f"P{k}", x * frame.x) for k, x in enumerate((X, Y))]
    for point, speed in zip(points, u, strict=True):
        point.set_vel(frame, speed * frame.x)
    bodies = [Particle(f"B{k}", point, (k + 1) * M) for k, point in enumerate(points)]
    pull = K * (Y - X) * frame.x
    method = KanesMethod(
        frame,
        [X, Y][: 2 - len(constraints.get("q_dependent", []))],
        [u[k] for k in order],
        kd_eqs=[u[0] - X.diff(T), u[1] - Y.diff(T)],
        **constraints,
    )
    method.kanes_equations(bodies, [(points[0], pull + F * frame.x), (points[1], -pull)])
    return method, u


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_equations_of_kane_follow_the_coordinates_whatever_the_order_of_speeds(order):
    method, u = kane(order)
    constants = {M: 2.0, K: 5.0, F: 7.0}
    scene = scene_of(method, constants=constants, initial={X: 1.0, Y: 3.0, u[1]: 0.5})()
    q, v, _ = scene.initial_state()
    assert scene.mass(q) == pytest.approx(np.diag([2.0, 4.0]))
    assert scene.force(q, v, 0.0) == pytest.approx([5.0 * 2 + 7, -5.0 * 2])
    assert v == pytest.approx([0, 0.5])
    assert not scene.has("energy")


def test_kane_and_lagrange_agree_on_a_constrained_model():
    bound = {"q_dependent": [Y], "configuration_constraints": [Y - 2 * X**2]}
    constants = {M: 2.0, K: 5.0, F: 0.0}
    method, u = kane(**bound)
    kanes = scene_of(method, constants=constants, initial={X: 1.0, u[0]: 1.0})()
    lagrangian = M * (X.diff(T) ** 2 + 2 * Y.diff(T) ** 2) / 2 - K * (Y - X) ** 2 / 2
    method = LagrangesMethod(lagrangian, [X, Y], hol_coneqs=[Y - 2 * X**2])
    other = scene_of(method, constants={M: 2.0, K: 5.0}, initial={X: 1.0, X.diff(T): 1.0})()
    first, second = consistent_start(kanes).z, consistent_start(other).z
    assert first.v == pytest.approx([1, 4])
    assert first.a == pytest.approx(second.a, rel=1e-12)
    assert first.lam == pytest.approx(second.lam, rel=1e-12)


# ---- parameters, time, energy ------------------------------------------------------------
def test_only_models_without_other_forces_and_without_time_state_an_energy():
    assert spring()().energy(np.array([0.5]), np.array([3.0])) == 9 + 1
    frame, point = ReferenceFrame("N"), Point("P")
    point.set_vel(frame, X.diff(T) * frame.x)
    damped = LagrangesMethod(
        OSCILLATOR, [X], forcelist=[(point, -C * X.diff(T) * frame.x)], frame=frame
    )
    made = scene_of(damped, constants={M: 1.0, K: 1.0, C: 3.0}, initial={})()
    assert made.force(np.array([2.0]), np.array([1.0]), 0.0) == pytest.approx([-2 - 3])
    for other in (
        type(made),
        spring(constants={M: 2.0, K: 8.0 + sm.sin(T)}),
        rod(X**2 + Y**2 - C**2, Y + 1 + T, initial={}, guess={X: 1, Y: -1}),
        scene_of(
            LagrangesMethod(OSCILLATOR + K * X.diff(T) * X, [X]),
            constants={M: 1.0, K: 1.0},
            initial={},
        ),
    ):
        assert not other.has("energy")
        assert "conservative" not in other.tags


def test_functions_of_time_and_derived_constants_are_expressions():
    moved = M * (X.diff(T) + F.diff(T)) ** 2 / 2 - K * X**2 / 2  # a spring on a support at f
    inertia, size = sm.symbols("J s")
    constants = {M: 2 * inertia, inertia: size**2, size: 3.0, K: 1.0, F: sm.sin(2 * T)}
    scene = scene_of(LagrangesMethod(moved, [X]), constants=constants, initial={})()
    assert scene.parameters() == {"s": 3.0, "k": 1.0}
    assert scene.mass(np.zeros(1)) == pytest.approx(np.array([[18.0]]))
    force = scene.force(np.array([0.5]), np.zeros(1), 0.3)
    assert force == pytest.approx([18 * 4 * np.sin(0.6) - 0.5], rel=1e-14)
    still = scene_of(LagrangesMethod(moved, [X]), constants=constants | {F: 4.0}, initial={})
    assert still().force(np.array([0.5]), np.zeros(1), 0.3) == pytest.approx([-0.5])


def test_powers_cases_and_extremes_mean_what_sympy_means():
    cases = sm.Piecewise((X**3, (X > 0) & (X < 2)), (sm.Abs(X), True))
    potential = cases + sm.sqrt(X**2 + K) ** 3 / X**2
    force = -potential.diff(X).doit() + sm.Max(X, K, 0.1) + sm.Min(X.diff(T), 2, K) * sm.sign(X)
    frame, point = ReferenceFrame("N"), Point("P")
    point.set_vel(frame, X.diff(T) * frame.x)
    x, v = sm.symbols("x v", real=True)
    force = force.xreplace({X.diff(T): v}).xreplace({X: x}).doit()
    shown = force.xreplace({v: X.diff(T), x: X})
    free = LagrangesMethod(
        M * X.diff(T) ** 2 / 2, [X], forcelist=[(point, shown * frame.x)], frame=frame
    )
    scene = scene_of(free, constants={M: 1.0, K: 0.7}, initial={})()
    for at in (-1.3, 0.4, 1.1, 2.5):
        wanted = float(force.subs({x: at, v: -3, K: 0.7}))
        found = scene.force(np.array([at]), np.array([-3.0]), 0.0)
        assert found == pytest.approx([wanted], rel=1e-14)
    assert "x**(-2.0)" not in scene.source_text


# ---- the start ---------------------------------------------------------------------------
def test_what_is_left_out_of_the_start_follows_from_the_constraints():
    low = rod(initial={X: 1.2, X.diff(T): 0.8})().initial_state()
    assert low.q == pytest.approx([1.2, -1.6], rel=1e-15)
    assert low.v == pytest.approx([0.8, 0.6], rel=1e-15)
    high = rod(guess={Y: 1.0})().initial_state()
    assert high.q == pytest.approx([1.2, 1.6], rel=1e-15)
    assert np.all(high.v == 0)
    twice = rod(X**2 + Y**2 - C**2, 3 * (X**2 + Y**2 - C**2))().initial_state()
    assert twice.q == pytest.approx([1.2, -1.6], rel=1e-12)
    moving = rod(Y - C * T + 1, initial={X: 1.0})().initial_state()
    assert [*moving.q, *moving.v] == pytest.approx([1, -1, 0, 2])


# ---- the text ----------------------------------------------------------------------------
def test_the_text_of_a_class_runs_without_sympy_and_computes_the_same(registry, monkeypatch):
    scene, space = registry.problem("four_bar"), {"__name__": __name__}
    monkeypatch.setitem(sys.modules, "sympy", None)
    exec(scene.source_text, space)
    assert consistent_start(space["FourBar"]()).z.a.tolist() == consistent_start(scene).z.a.tolist()
    source = inspect.getsource(type(scene).constraint)
    assert source in scene.source_text
    assert "jnp.cos(q0)" in source


def test_a_class_belongs_to_its_module_and_can_be_inherited_from(tmp_path):
    code = EXAMPLES["cart_pendulum.py"].replace("CartPendulum = from_sympy(", "Base = from_sympy(")
    code += "\n\nclass Cart(Base):\n    'A cart.'\n    tags = ('mine',)\n"
    (tmp_path / "cart.py").write_text(code)
    problems = Registry([tmp_path / "cart.py"]).problems
    assert problems["cart"].cls.__mro__[1] is problems["cart_pendulum"].cls
    assert problems["cart"].paragraphs[0] == "A cart."


@pytest.mark.long
def test_the_text_is_the_same_in_every_process(folder, registry):
    code = "import runpy, sys; print(runpy.run_path(sys.argv[1])['FourBar'].source_text, end='')"
    for seed in ("1", "2"):
        done = subprocess.run(
            [sys.executable, "-c", code, folder / "four_bar.py"],
            capture_output=True, text=True, env=os.environ | {"PYTHONHASHSEED": seed},
        )  # fmt: skip
        assert done.stdout == registry.problem("four_bar").source_text


def test_the_fingerprint_changes_with_a_model_that_is_read_from_a_file(tmp_path):
    data, found = tmp_path / "length.json", []
    code = EXAMPLES["cart_pendulum.py"].replace("l: 0.8", "l: json.load(open(PATH))")
    code = code.replace(
        "import sympy as sm", f"import json\nimport sympy as sm\nPATH = {str(data)!r}"
    )
    for part, length in (("a", 0.8), ("b", 0.8), ("c", 0.9)):
        (tmp_path / part).mkdir()
        data.write_text(json.dumps(length))
        (tmp_path / part / "cart.py").write_text(code)
        made = Registry([tmp_path / part / "cart.py"]).problems["cart_pendulum"].cls
        found.append(fingerprint(made))
    assert found[0] == found[1] != found[2]


# ---- what is refused, in one sentence each ---------------------------------------------------
def driven():
    u = dynamicsymbols("u")
    frame, point = ReferenceFrame("N"), Point("P")
    point.set_vel(frame, (u + K) * frame.x)
    method = KanesMethod(frame, [X], [u], kd_eqs=[u + K - X.diff(T)])
    method.kanes_equations([Particle("B", point, M)], [(point, K * frame.x)])
    return method


def method_with(lagrangian, **more):
    return lambda **given: scene_of(LagrangesMethod(lagrangian, [X], **more), **given)


def of(method):
    return lambda **given: scene_of(method(), **given)


MASS, TWIN = sm.Symbol("mass"), sm.Symbol("m", positive=True)
REFUSED = {
    "missing constant": (spring, {"constants": {M: 1.0}}, "The force contains k: neither"),
    "unknown constant": (spring, {"constants": {M: 1, K: 1, C: 1}}, "do not contain c "),
    "no symbol": (spring, {"constants": {M: 1, K: 1, X: 1}}, "constants names x\\(t\\)"),
    "text": (spring, {"constants": {M: 1, K: "("}}, "constants: k='\\(' is no expression"),
    "not finite": (spring, {"constants": {M: 1, K: np.nan}}, "k=nan is not a finite number"),
    "unknown function": (method_with(OSCILLATOR + F * X), {}, "force contains f\\(t\\): neither"),
    "unknown start": (spring, {"initial": {Y: 1.0}}, "initial names y\\(t\\): no coordinate"),
    "start in time": (spring, {"initial": {X: T}}, "initial: x\\(t\\) depends on .* time"),
    "wrong unit": (spring, {"units": {C: "m"}}, "units names c"),
    "taken name": (method_with(OSCILLATOR.subs(K, MASS)), {"constants": {M: 1, MASS: 1}},
                   "cannot be called 'mass'"),
    "one name twice": (method_with(OSCILLATOR + TWIN * X), {"constants": {M: 1, K: 1, TWIN: 1}},
                       "cannot be called 'm'"),
    "scene's name": (spring, {"name": "my scene"}, "is no name of a scene"),
    "step": (spring, {"nominal_step": "x"}, "nominal_step=x is not a finite number"),
    "moving kinematics": (of(driven), {}, "kd_eqs have terms without speeds"),
    "no equations": (
        of(lambda: KanesMethod(ReferenceFrame("N"), [X], [Y], kd_eqs=[Y - X.diff(T)])), {},
        "Call kanes_equations",
    ),
    "no equations of a system": (of(System), {}, "Call form_eoms"),
    "not linear in v": (method_with(OSCILLATOR, nonhol_coneqs=[X.diff(T) ** 2 - 1]), {},
                        "are not linear"),
    "constraint of v": (method_with(OSCILLATOR, hol_coneqs=[X + X.diff(T)]), {},
                        "contain velocities; give these as"),
    "mass in time": (spring, {"constants": {M: 1 + T, K: 1}}, "mass matrix depends on time"),
    "special function": (method_with(OSCILLATOR + sm.erf(X) * K), {}, "erf, which jax.numpy does"),
    "no method": (lambda **given: scene_of(OSCILLATOR, **given), {}, "takes a LagrangesMethod"),
    "inconsistent start": (rod, {"initial": {X: 1, Y: 1}}, "initial q .* violates .* by 2;"),
    "inconsistent speed": (rod, {"initial": {X.diff(T): 1, Y.diff(T): 1}}, "initial v .* violates"),
}  # fmt: skip


def test_bad_input_is_one_sentence():
    for case, (make, given, expected) in REFUSED.items():
        usual = {"constants": {M: 1.0, K: 1.0}, "initial": {}} if make not in (spring, rod) else {}
        with pytest.raises(SpecError, match=expected) as error:
            make(**{**usual, **given})
        text = str(error.value)
        assert "\n" not in text, case
        assert text.endswith("."), case
