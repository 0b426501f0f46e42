"""The woodpecker of Glocker: its laws of impact, and its motion by matrix exponentials."""

import numpy as np
import pytest
from test_contact import at, run

from integrators.methods.half_explicit import PHEM56
from integrators.methods.moreau_jean import MoreauJean
from integrators.resolutions import Steps, Tolerances
from problems import jax
from problems.equations.compiled import compiled
from problems.hybrid.contact import impact
from problems.scenes.woodpecker import Woodpecker
from problems.truth.reference import Reference

#: Times in s and numbers of the events, and q and v at 0.3 s. They come from a program of its own:
#: in each mode (free, sliding up or down, sticking) the equations are linear and solved by matrix
#: exponentials, events by roots along these, impacts by trying all states of the contacts.
EVENTS = [
    (0.0216363140533, 4), (0.06121393124796, 5), (0.06702339814452, 3), (0.07787799228972, 2),
    (0.08098880541865, 0), (0.08157532878961, 2), (0.08341638557912, 3), (0.1186751129488, 1),
    (0.121335470558, 1), (0.1673895228689, 4), (0.2069998485134, 5), (0.2128300801442, 3),
    (0.2237486439196, 2), (0.2268414940274, 0), (0.2274148036665, 2), (0.2292814198345, 3),
    (0.264594986865, 1), (0.2673808905119, 1),
]  # fmt: skip
Q, V = (
    [-0.04132741608342, -0.1034482758621, -0.342373855108],
    [-0.2591849226044, 0, -8.342824143717],
)


@pytest.mark.long
def test_impacts_of_two_contacts_obey_newtons_and_coulombs_laws():
    scene, random = Woodpecker(), np.random.default_rng(1)
    place = np.array([0.0, -6e-4 / 5.8e-3, 0.0024 / 0.02])
    mass = np.asarray(scene.mass(place))
    normals = np.array([[0, 0, -0.02], [0, 5.8e-3, 0]])
    tangents = np.array([[1, 0.01, 0.015 - 0.0201], [1, 3.1e-3, 0]])
    v = random.uniform(-1, 1, (2000, 3)) * [0.3, 20, 20]
    v = v[(normals @ v.T < 0).all(axis=0)]
    closed = np.array([True, True, False])
    after, p = map(np.asarray, jax.jit(jax.vmap(lambda v: impact(scene, at(place, v), closed)))(v))
    push, rub = p[:, :2], p[:, 3:5]
    assert (after - v) @ mass == pytest.approx(push @ normals + rub @ tangents, abs=1e-12)
    parts = after @ normals.T + [0.5, 0.0] * (v @ normals.T)  # u' + e u
    slip = after @ tangents.T
    assert push.min() > -1e-30
    assert parts.min() > -1e-10
    assert np.abs(push * parts).max() < 1e-13
    assert (np.abs(rub) <= 0.3 * push + 1e-15).all()
    slides = np.abs(slip) > 1e-9
    assert rub[slides] == pytest.approx((-0.3 * push * np.sign(slip))[slides], abs=1e-14)
    assert (push < 1e-30).any()
    assert (push > 1e-30).all(axis=1).any()
    assert slides.any()
    assert not slides.all()

    # A strike of the beak ends the contact of the sleeve.
    v = np.array([-0.01, 0.0, 10.0])
    after, p = impact(scene, at(place, v), closed)
    assert abs(p[1]) < 1e-30
    struck = Woodpecker(side=1.0)
    new = compiled(struck).jumps[0](struck.parameters(), at(place, v))
    assert new["v"] == pytest.approx(np.asarray(after), abs=1e-10)
    assert (new["side"], new["slides"]) == (0, 2)


@pytest.mark.long
def test_the_reference_and_methods_follow_the_woodpecker():
    times, reference = [t for t, _ in EVENTS], Reference(Woodpecker(), 0.3)
    assert [int(e) for e in reference.events[:, 1]] == [e for _, e in EVENTS]
    assert reference.events[:, 0] == pytest.approx(times, abs=1e-10)
    last = reference(np.array([0.3]))
    assert last["q"][0] == pytest.approx(Q, abs=1e-9)
    assert last["v"][0] == pytest.approx(V, abs=1e-7)
    located = run(PHEM56(), Woodpecker(), Tolerances(1e-8))
    assert located.events[:, 0] == pytest.approx(times, abs=1e-7)
    assert located.q[-1] == pytest.approx(Q, abs=1e-6)
    errors = []
    for h in (4e-5, 1e-5, 2.5e-6):
        passed = run(MoreauJean(), Woodpecker(), Steps(h))
        assert passed.status == "ok"
        errors.append(np.abs(passed.q[-1] - Q).max())
    assert errors[0] > 2 * errors[-1]
    assert errors[-1] < 1e-3
