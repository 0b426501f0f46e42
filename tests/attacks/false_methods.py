"""Integrators that give one false answer each; test_answers.py names this as a plugin file."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from integrators import Integrator, PreparedRun, Trajectory, Work, option
from problems import jnp

ROWS = 6


class Explosive:
    """A value of which every question raises an exception that cannot be shown."""

    def __getattr__(self, name):
        raise Unspeakable

    def __repr__(self):
        raise Unspeakable

    def __array__(self, *_):
        raise Unspeakable

    def __eq__(self, other):
        raise Unspeakable

    __hash__ = object.__hash__


class Unspeakable(Exception):
    """Its text raises an exception."""

    def __str__(self):
        raise RecursionError("no words")


class Untouchable(BaseException):
    """Not an Exception."""


class Mined(Trajectory):
    """A trajectory whose velocities exit when they are read."""

    @property
    def v(self):
        raise SystemExit(3)

    @v.setter
    def v(self, value):
        pass


class MinedWork(Work):
    """Counts that cannot be read."""

    @property
    def newton(self):
        raise Unspeakable

    @newton.setter
    def newton(self, value):
        pass


class Shouting(str):
    """A text that is another one when it is asked for it."""

    def __str__(self):
        raise Unspeakable


def honest(scene, t_end):
    """Rows of zeros at `ROWS` times, as an integrator may answer."""
    t = np.linspace(scene.interval[0], t_end, ROWS)
    groups = ("q", "v", "a", "lam", "x", "xdot", "y")
    rows = {group: np.zeros((ROWS, scene.sizes.of(group))) for group in groups}
    work = Work(steps=ROWS - 1, residuals=ROWS - 1)
    return Trajectory(t, **rows, work=work, notes={"h": np.full(ROWS, 0.1)})


def put(**parts):
    """An answer with other parts."""
    return lambda run: replace(run, **parts)


def count(**counts):
    """An answer with other counts."""
    return lambda run: replace(run, work=replace(run.work, **counts))


def moved(group, change):
    """An answer with a group that is changed."""
    return lambda run: replace(run, **{group: change(getattr(run, group))})


def with_time(k, value):
    """An answer with another time in a row."""
    return lambda run: replace(run, t=np.where(np.arange(ROWS) == k, value, run.t))


def mined(run):
    """The rows in a class of the plugin's own."""
    return Mined(run.t, run.q, run.v, run.a, run.lam, run.x, run.xdot, run.y)


def some(value):
    """Rows of objects; one of them is this value."""
    rows = np.empty((ROWS, 1), dtype=object)
    rows[0, 0] = value
    return rows


NAN = float("nan")

