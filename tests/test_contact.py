"""Contact: impacts as events and within steps, friction and rest, judged by closed forms."""

import json
import re
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np
import pytest
import scipy.linalg
from click.testing import CliRunner
from helpers import long
from scipy.optimize import brentq

from bench.commands.main import main
from bench.plugins.registry import Registry
from bench.running.errors import event_errors, relative_errors
from integrators.adapters.ida import IDA
from integrators.methods.half_explicit import PHEM56
from integrators.methods.moreau_jean import MoreauJean
from integrators.methods.radau_iia import RadauIIA
from integrators.methods.stormer_verlet import StormerVerlet
from integrators.resolutions import Steps, Tolerances
from problems import ContactSystem, MechatronicSystem, State, Variables, jax, jnp, parameter
from problems.compiled import compiled
from problems.contact import impact
from problems.phases import falls
from problems.reference import Reference
from problems.scenes.bouncing_ball import BouncingBall
from problems.scenes.impact_stop import ImpactStop
from problems.scenes.oscillator import Oscillator
from problems.scenes.sliding_rolling import SlidingRolling
from problems.scenes.woodpecker import Woodpecker
from problems.spec import SpecError


def run(method, scene, resolution, t_end=None):
    return method.prepare(scene, t_end or scene.interval[1], resolution).measure()


def at(q, v):
    """All variables of a scene without constraints and controllers."""
    q, v, none = (jnp.asarray(part, dtype=float) for part in (q, v, ()))
    return Variables(q, v, 0 * v, none, none, none, jnp.zeros(()))


# ---- laws of impact ----------------------------------------------------------------------
@dataclass(frozen=True)
class _Ball(ContactSystem):
    """A ball with spin on ground that rises: x, y, angle; radius and mass are 1."""

    interval = (0.0, 2.0)
    nominal_step = 0.02
    restitution: float = parameter(0.5, "1", "restitution", low=0.0, high=1.0)
    friction: float = parameter(0.2, "1", "friction", low=0.0)
    rises: float = parameter(0.0, "m/s", "velocity of the ground")
    fast: float = parameter(3.0, "m/s", "velocity along the ground")

    def mass(self, q):
        return jnp.diag(jnp.array([1.0, 1.0, 0.4]))

    def force(self, q, v, t):
        return jnp.array([0.0, -9.81, 0.0])

    def gaps(self, q, t):
        return q[1:2] - 1 - self.rises * t

    def sliding(self, q, v, t):
        return v[:1] - v[2:]

    def initial_state(self):
        return State(q=np.array([0.0, 1.5, 0.0]), v=np.array([self.fast, 0.0, 0.0]))


def _behind(ball, z):
    return compiled(ball).jumps[0](ball.parameters(), z)["v"]


@pytest.mark.parametrize("fast", [3.0, -3.0, 0.1])
def test_an_oblique_impact_slides_or_sticks_by_coulombs_law(fast):
    down, scene = 2.0, _Ball()
    v = np.asarray(_behind(scene, at([0, 1, 0], [fast, -down, 0])))
    # A unit tangential impulse changes the slip by 1 + 1/0.4.
    needed, most = fast / 3.5, 0.2 * 1.5 * down
    p = np.sign(needed) * min(abs(needed), most)
    assert v == pytest.approx([fast - p, 0.5 * down, p / 0.4], abs=1e-14)
    assert abs(needed) > most or v[0] == pytest.approx(v[2], abs=1e-14)


def test_ground_that_moves_gives_its_velocity_to_the_law():
    scene = _Ball(rises=1.0, friction=0.0)
    v = np.asarray(_behind(scene, at([0, 1, 0], [0, -2, 0])))
    assert v == pytest.approx([0, 1 + 0.5 * 3, 0], abs=1e-14)
    step = run(MoreauJean(theta=1.0), scene, Steps(0.001), 0.4)
    k = int(np.argmax(step.notes["impacts 1"] > 0))
    before = step.v[k - 1, 1] - 1
    assert before < -2
    assert step.v[k, 1] - 1 == pytest.approx(-0.5 * before, abs=1e-6)


