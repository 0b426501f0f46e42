"""Contact: impacts as events and within steps, friction and rest, judged by closed forms."""

import json
import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from helpers import cell_of, long, slope, toy

from bench.plugins.registry import Registry
from bench.running.errors import event_errors, relative_errors
from bench.running.measure import end_at_overlap
from bench.running.worker import Worker
from integrators.methods.half_explicit import PHEM56
from integrators.methods.moreau_jean import MoreauJean
from integrators.methods.symplectic import StormerVerlet
from integrators.resolutions import Steps, Tolerances
from problems import ContactSystem, Variables, jax, jnp, parameter
from problems.base.spec import SpecError
from problems.equations.compiled import compiled
from problems.scenes.contacts import BouncingBall
from problems.scenes.oscillators import Oscillator
from problems.truth.reference import Reference


def run(method, scene, resolution, t_end=None):
    return method.prepare(scene, t_end or scene.interval[1], resolution).measure()


def at(q, v):
    """All variables of a scene without constraints and controllers."""
    q, v, none = (jnp.asarray(part, dtype=float) for part in (q, v, ()))
    return Variables(q, v, 0 * v, none, none, none, jnp.zeros(()))


def contact(name, q, **blocks):
    """A scene of contacts of unit masses that starts at rest, or with the velocity ``fast``."""
    free = toy(q=q)

    def start(self):
        v = [getattr(self, "fast", 0.0), *np.zeros(len(q) - 1)]
        return free().initial_state()._replace(v=np.array(v))

    known = {"initial_state": start, "nominal_step": 0.02, "mass": free.mass}
    return toy(name, base=ContactSystem, **(known | blocks))


# ---- laws of impact ----------------------------------------------------------------------
#: A ball with spin on ground that rises: x, y, angle; radius and mass are 1.
BALL = {
    "mass": lambda self, q: jnp.diag(jnp.array([1.0, 1.0, 0.4])),
    "force": lambda self, q, v, t: jnp.array([0.0, -9.81, 0.0]),
    "gaps": lambda self, q, t: q[1:2] - 1 - self.rises * t,
    "sliding": lambda self, q, v, t: v[:1] - v[2:],
}
Ball = contact(
    "Ball", [0.0, 1.5, 0.0], interval=(0.0, 2.0),
    restitution=parameter(0.5, "1", "restitution", low=0.0, high=1.0),
    friction=parameter(0.2, "1", "friction", low=0.0),
    rises=parameter(0.0, "m/s", "velocity of the ground"),
    fast=parameter(3.0, "m/s", "velocity along the ground"), **BALL,
)  # fmt: skip


def behind(ball, v):
    """Velocities after an impact at the ground."""
    return np.asarray(compiled(ball).jumps[0](ball.parameters(), at([0, 1, 0], v))["v"])


def test_an_oblique_impact_slides_or_sticks_by_coulombs_law_also_on_ground_that_moves():
    for fast in [3.0, -3.0, 0.1]:
        v = behind(Ball(), [fast, -2.0, 0])
        # A unit tangential impulse changes the slip by 1 + 1/0.4.
        needed, most = fast / 3.5, 0.2 * 1.5 * 2.0
        p = np.sign(needed) * min(abs(needed), most)
        assert v == pytest.approx([fast - p, 0.5 * 2.0, p / 0.4], abs=1e-14)
        assert abs(needed) > most or v[0] == pytest.approx(v[2], abs=1e-14)
    scene = Ball(rises=1.0, friction=0.0)
    assert behind(scene, [0, -2, 0]) == pytest.approx([0, 1 + 0.5 * 3, 0], abs=1e-14)
    step = run(MoreauJean(theta=1.0), scene, Steps(0.001), 0.4)
    k = int(np.argmax(step.notes["impacts 1"] > 0))
    before = step.v[k - 1, 1] - 1
    assert before < -2
    assert step.v[k, 1] - 1 == pytest.approx(-0.5 * before, abs=1e-6)


#: A pendulum in x and y that swings against a wall at x = -0.3.
Bob = contact(
    "Bob", [np.sin(1.0), -np.cos(1.0)], interval=(0.0, 2.0), restitution=0.6,
    mass=lambda self, q: 2.0 * jnp.eye(2), gaps=lambda self, q, t: q[:1] + 0.3,
    force=lambda self, q, v, t: jnp.array([0.0, -2.0 * 9.81]),
    constraint=lambda self, q, t: jnp.stack([(q @ q - 1) / 2]),
)  # fmt: skip


