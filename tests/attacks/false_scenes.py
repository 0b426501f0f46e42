"""Scenes that give one false answer each; test_answers.py names this as a plugin file."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from false_methods import NAN

from problems import State, jnp
from problems.scenes.oscillators import Oscillator


def closed(change):
    """A closed form that is changed."""
    return {"exact": lambda self, t: change(Oscillator.exact(self, t))}


def begun(value):
    """Another initial state."""
    return {"initial_state": lambda self: value}


def drawn(value):
    """Another picture."""
    return {"draw": lambda self, q: value}


LINE = np.zeros((2, 2))

START = "initial_state() is None, expected State(q, v), or State("
REAL = "an array of float64 of shape"
#: By name of the scene's class: what it states, the check that fails, and words of its sentence.
SCENES = {
    "Nan": (closed(lambda z: z | {"q": z["q"] * NAN}), "reference",
            "exact()['q'][0, 0] is nan, expected finite numbers"),
    "ExactLess": (closed(lambda z: {"q": z["q"]}), "reference", "exact() leaves out v, a"),
    "ExactMore": (closed(lambda z: z | {"speed": z["v"]}), "reference",
                  "a group of exact() is 'speed', expected one of q, v, a"),
    "DrawNan": (drawn([LINE * NAN]), "reference", "line 0 of draw()[0, 0] is nan, expected finite"),
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