@dataclass(frozen=True)
class _Bob(ContactSystem):
    """A pendulum in x and y that swings against a wall at x = 0."""

    interval = (0.0, 2.0)
    nominal_step = 0.02
    restitution = 0.6

    def mass(self, q):
        return 2.0 * jnp.eye(2)

    def force(self, q, v, t):
        return jnp.array([0.0, -2.0 * 9.81])

    def constraint(self, q, t):
        return jnp.stack([(q @ q - 1) / 2])

    def gaps(self, q, t):
        return q[:1] + 0.3

    def initial_state(self):
        return State(q=np.array([np.sin(1.0), -np.cos(1.0)]), v=np.zeros(2))


@pytest.mark.long
def test_impacts_keep_to_the_constraints():
    exact = np.sqrt(2 * 9.81 * (np.sqrt(1 - 0.09) - np.cos(1.0)))  # speed at the wall, by energy
    found = run(PHEM56(), _Bob(), Tolerances(1e-10), 1.0)
    first = int(np.argmax(found.phase > 0))
    assert np.linalg.norm(found.v[first - 1]) == pytest.approx(exact, rel=1e-8)
    after = np.linalg.norm(
        run(PHEM56(), _Bob(), Tolerances(1e-10), found.t[first - 1] + 1e-9).v[-1]
    )
    assert after == pytest.approx(0.6 * exact, rel=1e-7)
    stepped = run(MoreauJean(), _Bob(), Steps(1e-3), 1.0)
    k = int(np.argmax(stepped.notes["impacts 1"] > 0))
    assert np.linalg.norm(stepped.v[k]) == pytest.approx(0.6 * exact, rel=5e-3)
    assert np.abs(np.sum(stepped.q * stepped.v, axis=1)).max() < 1e-12


@dataclass(frozen=True)
class _Block(ContactSystem):
    """A block that is dropped on its two lower corners at once; 2 m wide and high, 1 kg."""

    interval = (0.0, 1.0)
    nominal_step = 0.01
    friction = 0.3
    fast: float = parameter(1.0, "m/s", "velocity along the ground")

    def mass(self, q):
        return jnp.diag(jnp.array([1.0, 1.0, 2 / 3]))

    def force(self, q, v, t):
        return jnp.array([0.0, -9.81, 0.0])

    def _corners(self, q):
        cos, sin = jnp.cos(q[2]), jnp.sin(q[2])
        return jnp.stack([q[:2] + jnp.stack([s * cos + sin, s * sin - cos]) for s in (-1, 1)])

    def gaps(self, q, t):
        return self._corners(q)[:, 1]

    def sliding(self, q, v, t):
        return jax.jvp(self._corners, (q,), (v,))[1][:, 0]

    def initial_state(self):
        return State(q=np.array([0.0, 1.0, 0.0]), v=np.array([self.fast, 0.0, 0.0]))


@pytest.mark.long
def test_a_block_slides_to_rest_and_its_redundant_contacts_share_the_load():
    # It slides by v0^2/(2 mu g); its corners carry m g/2 -+ mu m g (height over width of centre)/2.
    found = run(MoreauJean(), _Block(), Steps(0.005))
    way = 1 / (2 * 0.3 * 9.81)
    assert found.status == "ok"
    assert found.q[-1] == pytest.approx([way, 1.0, 0.0], abs=2e-3)
    assert np.abs(found.v[-1]).max() < 1e-8
    loads = np.array([found.notes["impulse 1"], found.notes["impulse 2"]]) / 0.005
    assert loads[:, 20] == pytest.approx([9.81 / 2 * 0.7, 9.81 / 2 * 1.3], rel=1e-3)
    assert loads[:, -1].sum() == pytest.approx(9.81, rel=1e-9)


# ---- time stepping -------------------------------------------------------------------------
def order(sizes, errors):
    return np.polyfit(np.log(sizes), np.log(errors), 1)[0]


def stepped(scene, t_end, coarse, fine, count, **options):
    """Step sizes, and errors of q and v in phases and of times of impact."""
    reference = Reference(scene, t_end)
    numbers = np.unique(np.round(np.geomspace(t_end / coarse, t_end / fine, count)))
    errors = []
    for n in numbers:
        found = run(MoreauJean(**options), scene, Steps(t_end / n), t_end)
        of, events = relative_errors(found, reference).errors, event_errors(found, reference)
        assert events["events"] == events["expected"]
        errors.append([of["q"]["max"], of["v"]["max"], events["time"]])
    return t_end / numbers, np.array(errors)