#: By name, a change of an honest trajectory, and words of the sentence on it.
TRAJECTORIES = {
    "no_trajectory": (lambda run: None, "measure() is None, expected a Trajectory"),
    "a_dict": (vars, "expected a Trajectory"),
    "the_class": (lambda run: Trajectory, "expected a Trajectory"),
    "exploding": (
        lambda run: Explosive(),
        "measure() is <Explosive instance>, expected a Trajectory",
    ),
    "mined": (mined, "v cannot be read: SystemExit: 3."),
    "t_none": (put(t=None), "t is None, expected an array of times"),
    "t_number": (put(t=1.0), "t is 1.0, expected an array of times"),
    "t_nan": (with_time(2, NAN), "t[2] is nan, expected finite numbers"),
    "t_inf": (with_time(5, np.inf), "t[5] is inf, expected finite numbers"),
    "t_text": (put(t=["a"] * ROWS), "expected real numbers of shape (6,)"),
    "t_matrix": (moved("t", lambda t: t[:, None]), "t is an array of float64 of shape (6, 1)"),
    "t_backwards": (moved("t", lambda t: t[[0, 2, 1, 3, 4, 5]]), "expected a time after t[1]"),
    "t_repeated": (moved("t", lambda t: t[[0, 1, 1, 3, 4, 5]]), "expected a time after t[1]"),
    "t_early": (moved("t", lambda t: t - 1.0), "the first of t is -1.0, expected the start of"),
    "t_beyond": (moved("t", lambda t: 2 * t), "expected no time after the end"),
    "t_complex": (moved("t", lambda t: t + 0j), "t is an array of complex128 of shape (6,)"),
    "t_exploding": (put(t=Explosive()), "t is <Explosive instance>, expected an array of times"),
    "no_rows": (
        lambda run: replace(Trajectory.failed("ok", ""), work=run.work),
        "t has no times, expected those of all rows of a run that is ok",
    ),
    "q_none": (put(q=None), "q is None, expected real numbers of shape (6, 1)"),
    "q_turned": (moved("q", np.transpose), "expected real numbers of shape (6, 1); it is transpo"),
    "q_flat": (moved("q", np.ravel), "q is an array of float64 of shape (6,), expected real"),
    "v_short": (moved("v", lambda v: v[:-1]), "v is an array of float64 of shape (5, 1)"),
    "a_wide": (moved("a", lambda a: np.hstack([a, a])), "a is an array of float64 of shape (6, 2)"),
    "lam_extra": (put(lam=np.zeros((ROWS, 1))), "lam is an array of float64 of shape (6, 1)"),
    "y_one": (put(y=np.zeros((ROWS, 3))), "y is an array of float64 of shape (6, 3)"),
    "xdot_long": (put(xdot=np.zeros((9, 2))), "xdot is an array of float64 of shape (9, 2)"),
    "q_complex": (moved("q", lambda q: q + 1j), "q is an array of complex128 of shape (6, 1)"),
    "q_objects": (put(q=some(Explosive())), "q is an array of object of shape (6, 1)"),
    "q_text": (put(q=np.full((ROWS, 1), "1.0")), "q is an array of <U3 of shape (6, 1)"),
    "q_times": (moved("q", lambda q: q.astype("M8[s]")), "q is an array of datetime64[s]"),
    "q_bool": (moved("q", lambda q: q > 0), "q is an array of bool of shape (6, 1)"),
    "q_masked": (moved("q", lambda q: np.ma.array(q, mask=q == 0)), "q is "),
    "q_ragged": (put(q=[[1.0], [1.0, 2.0]]), "expected real numbers of shape (6, 1)"),
    "q_exploding": (put(q=Explosive()), "q is <Explosive instance>, expected real numbers"),
    "v_dict": (put(v={"v": 1}), "v is {'v': 1}, expected real numbers"),
    "status_none": (put(status=None), "status is None, expected one of ok, newton_failed"),
    "status_unknown": (put(status="great"), "status is 'great', expected one of ok, newton_failed"),
    "status_true": (put(status=True), "status is True, expected one of"),
    "status_array": (put(status=np.ones(2)), "status is an array of float64 of shape (2,)"),
    "status_list": (put(status=["ok"]), "status is ['ok'], expected one of"),
    "message_exception": (put(message=ValueError("x")), "message is ValueError('x'), expected te"),
    "message_bytes": (put(message=b"late"), "message is b'late', expected text"),
    "message_none": (put(message=None), "message is None, expected text"),
    "message_empty": (
        put(status="diverged", message=" "),
        "message is ' ', expected text that is not empty",
    ),
    "work_none": (put(work=None), "work is None, expected a Work"),
    "work_dict": (put(work={"steps": 5}), "work is {'steps': 5}, expected a Work"),
    "work_mined": (put(work=MinedWork()), "work.newton cannot be read: Unspeakable: its message"),
    "steps_nan": (count(steps=NAN), "work.steps is nan, expected a whole number from 0"),
    "steps_half": (count(steps=2.5), "work.steps is 2.5, expected a whole number from 0"),
    "steps_negative": (count(steps=-1), "work.steps is -1, expected a whole number from 0"),
    "steps_true": (count(steps=True), "work.steps is True, expected a whole number"),
    "steps_text": (count(steps="5"), "work.steps is '5', expected a whole number"),
    "steps_huge": (count(steps=10**30), "work.steps is 1000000000"),
    "newton_inf": (count(newton=float("inf")), "work.newton is inf, expected a whole number"),
    "solves_list": (count(solves=[1]), "work.solves is [1], expected a whole number"),
    "solves_exploding": (
        count(solves=Explosive()),
        "work.solves is <Explosive instance>, expected a whole",
    ),
    "notes_none": (put(notes=None), "notes is None, expected a dictionary"),
    "notes_list": (put(notes=[1.0]), "notes is [1.0], expected a dictionary"),
    "notes_number": (put(notes={1: np.zeros(ROWS)}), "the name of a note is 1, expected text"),
    "notes_short": (put(notes={"h": np.zeros(5)}), "notes['h'] is an array of float64 of shape (5"),
    "notes_text": (put(notes={"h": ["big"] * ROWS}), "notes['h'] is ['big', 'big'"),
    "notes_many": (
        put(notes={f"n{k}": np.zeros(ROWS) for k in range(51)}),
        "expected a dictionary of at most 50 arrays by name",
    ),
}
#: By name, a fact, its false value, and words of the sentence on it.
FACTS = {
    "orders_half": ("orders", {"q": 1.5}, "orders['q'] is 1.5, expected a whole number"),
    "orders_nan": ("orders", {"q": NAN}, "orders['q'] is nan, expected a whole number"),
    "orders_text": ("orders", {"q": "2"}, "orders['q'] is '2', expected a whole number"),
    "orders_none": ("orders", None, "orders is None, expected a dictionary of whole numbers"),
    "orders_number": ("orders", 2, "orders is 2, expected a dictionary of whole numbers"),
    "orders_group": ("orders", {"p": 2}, "a group of orders is 'p', expected one of q, v, a"),
    "orders_raise": ("orders", Unspeakable(), "orders cannot be read: Unspeakable: its message"),
    "source_none": ("source", None, "source is None, expected text"),
    "source_list": ("source", ["Hairer"], "source is ['Hairer'], expected text"),
    "formulation_none": ("formulation", None, "formulation is None, expected text"),
    "family_number": ("family", 7, "family is 7, expected text"),
    "calls_bytes": ("calls", b"once", "calls is b'once', expected text"),
    "affinity_list": ("affinity", [], "affinity is [], expected text"),
    "controls_unknown": ("controls", "order", "controls is 'order', expected one of step, toler"),
    "controls_none": ("controls", None, "controls is None, expected one of step, tolerance"),
    "family_exit": ("family", SystemExit(0), "family cannot be read: SystemExit: 0."),
}
#: By name, an answer of `supports`, and words of the sentence on it.
SUPPORTS = {
    "supports_true": (True, "supports() is True, expected None, or the reason in a sentence"),
    "supports_false": (False, "supports() is False, expected None"),
    "supports_empty": ("  ", "supports() is ' ', expected None, or the reason"),
    "supports_number": (1.5, "supports() is 1.5, expected None"),
    "supports_list": (["no"], "supports() is ['no'], expected None"),
}
#: By name, an answer of `prepare`, and words of the sentence on it.
PREPARES = {
    "prepares_none": (None, "prepare() is None, expected a PreparedRun with measure() and exec"),
    "prepares_class": (Work, "prepare() is <class 'integrators.runs.Work'>, expected a Prep"),
    "prepares_text": ("later", "prepare() is 'later', expected a PreparedRun"),
}
#: By name, a bill, and words of the sentence on it.
BILLS = {
    "bill_none": (None, "bill() is None, expected a dictionary of operations by part"),
    "bill_nan": ({"solves": NAN}, "bill()['solves'] is nan, expected a finite number"),
    "bill_negative": (
        {"solves": -1},
        "bill()['solves'] is -1.0, expected a number that is n",
    ),
    "bill_text": ({"solves": "many"}, "bill()['solves'] is 'many', expected a finite number"),
    "bill_part": ({"coffee": 1.0}, "a part of bill() is 'coffee', expected one of residuals"),
}
#: By name, what a run raises, and words of the row.
RAISED = {
    "raises_unspeakable": (Unspeakable(), "Unspeakable: its message cannot be read"),
    "raises_exit": (SystemExit(0), "SystemExit: 0"),
    "raises_quit": (SystemExit(), "SystemExit: no message"),
    "raises_generator_exit": (GeneratorExit("over"), "GeneratorExit: over"),
    "raises_interrupt": (KeyboardInterrupt(), "KeyboardInterrupt: no message"),
    "raises_untouchable": (Untouchable("no"), "Untouchable: no"),
    "raises_much": (ValueError("x" * 10**6), "ValueError: xxxxxxxx"),
    "raises_surrogates": (ValueError("\ud800\x1b[31mred\n\nline"), "ValueError: "),
    "raises_bytes": (OSError(b"\xff"), "OSError: b'\\xff'"),
    "raises_group": (ExceptionGroup("all", [ValueError("one")]), "ExceptionGroup: all"),
    "raises_stop": (StopIteration(), "StopIteration: no message"),
    "raises_recursion": (RecursionError("deep"), "RecursionError: deep"),
    "raises_memory": (MemoryError(), "MemoryError: no message"),
}
#: By name, an answer that is turned into our own types.
MENDED = {
    "numpy_counts": count(steps=np.int64(5), residuals=np.float64(5.0), solves=np.array(5)),
    "jax_counts": lambda run: replace(run, work=Work(steps=jnp.asarray(5))),
    "float_counts": count(steps=5.0),
    "single_rows": moved("q", lambda q: q.astype(np.float32)),
    "long_rows": moved("q", lambda q: q.astype(np.longdouble)),
    "whole_rows": moved("q", lambda q: q.astype(np.int8)),
    "list_rows": moved("q", np.ndarray.tolist),
    "jax_rows": lambda run: replace(run, q=jnp.asarray(run.q), t=jnp.asarray(run.t)),
    "frozen_rows": moved("q", lambda q: np.broadcast_to(q[0], q.shape)),
    "surrogates": put(message="\ud800 late \udfff"),
    "controls": put(message="\x1b[31mred\x1b[0m\r\n\x00\x07\u202e"),
    "long_message": put(message="very " * 10**5),
    "text_of_its_own": put(message=Shouting("loud"), status=Shouting("diverged")),
    "note_names": put(notes={"\x1b[2J\ud800" + "n" * 10**4: np.zeros(ROWS)}),
    "nan_notes": put(notes={"h": [NAN, np.inf, -np.inf, 1, 2, 3]}),
    "nan_rows_of_a_failure": lambda run: replace(
        run, status="diverged", message="Late.", q=np.where(run.t[:, None] > 1, NAN, run.q)
    ),
    "times_of_a_failure_repeated": lambda run: replace(
        run, status="step_too_small", message="Late.", t=run.t[[0, 1, 2, 3, 4, 4]]
    ),
    "nan_rows": lambda run: replace(run, q=np.full((ROWS, 1), NAN)),
    "infinite_rows": lambda run: replace(run, q=np.full((ROWS, 1), np.longdouble("1e400"))),
}


class Run(PreparedRun):
    """A run that answers or raises as it is told."""

    def __init__(self, how, scene, t_end):
        self.how, self.scene, self.t_end = how, scene, t_end

    def measure(self):
        run = honest(self.scene, self.t_end)
        if self.how in RAISED:
            raise RAISED[self.how][0]
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
        if which == name and isinstance(value, BaseException):
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
    calls = fact("calls", "")
    affinity = fact("affinity", "lying")
    controls = fact("controls", "step")

    def supports(self, scene):
        return SUPPORTS[self.how][0] if self.how in SUPPORTS else None

    def prepare(self, scene, t_end, resolution):
        if self.how in PREPARES:
            return PREPARES[self.how][0]
        return Run(self.how, scene, t_end)