@pytest.mark.long
def test_impacts_keep_to_the_constraints():
    exact = np.sqrt(2 * 9.81 * (np.sqrt(1 - 0.09) - np.cos(1.0)))  # speed at the wall, by energy
    found = run(PHEM56(), Bob(), Tolerances(1e-10), 1.0)
    first = int(np.argmax(found.phase > 0))
    assert np.linalg.norm(found.v[first - 1]) == pytest.approx(exact, rel=1e-8)
    after = run(PHEM56(), Bob(), Tolerances(1e-10), found.t[first - 1] + 1e-9).v[-1]
    assert np.linalg.norm(after) == pytest.approx(0.6 * exact, rel=1e-7)
    stepped = run(MoreauJean(), Bob(), Steps(1e-3), 1.0)
    k = int(np.argmax(stepped.notes["impacts 1"] > 0))
    assert np.linalg.norm(stepped.v[k]) == pytest.approx(0.6 * exact, rel=5e-3)
    assert np.abs(np.sum(stepped.q * stepped.v, axis=1)).max() < 1e-12


def corners(q):
    """The lower corners of a block that is 2 m wide and high."""
    cos, sin = jnp.cos(q[2]), jnp.sin(q[2])
    return jnp.stack([q[:2] + jnp.stack([s * cos + sin, s * sin - cos]) for s in (-1, 1)])


#: A block that is dropped on its two lower corners at once; 1 kg.
Block = contact(
    "Block", [0.0, 1.0, 0.0], friction=0.3,
    fast=parameter(1.0, "m/s", "velocity along the ground"),
    mass=lambda self, q: jnp.diag(jnp.array([1.0, 1.0, 2 / 3])), force=BALL["force"],
    gaps=lambda self, q, t: corners(q)[:, 1],
    sliding=lambda self, q, v, t: jax.jvp(corners, (q,), (v,))[1][:, 0],
)  # fmt: skip


@pytest.mark.long
def test_a_block_slides_to_rest_and_its_redundant_contacts_share_the_load():
    # It slides by v0^2/(2 mu g); its corners carry m g/2 -+ mu m g (height over width of centre)/2.
    found = run(MoreauJean(), Block(), Steps(0.005))
    way = 1 / (2 * 0.3 * 9.81)
    assert found.status == "ok"
    assert found.q[-1] == pytest.approx([way, 1.0, 0.0], abs=2e-3)
    assert np.abs(found.v[-1]).max() < 1e-8
    loads = np.array([found.notes["impulse 1"], found.notes["impulse 2"]]) / 0.005
    assert loads[:, 20] == pytest.approx([9.81 / 2 * 0.7, 9.81 / 2 * 1.3], rel=1e-3)
    assert loads[:, -1].sum() == pytest.approx(9.81, rel=1e-9)


# ---- time stepping -------------------------------------------------------------------------
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


def order(sizes, errors):
    return slope([*sizes], [*errors])


def stepped(scene, t_end, coarse, fine, count, **options):
    """Step sizes, and errors of q and v in phases and of times of impact."""
    reference, errors = Reference(scene, t_end), []
    numbers = np.unique(np.round(np.geomspace(t_end / coarse, t_end / fine, count)))
    for n in numbers:
        found = run(MoreauJean(**options), scene, Steps(t_end / n), t_end)
        of, events = relative_errors(found, reference).errors, event_errors(found, reference)
        assert events["events"] == events["expected"]
        errors.append([of["q"]["max"], of["v"]["max"], events["time"]])
    return t_end / numbers, np.array(errors)


@pytest.mark.parametrize("theta", [0.5, *long(1.0)])
def test_the_ball_has_order_one_through_impacts(theta):
    sizes, errors = stepped(BouncingBall(), 2.0, 0.01, 1e-4, 24, theta=theta)
    assert [order(sizes, e) for e in errors.T] == pytest.approx([1, 1, 1], abs=0.2)
    assert errors[-1].min() > 1e-6