def test_impacts_of_a_ball_that_accumulate_are_passed_and_it_rests():
    scene, h = BouncingBall(), 1e-3
    zeno = np.sqrt(2 / 9.81) * 1.8 / 0.2
    assert zeno == pytest.approx(4.0637127688716, abs=1e-12)
    found = run(MoreauJean(), scene, Steps(h), 5.0)
    assert found.status == "ok"
    rests = found.t > zeno + 0.2
    assert np.abs(found.v[rests]).max() < 1e-9
    assert found.notes["impulse 1"][rests] == pytest.approx(9.81 * h, rel=1e-6)
    assert np.abs(found.q[rests]).max() < 4 * h
    flying = (found.t > zeno - 0.5) & (found.t < zeno - 0.3)
    assert found.q[flying].max() > 0.01
    assert found.events[-1, 0] == pytest.approx(zeno, abs=0.05)
    k, fast = int(np.argmax(found.notes["impacts 1"] > 0)), np.sqrt(2 * 9.81)
    assert found.notes["impulse 1"][k] == pytest.approx(1.8 * fast, rel=0.01)
    assert found.v[k, 0] / found.v[k - 1, 0] == pytest.approx(-0.8, abs=1e-7)
    # a is the change of v in a step, with the impulses in it
    assert found.a[1:] == pytest.approx(np.diff(found.v, axis=0) / h, abs=1e-9)
    mean = found.notes["impulse 1"][1:] / h - 9.81
    assert found.a[1:, 0] == pytest.approx(mean, abs=1e-9)


@pytest.mark.parametrize("theta", [0.5, *long(1.0)])
def test_the_ball_has_order_one_through_impacts(theta):
    sizes, errors = stepped(BouncingBall(), 2.0, 0.01, 1e-4, 24, theta=theta)
    assert [order(sizes, e) for e in errors.T] == pytest.approx([1, 1, 1], abs=0.2)
    assert errors[-1].min() > 1e-6


@pytest.mark.parametrize("theta", [0.5, 0.7, 1.0])
def test_without_contact_it_is_the_theta_method(theta):
    scene, h = Oscillator(omega=2.0), 0.02
    found = run(MoreauJean(theta=theta), scene, Steps(h), 100 * h)
    rate = np.array([[0, 1], [-4, 0]])
    step = np.linalg.solve(np.eye(2) - h * theta * rate, np.eye(2) + h * (1 - theta) * rate)
    exact = np.linalg.matrix_power(step, 100) @ [found.q[0, 0], found.v[0, 0]]
    assert [found.q[-1, 0], found.v[-1, 0]] == pytest.approx(exact, rel=1e-11)


# ---- a mass against a stop -------------------------------------------------------------------
def impacts_of_stop(scene, t_end):
    """Times of impact and velocities before them, from closed pieces and bracketed roots."""
    w, force, omega = np.sqrt(scene.k / scene.m), scene.amplitude, scene.omega
    part = force / (scene.k - scene.m * omega**2)
    t0, q0, v0, found = 0.0, 0.1, 0.0, []
    while True:
        a = q0 - scene.rest - part * np.cos(omega * t0)
        b = (v0 + part * omega * np.sin(omega * t0)) / w

        def q(t, a=a, b=b, t0=t0):
            free = a * np.cos(w * (t - t0)) + b * np.sin(w * (t - t0))
            return scene.rest + part * np.cos(omega * t) + free

        grid = np.linspace(t0, t_end, 4001)[1:]
        below = np.flatnonzero(q(grid) < 0)
        if not len(below):
            return np.array(found)
        k = below[0]
        t1 = brentq(q, grid[k - 1], grid[k], xtol=1e-15, rtol=1e-14)
        turned = w * (b * np.cos(w * (t1 - t0)) - a * np.sin(w * (t1 - t0)))
        v = turned - part * omega * np.sin(omega * t1)
        found.append((t1, v))
        t0, q0, v0 = t1, 0.0, -scene.restitution * v


