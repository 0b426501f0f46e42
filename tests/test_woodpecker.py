"""The woodpecker of Glocker: its scene and methods, beside matrix exponentials of its pieces."""

from itertools import product

import numpy as np
import pytest
import scipy.linalg
from scipy.optimize import brentq
from test_contact import at, run

from integrators.methods.half_explicit import PHEM56
from integrators.methods.moreau_jean import MoreauJean
from integrators.resolutions import Steps, Tolerances
from problems import jax
from problems.equations.compiled import compiled
from problems.hybrid.contact import impact
from problems.scenes.woodpecker import Woodpecker
from problems.truth.reference import Reference


# ---- the woodpecker, by matrix exponentials ----------------------------------------------------
class _Toy:
    """Glocker's woodpecker in NumPy: its equations in each mode, linear, and its laws of impact.

    A mode is (side, slip): the sleeve touches at gap 1 or 2 (0: nowhere), slides up (1), down (-1)
    or sticks (0).
    """

    mass = np.array([[4.8e-3, 4.5e-5, 6.75e-5], [4.5e-5, 5e-9 + 4.5e-7, 6.75e-7],
                     [6.75e-5, 6.75e-7, 7e-7 + 4.5e-3 * 0.015**2]])  # fmt: skip
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

    # A strike of the beak ends the contact of the sleeve.
    v = np.array([-0.01, 0.0, 10.0])
    struck = Woodpecker(side=1.0)
    new = compiled(struck).jumps[0](struck.parameters(), at([0.0, -6e-4 / 5.8e-3, 0.12], v))
    exact, impulses = toy.impact(v, [0, 1])
    assert impulses[1] == 0
    assert new["v"] == pytest.approx(exact, abs=1e-10)
    assert (new["side"], new["slides"]) == (0, 2)


@pytest.mark.long
def test_the_reference_and_methods_follow_the_woodpecker():
    events, end = _Toy().follow(0.3)
    times, reference = [t for t, _ in events], Reference(Woodpecker(), 0.3)
    assert [int(e) for e in reference.events[:, 1]] == [e for _, e in events]
    assert reference.events[:, 0] == pytest.approx(times, abs=1e-10)
    last = reference(np.array([0.3]))
    assert last["q"][0] == pytest.approx(end[:3], abs=1e-9)
    assert last["v"][0] == pytest.approx(end[3:6], abs=1e-7)
    located = run(PHEM56(), Woodpecker(), Tolerances(1e-8))
    assert located.events[:, 0] == pytest.approx(times, abs=1e-7)
    assert located.q[-1] == pytest.approx(end[:3], abs=1e-6)
    errors = []
    for h in (4e-5, 1e-5, 2.5e-6):
        passed = run(MoreauJean(), Woodpecker(), Steps(h))
        assert passed.status == "ok"
        errors.append(np.abs(passed.q[-1] - end[:3]).max())
    assert errors[0] > 2 * errors[-1]
    assert errors[-1] < 1e-3
