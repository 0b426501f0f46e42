"""Integrators and scenes with one false answer each; a plugin file of test_answers.py."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from integrators import Integrator, PreparedRun, Trajectory, Work, option
from problems import State, jnp
from problems.scenes.oscillators import Oscillator

ROWS = 6


def honest(scene, t_end):
    """Rows of zeros at `ROWS` times, as an integrator may answer."""
    t = np.linspace(scene.interval[0], t_end, ROWS)
    groups = ("q", "v", "a", "lam", "x", "xdot", "y")
    rows = {group: np.zeros((ROWS, scene.sizes.of(group))) for group in groups}
    work = Work(steps=ROWS - 1, residuals=ROWS - 1)
    return Trajectory(t, **rows, work=work, notes={"h": np.full(ROWS, 0.1)})


def put(**parts):
    return lambda run: replace(run, **parts)


def count(**counts):
    return lambda run: replace(run, work=replace(run.work, **counts))


def moved(group, change):
    return lambda run: replace(run, **{group: change(getattr(run, group))})


def with_time(k, value):
    return moved("t", lambda t: np.where(np.arange(ROWS) == k, value, t))


NAN = float("nan")

#: By name, a change of an honest trajectory, and words of the sentence on it.
TRAJECTORIES = {
    "no_trajectory": (lambda run: None, "measure() is None, expected a Trajectory"),
    "t_nan": (with_time(2, NAN), "t[2] is nan, expected finite numbers"),
    "t_repeated": (moved("t", lambda t: t[[0, 1, 1, 3, 4, 5]]), "expected a time after t[1]"),
    "t_early": (moved("t", lambda t: t - 1.0), ", expected the start of the interval"),
    "t_beyond": (with_time(5, 1e3), "expected no time after the end"),
    "no_rows": (
        lambda run: replace(Trajectory.failed("ok", ""), work=run.work),
        "t has no times, expected those of all rows of a run that is ok",
    ),
    "q_turned": (moved("q", np.transpose), "expected real numbers of shape (6, 1); it is transpo"),
    "q_complex": (moved("q", lambda q: q + 1j), "q is an array of complex128 of shape (6, 1)"),
    "status_unknown": (put(status="great"), "status is 'great', expected one of ok, newton_failed"),
    "message_empty": (
        put(status="diverged", message=" "),
        "message is ' ', expected text that is not empty",
    ),
    "work_none": (put(work=None), "work is None, expected a Work"),
    "steps_half": (count(steps=2.5), "work.steps is 2.5, expected a whole number from 0"),
    "notes_short": (put(notes={"h": np.zeros(5)}), "notes['h'] is an array of float64 of shape (5"),
}
#: By name, a fact, its false value, and words of the sentence on it.
FACTS = {
    "orders_half": ("orders", {"q": 1.5}, "orders['q'] is 1.5, expected a whole number"),
    "orders_group": ("orders", {"p": 2}, "a group of orders is 'p', expected one of q, v, a"),
    "family_raises": ("family", KeyError("x"), "KeyError: 'x'"),
    "controls_unknown": ("controls", "order", "controls is 'order', expected one of step, toler"),
}
#: By name, an answer of `supports`, and words of the sentence on it.
SUPPORTS = {
    "supports_true": (True, "supports() is True, expected None, or the reason in a sentence")
}
#: By name, a bill, and words of the sentence on it.
BILLS = {
    "bill_negative": ({"solves": -1}, "bill()['solves'] is -1, expected a number that is n"),
    "bill_part": ({"coffee": 1.0}, "a part of bill() is 'coffee', expected one of residuals"),
}
#: By name, an answer that is turned into our own types.
MENDED = {
    "numpy_counts": count(steps=np.int64(5), residuals=np.float64(5.0), solves=np.array(5)),
    "single_rows": moved("q", lambda q: q.astype(np.float32)),
    "jax_rows": lambda run: replace(run, q=jnp.asarray(run.q), t=jnp.asarray(run.t)),
    "nan_notes": put(notes={"h": [NAN, np.inf, -np.inf, 1, 2, 3]}),
    "nan_rows_of_a_failure": lambda run: replace(
        run, status="diverged", message="Late.", q=np.where(run.t[:, None] > 1, NAN, run.q)
    ),
    "times_of_a_failure_repeated": lambda run: replace(
        run, status="step_too_small", message="Late.", t=run.t[[0, 1, 2, 3, 4, 4]]
    ),
    "nan_rows": lambda run: replace(run, q=np.full((ROWS, 1), NAN)),
    "half_of_the_interval": moved("t", lambda t: t / 2),
}


class Run(PreparedRun):
    """A run that answers as it is told."""

    def __init__(self, how, scene, t_end):
        self.how, self.scene, self.t_end = how, scene, t_end

    def measure(self):
        run = honest(self.scene, self.t_end)
        if self.how == "raises_much":
            raise ValueError("x" * 10**6)
        change, *_ = TRAJECTORIES.get(self.how) or (MENDED.get(self.how, lambda run: run),)
        return change(run)

    def execute(self):
        return None

    def bill(self, run):
        return BILLS[self.how][0] if self.how in BILLS else {"solves": 1.0}


def fact(name, otherwise):
    """A property that answers falsely where it is told."""

    def answer(self):
        which, value, _ = FACTS.get(self.how, (None, None, ""))
        if which == name and isinstance(value, Exception):
            raise value
        return value if which == name else otherwise

    return property(answer)


@dataclass(frozen=True)
class Lying(Integrator):
    """An integrator with one false answer."""

    how: str = option("not at all", "what is false", always=True)

    orders = fact("orders", {"q": 1})
    source = fact("source", "")
    formulation = fact("formulation", "ode")
    family = fact("family", "liars")
    affinity = fact("affinity", "lying")
    controls = fact("controls", "step")

    def supports(self, scene):
        return SUPPORTS[self.how][0] if self.how in SUPPORTS else None

    def prepare(self, scene, t_end, resolution):
        return None if self.how == "prepares_none" else Run(self.how, scene, t_end)


# ---- scenes ---------------------------------------------------------------------------------
def closed(change):
    return {"exact": lambda self, t: change(Oscillator.exact(self, t))}


def begun(value):
    return {"initial_state": lambda self: value}


START = "initial_state() is None, expected State(q, v), or State("
REAL = "an array of float64 of shape"
#: By name of the scene's class: what it states, the check that fails, and words of its sentence.
SCENES = {
    "Nan": (closed(lambda z: z | {"q": z["q"] * NAN}), "reference",
            "exact()['q'][0, 0] is nan, expected finite numbers"),
    "ExactLess": (closed(lambda z: {"q": z["q"]}), "reference", "exact() leaves out v, a"),
    "ExactMore": (closed(lambda z: z | {"speed": z["v"]}), "reference",
                  "a name in exact() is 'speed', expected one of q, v, a"),
    "DrawNan": ({"draw": lambda self, q: [NAN * np.zeros((2, 2))]}, "reference",
                "line 0 of draw()[0, 0] is nan, expected finite"),
    "EnergyVector": ({"energy": lambda self, q, v: jnp.stack([q, v])}, "conserved", "energy() is "),
    "EnergyNan": ({"energy": lambda self, q, v: NAN * (q @ v)}, "conserved",
                  "energy() is Array(nan, dty"),
    "TagsOfNumbers": ({"tags": (1, 2)}, "description", "tags[0] is 1, expected text"),
    "Numbered": ({"coordinates": (1,)}, "description", "names of q[0] is 1, expected text"),
    "Unsized": ({"coordinates": ("q [m] ~ big",)}, "description",
                "a component is 'q [m] ~ big', expected positive numbers after '~'"),
}  # fmt: skip
#: The same for faults that leave no run possible.
STARTS = {
    "StartNone": (begun(None), "start", START),
    "StartNan": (begun(State(np.array([NAN]), np.zeros(1))), "start",
                 "q of initial_state()[0] is nan, expected finite numbers"),
    "StartLong": (begun(State(np.zeros(1), np.zeros(2))), "start",
                  f"v = dq/dt of initial_state() is {REAL} (2,), expected real numbers"),
}  # fmt: skip
#: By name of the class: its interval or step, and words of the reason why it cannot be used.
TIMES = {
    "StepZero": ({"nominal_step": 0.0}, "nominal_step is 0.0, expected a positive number"),
    "IntervalTurned": ({"interval": (1, 0)}, "interval is (1.0, 0.0), expected a start in s, and"),
    "IntervalOne": ({"interval": 3.0}, "interval is 3.0, expected real numbers of shape (2"),
}


def scene_class(name, stated):
    """A scene that differs from an oscillator in what is stated."""
    doc = {"__doc__": "A scene with a false answer.", "__module__": __name__}
    return dataclass(frozen=True)(type(name, (Oscillator,), doc | stated))


for _name, (_stated, *_) in (SCENES | STARTS | TIMES).items():
    globals()[_name] = scene_class(_name, _stated)
#: Not false: they are turned into our own types.
NumpyStep = scene_class("NumpyStep", {"nominal_step": np.float64(0.1), "tags": "smooth"})