def test_the_reference_of_the_stop_has_the_impacts_of_closed_pieces():
    exact = impacts_of_stop(ImpactStop(), 4.0)
    reference = Reference(ImpactStop(), 4.0)
    assert len(exact) == 5
    assert reference.events[:, 0] == pytest.approx(exact[:, 0], abs=1e-13)
    before = reference(reference.events[:, 0], np.arange(5))["v"][:, 0]
    assert before == pytest.approx(exact[:, 1], abs=1e-12)


def test_a_gap_that_an_impact_left_just_closed_has_not_closed_again():
    t, gap = np.arange(4.0), np.array([-2.0, -1.0, 5.0, -3.0])[:, None]
    rates = np.array([1.0, 1.0, 0.0, -8.0])[:, None]
    assert [fall.row for fall in falls(t, gap, rates)] == [3]
    back = np.array([-2.0, -1.0])[:, None], np.array([1.0, -1.0])[:, None]  # a short flight
    assert [fall.row for fall in falls(t[:2], *back)] == [1]


@dataclass(frozen=True)
class _Far(ImpactStop):
    """At its impacts IDA leaves gaps of some 1e-9 m, and then begins with very short steps."""

    omega: float = parameter(4.0, "rad/s", "frequency of the force")

    def initial_state(self):
        return State(q=np.array([0.2]), v=np.zeros(1))


@pytest.mark.long
def test_ida_passes_impacts_that_it_locates_by_its_tolerance():
    found = run(IDA(), _Far(), Tolerances(1e-8))
    assert found.status == "ok"
    assert found.events[:, 0] == pytest.approx(Reference(_Far(), 4.0).events[:, 0], abs=1e-5)


@pytest.mark.long
@pytest.mark.parametrize(
    ("method", "tolerance"), [(PHEM56(), Tolerances(1e-10)), (RadauIIA(), Tolerances(1e-9))]
)
def test_methods_of_two_families_find_the_impacts_of_the_stop(method, tolerance):
    exact = impacts_of_stop(ImpactStop(), 4.0)
    found = run(method, ImpactStop(), tolerance)
    assert found.events[:, 0] == pytest.approx(exact[:, 0], abs=1e-9)


@pytest.mark.long
@pytest.mark.parametrize("theta", [0.5, 1.0])
def test_the_stop_has_order_one_through_impacts(theta):
    sizes, errors = stepped(ImpactStop(), 4.0, 0.005, 2.5e-4, 16, theta=theta)
    assert [order(sizes, e) for e in errors.T] == pytest.approx([1, 1, 1], abs=0.2)


# ---- sliding, then rolling -----------------------------------------------------------------------
@pytest.mark.parametrize(("k", "part"), [(0.4, 2 / 7), (0.5, 1 / 3)])
def test_a_ball_and_a_disc_roll_from_their_known_times_on(k, part):
    scene = SlidingRolling(k=k)
    rolls = part * 2.0 / (0.2 * 9.81)
    reference = Reference(scene, 1.0)
    assert reference.events == pytest.approx(np.array([[rolls, 1]]), abs=1e-13)
    speed = 2.0 / (1 + k)
    assert speed == pytest.approx({0.4: 10 / 7, 0.5: 4 / 3}[k], abs=1e-14)
    assert reference(np.array([1.0]))["v"][0] == pytest.approx([speed, 0, 10 * speed], abs=1e-12)
    for h in (0.01, 0.001):
        found = run(MoreauJean(), scene, Steps(h))
        slip = found.v[:, 0] - 0.1 * found.v[:, 2]
        first = found.t[np.argmax(np.abs(slip) < 1e-9)]
        assert rolls - 1e-12 <= first <= rolls + h
        assert found.v[-1] == pytest.approx([speed, 0, 10 * speed], abs=1e-6)
        assert not len(found.phase)
        assert event_errors(found, reference) == {}