def test_without_contact_it_is_the_theta_method():
    for theta in [0.5, 0.7, 1.0]:
        scene, h = Oscillator(omega=2.0), 0.02
        found = run(MoreauJean(theta=theta), scene, Steps(h), 100 * h)
        rate = np.array([[0, 1], [-4, 0]])
        step = np.linalg.solve(np.eye(2) - h * theta * rate, np.eye(2) + h * (1 - theta) * rate)
        exact = np.linalg.matrix_power(step, 100) @ [found.q[0, 0], found.v[0, 0]]
        assert [found.q[-1, 0], found.v[-1, 0]] == pytest.approx(exact, rel=1e-11)


# ---- what is refused ---------------------------------------------------------------------------
def test_scenes_that_would_be_wrong_are_refused():
    sampled = {"sample": lambda self, z: {}, "sample_time": 0.1}
    for scene, words in [
        (toy("Loose", **{"force": Oscillator.force, "gaps": BALL["gaps"]})(),
         "states gaps but not events"),
        (toy("Slippery", **{"force": Oscillator.force, "sliding": BALL["sliding"]})(),
         "states sliding but not gaps"),
        (toy("Sampled", base=Ball, **sampled)(), "ends no step at a sample"),
    ]:  # fmt: skip
        with pytest.raises(SpecError, match=words):
            MoreauJean().prepare(scene, 1.0, Steps(0.1))


def test_events_that_end_in_rest_name_the_method_that_goes_on():
    soft = BouncingBall(e=0.0)  # it stays on the ground, which events cannot tell
    found = run(StormerVerlet(), soft, Steps(0.05))
    assert found.status == "step_too_small"
    assert "contact that lasts is no event; take moreau_jean" in found.message
    rests = run(MoreauJean(), soft, Steps(0.01))
    assert rests.status == "ok"
    assert abs(rests.q[-1, 0]) < 0.05


@dataclass(frozen=True)
class Through(StormerVerlet):
    """A method that claims to pass impacts, and knows none."""

    passes_impacts = True


def test_no_run_is_ok_whose_bodies_overlap():
    fallen = run(Through(), BouncingBall(), Steps(0.05))
    assert fallen.q[-1, 0] < -18  # free fall
    kept = replace(fallen, t=fallen.t[:10], q=fallen.q[:10])  # up to t = 0.45 s: it has not hit
    assert end_at_overlap(kept, BouncingBall(), False) == ""
    assert kept.status == "ok"
    for passes, first in ((False, 0.5), (True, 0.6)):  # twice a step's way: 0.56 m
        found = replace(fallen)
        assert end_at_overlap(found, BouncingBall(), passes) == ""
        assert found.status == "diverged"
        assert f"Bodies overlap: at t={first} s" in found.message
        assert found.t[-1] == pytest.approx(first - 0.05)
    rests = np.where(np.arange(10) < 5, 1.0, -5e-4 - 1e-6 * np.arange(10))[:, None]
    assert "by up to 0.00051, as" in end_at_overlap(replace(kept, q=rests), BouncingBall(), True)
    # A worker notes how far steps pass impacts.
    asked = cell_of(Registry(), "bouncing_ball", "moreau_jean", 2.0, Steps(0.05))
    record = Worker(Registry()).measure(asked, errors=False).record
    assert record.status == "ok"
    assert "Bodies overlap by up to 0.015, as steps pass impacts." in record.message


def test_a_run_says_what_its_accelerations_are(without_processes, stepbench):
    asked = ["solve", "impact_stop", "moreau_jean", "--step", "0.002", "--json"]
    found = json.loads(stepbench(*asked).stdout)
    assert found["events"]["events"] == found["events"]["expected"] == 5
    assert found["errors"]["q"]["max"] < 0.1 < found["errors"]["a"]["max"]
    assert "in a step with an impact they hold its impulse" in found["message"]


@pytest.mark.long
def test_the_scene_of_the_docs_rolls_after_its_first_impact(stepbench, tmp_path):
    text = (Path(__file__).parents[1] / "docs/jumps.md").read_text(encoding="utf-8")
    code = next(b for b in re.findall(r"```python\n(.*?)```", text, re.DOTALL) if "Contact" in b)
    (tmp_path / "disc.py").write_text(code, encoding="utf-8")
    registry = Registry([tmp_path / "disc.py"])
    checked = stepbench("check", tmp_path / "disc.py")
    assert checked.exit_code == 0, checked.output
    for method, step in ((StormerVerlet(), 0.02), (MoreauJean(), 0.001)):
        found = run(method, registry.problem("disc"), Steps(step))
        assert found.v[-1, [0, 2]] == pytest.approx([2.0, 2.0], abs=1e-7)