# ---- the woodpecker, by matrix exponentials ----------------------------------------------------
class _Toy:
    """Glocker's woodpecker in NumPy: its equations in each mode, linear, and its laws of impact.

    A mode is (side, slip): the sleeve touches at gap 1 or 2 (0: nowhere), slides up (1), down (-1)
    or sticks (0).
    """

    mass = np.array(
        [
            [4.8e-3, 4.5e-5, 6.75e-5],
            [4.5e-5, 5e-9 + 4.5e-7, 6.75e-7],
            [6.75e-5, 6.75e-7, 7e-7 + 4.5e-3 * 0.015**2],
        ]
    )
    inverse = np.linalg.inv(mass)
    normals = np.array([[0, 0, -0.02], [0, 5.8e-3, 0], [0, -5.8e-3, 0]])
    tangents = np.array([[1, 0.01, 0.015 - 0.0201], [1, 3.1e-3, 0], [1, 3.1e-3, 0]])
    play = np.array([0.01 + 0.015 - 0.0201 - 0.0025, 6e-4, 6e-4])
    mu = 0.3

    def load(self, q):
        c, g = 5.6e-3, 9.81
        twist = c * (q[1] - q[2])
        return np.array([-4.8e-3 * g, -twist - 4.5e-5 * g, twist - 6.75e-5 * g])

    def forces(self, q, mode):
        """Normal and tangential force of the sleeve's contact."""
        side, slip = mode
        if not side:
            return np.zeros(2)
        n, t = self.normals[side], self.tangents[side]
        free = self.inverse @ self.load(q)
        if slip:
            along = self.inverse @ (n - slip * self.mu * t)
            normal = -(n @ free) / (n @ along)
            return np.array([normal, -slip * self.mu * normal])
        both = np.array([n, t])
        return -np.linalg.solve(both @ self.inverse @ both.T, both @ free)

    def rate(self, mode):
        """Matrix of d/dt [q, v, 1]."""

        def a(q):
            pushed = self.forces(q, mode)
            along = np.array([self.normals[mode[0]], self.tangents[mode[0]]]).T @ pushed
            return self.inverse @ (self.load(q) + along)

        matrix, still = np.zeros((7, 7)), a(np.zeros(3))
        matrix[:3, 3:6], matrix[3:6, 6] = np.eye(3), still
        matrix[3:6, :3] = np.array([a(unit) - still for unit in np.eye(3)]).T
        return matrix

    def watched(self, w, mode, opened):
        """Functions that fall through zero at the end of a mode, by the events of the scene."""
        q, v, (side, slip) = w[:3], w[3:6], mode
        gaps = self.play + self.normals @ q
        normal, tangential = self.forces(q, mode)
        found = dict(enumerate(gaps))
        found.pop(side or opened or None, None)
        if side:
            found[3] = normal
            slides = slip * (self.tangents[side] @ v)
            found[4 if slip else 5] = slides if slip else self.mu * normal - abs(tangential)
        return found

    def impact(self, v, closed):
        """Velocities behind an impact and impulses: the one consistent state of all contacts."""
        for states in product(("open", "stick", 1, -1), repeat=len(closed)):
            rows, columns, right = [], [], []
            for k, state in zip(closed, states, strict=True):
                n, t = self.normals[k], self.tangents[k]
                if state == "open":
                    continue
                rows.append(n)
                right.append(-(1.5 if k == 0 else 1.0) * (n @ v))
                if state == "stick":
                    columns += [n, t]
                    rows.append(t)
                    right.append(-t @ v)
                else:
                    columns.append(n - state * self.mu * t)
            p = np.zeros(0)
            after = v
            if rows:
                along = self.inverse @ np.array(columns).T
                p = np.linalg.solve(np.array(rows) @ along, right)
                after = v + along @ p
            good, impulses, used = True, {}, list(p)
            for k, state in zip(closed, states, strict=True):
                n, t = self.normals[k], self.tangents[k]
                e = 0.5 if k == 0 else 0.0
                if state == "open":
                    good &= n @ after + e * (n @ v) >= -1e-12
                    impulses[k] = 0.0
                    continue
                impulses[k] = used.pop(0)
                good &= impulses[k] > 0
                if state == "stick":
                    good &= abs(used.pop(0)) <= self.mu * impulses[k]
                else:
                    good &= state * (t @ after) > 0
            if good:
                return after, impulses
        raise AssertionError("no state is consistent")

    def follow(self, t_end, dt=2e-5):
        """Times and numbers of the events up to t_end in s, and q, v and mode there."""
        q, v = np.array([0, -6e-4 / 5.8e-3, -0.2788]), np.array([-0.3411, 0, -7.4583])
        w, t, mode, opened, events = np.array([*q, *v, 1.0]), 0.0, (1, -1), 0, []
        while True:
            matrix = self.rate(mode)
            step, now, k = scipy.linalg.expm(matrix * dt), w, 0
            while True:
                before, now, k = now, step @ now, k + 1
                values = self.watched(now, mode, 0 if k > 3 else opened)
                fallen = [e for e, value in values.items() if value < 0]
                if fallen or t + k * dt > t_end:
                    break
            if not fallen:
                return events, scipy.linalg.expm(matrix * (t_end - t)) @ w

            def value(s, event, before=before, matrix=matrix, mode=mode):
                return self.watched(scipy.linalg.expm(matrix * s) @ before, mode, 0)[event]

            roots = {e: brentq(value, 0.0, dt, args=(e,), xtol=1e-16) for e in fallen}
            event = min(roots, key=lambda e: roots[e])
            t += (k - 1) * dt + roots[event]
            w = scipy.linalg.expm(matrix * roots[event]) @ before
            mode, opened = self.after(w, mode, event)
            events.append((t, event))

    def after(self, w, mode, event):
        """Mode behind an event, and the gap that has just opened; w is changed in an impact."""
        side, slip = mode
        if event == 3:
            return (0, 0), side
        if event < 3:
            side = event or side
            closed = sorted({event, side} - ({0} if event else set()))
            w[3:6], impulses = self.impact(w[3:6], closed)
            if side and impulses[side] <= 0:
                return (0, 0), side
            slides = self.tangents[side] @ w[3:6]
            slip = int(np.sign(slides)) if abs(slides) > 1e-9 else 0
        elif event == 4:
            slip = 0
        if side and not slip:
            normal, tangential = self.forces(w[:3], (side, 0))
            if event == 5 or abs(tangential) > self.mu * normal:
                slip = -int(np.sign(tangential))
        if side and self.forces(w[:3], (side, slip))[0] <= 0:
            return (0, 0), side
        return (side, slip), 0


@pytest.mark.long
def test_impacts_of_two_contacts_are_those_of_the_only_consistent_state():
    scene, toy, random = Woodpecker(), _Toy(), np.random.default_rng(1)
    at_pole = np.array([0.0, -6e-4 / 5.8e-3, 0.0024 / 0.02])
    v = random.uniform(-1, 1, (2000, 3)) * [0.3, 20, 20]
    v = v[(toy.normals[0] @ v.T < 0) & (toy.normals[1] @ v.T < 0)]
    closed = np.array([True, True, False])
    after, p = jax.jit(jax.vmap(lambda v: impact(scene, at(at_pole, v), closed)))(v)
    left = 0
    for before, found, impulses in zip(v, np.asarray(after), np.asarray(p), strict=True):
        exact, known = toy.impact(before, [0, 1])
        assert found == pytest.approx(exact, abs=1e-10)
        assert impulses[:2] == pytest.approx([known[0], known[1]], abs=1e-14)
        left += known[1] == 0 or known[0] == 0
    assert 0 < left < len(v)


@pytest.mark.long
def test_a_strike_of_the_beak_ends_the_contact_of_the_sleeve():
    scene, toy = Woodpecker(side=1.0), _Toy()
    v = np.array([-0.01, 0.0, 10.0])
    z = at([0.0, -6e-4 / 5.8e-3, 0.12], v)
    new = compiled(scene).jumps[0](scene.parameters(), z)
    exact, impulses = toy.impact(v, [0, 1])
    assert impulses[1] == 0
    assert new["v"] == pytest.approx(exact, abs=1e-10)
    assert (new["side"], new["slides"]) == (0, 2)


@pytest.fixture(scope="module")
def toy():
    return _Toy().follow(0.3)


@pytest.mark.long
def test_the_reference_of_the_woodpecker_is_that_of_matrix_exponentials(toy):
    events, end = toy
    reference = Reference(Woodpecker(), 0.3)
    assert [int(e) for e in reference.events[:, 1]] == [e for _, e in events]
    assert reference.events[:, 0] == pytest.approx([t for t, _ in events], abs=1e-10)
    known = reference(np.array([0.3]))
    assert known["q"][0] == pytest.approx(end[:3], abs=1e-9)
    assert known["v"][0] == pytest.approx(end[3:6], abs=1e-7)


@pytest.mark.long
def test_methods_follow_the_woodpecker(toy):
    events, end = toy
    located = run(PHEM56(), Woodpecker(), Tolerances(1e-8))
    assert located.events[:, 0] == pytest.approx([t for t, _ in events], abs=1e-7)
    assert located.q[-1] == pytest.approx(end[:3], abs=1e-6)
    errors = []
    for h in (4e-5, 1e-5, 2.5e-6):
        passed = run(MoreauJean(), Woodpecker(), Steps(h))
        assert passed.status == "ok"
        errors.append(np.abs(passed.q[-1] - end[:3]).max())
    assert errors[0] > 2 * errors[-1]
    assert errors[-1] < 1e-3


# ---- what is refused ---------------------------------------------------------------------------
def _only(name, **blocks):
    """A scene that states these blocks beside those of a ball, without those of its base."""
    own = {block: getattr(_Ball, block) for block in ("mass", "force", "initial_state")}
    numbers = {"fast": 1.0, "__module__": __name__, "interval": (0.0, 1.0), "nominal_step": 0.1}
    return dataclass(frozen=True)(type(name, (MechatronicSystem,), own | numbers | blocks))()


def _sample(self, z):
    return {}


@pytest.mark.parametrize(
    ("scene", "words"),
    [
        (_only("Loose", gaps=_Ball.gaps), "states gaps but not events"),
        (_only("Slippery", sliding=_Ball.sliding), "states sliding but not gaps"),
        (
            type("Sampled", (_Ball,), {"sample": _sample, "sample_time": 0.1})(),
            "ends no step at a sample",
        ),
    ],
)
def test_scenes_that_would_be_wrong_are_refused(scene, words):
    with pytest.raises(SpecError, match=words):
        MoreauJean().prepare(scene, 1.0, Steps(0.1))


@dataclass(frozen=True)
class _Soft(BouncingBall):
    """A ball that stays on the ground, which events cannot tell."""

    e: float = parameter(0.0, "1", "restitution")


def test_events_that_end_in_rest_name_the_method_that_goes_on():
    found = run(StormerVerlet(), _Soft(), Steps(0.05))
    assert found.status == "step_too_small"
    assert "contact that lasts is no event: take moreau_jean" in found.message
    rests = run(MoreauJean(), _Soft(), Steps(0.01))
    assert rests.status == "ok"
    assert abs(rests.q[-1, 0]) < 0.05


def test_a_run_says_what_its_accelerations_are(without_processes):
    asked = ["solve", "impact_stop", "moreau_jean", "--step", "0.002", "--json"]
    found = json.loads(CliRunner().invoke(main, asked).stdout)
    assert found["events"]["events"] == found["events"]["expected"] == 5
    assert found["errors"]["q"]["max"] < 0.1 < found["errors"]["a"]["max"]
    assert "in a step with an impact they hold its impulse" in found["message"]


@pytest.mark.long
def test_the_scene_of_the_docs_rolls_after_its_first_impact(tmp_path):
    text = (Path(__file__).parents[1] / "docs/jumps.md").read_text(encoding="utf-8")
    code = next(b for b in re.findall(r"```python\n(.*?)```", text, re.DOTALL) if "Contact" in b)
    (tmp_path / "disc.py").write_text(code, encoding="utf-8")
    registry = Registry([tmp_path / "disc.py"])
    checked = CliRunner().invoke(main, ["check", str(tmp_path / "disc.py")])
    assert checked.exit_code == 0, checked.output
    for method, step in ((StormerVerlet(), 0.02), (MoreauJean(), 0.001)):
        found = run(method, registry.problem("disc"), Steps(step))
        assert found.v[-1, [0, 2]] == pytest.approx([2.0, 2.0], abs=1e-7)
