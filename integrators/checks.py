"""The border to integrators: their answers are checked here once and turned into own types.

A check raises `problems.base.checks.FalseAnswer` with a sentence on what came and what was
expected.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import numpy as np

from integrators.contract import STATUSES, Integrator, PreparedRun, Trajectory, Work
from problems.base.checks import (
    FalseAnswer,
    array,
    dictionary,
    number,
    one_of,
    refused,
    text,
    whole,
)
from problems.system import MechatronicSystem
from problems.variables import GROUPS, VARIABLES, Sizes

#: Times of rows may leave the interval by this part of them, which is rounding.
_ROUNDING = 1e-9
#: Facts of an integrator in words.
WORDS = ("formulation", "drift", "controls", "family", "affinity", "source")


def facts(integrator: Integrator) -> dict[str, Any]:
    """Return the statements of an integrator on itself, as in `integrators.contract.Integrator`."""
    one_of(integrator.controls, "controls", ("step", "tolerance"))
    words = {name: text(getattr(integrator, name), name) for name in WORDS}
    return words | {"orders": checked_orders(integrator.orders)}


def checked_orders(value: object, what: str = "orders") -> dict[str, int]:
    """Return claimed orders by group."""
    orders = dictionary(value, what, "whole numbers by group")
    return {
        one_of(group, f"a group of {what}", GROUPS): whole(order, f"{what}[{group!r}]")
        for group, order in orders.items()
    }


def refusal(integrator: Integrator, scene: MechatronicSystem) -> str | None:
    """Ask an integrator whether it takes a scene; return None or its reason."""
    return _sentence(integrator.why_not(scene), "supports()")


def caution(integrator: Integrator, scene: MechatronicSystem) -> str | None:
    """Ask an integrator why its runs on a scene may be wrong; see `refusal`."""
    return _sentence(integrator.caution(scene), "caution()")


def _sentence(reason: object, what: str) -> str | None:
    if reason is not None and (not isinstance(reason, str) or not reason.strip()):
        raise refused(what, reason, "None, or the reason in a sentence")
    return reason if reason is None else text(reason, what)


def checked_run(value: Any) -> PreparedRun:
    """Return what `prepare` gave, which has ``measure`` and ``execute``."""
    if not all(callable(getattr(value, name, None)) for name in ("measure", "execute")):
        raise refused("prepare()", value, "a PreparedRun with measure() and execute()")
    return value


def checked_bill(value: object, parts: Collection[str]) -> dict[str, float]:
    """Return a bill of operations by part, of which ``parts`` are known."""
    bill = dictionary(value, "bill()", "operations by part")
    for part, cost in bill.items():
        one_of(part, "a part of bill()", parts)
        bill[part] = number(cost, f"bill()[{part!r}]")
        if bill[part] < 0:
            raise refused(f"bill()[{part!r}]", cost, "a number that is not negative")
    return bill


def checked_trajectory(value: object, sizes: Sizes, t0: float, t_end: float) -> Trajectory:
    """Return what `measure` gave, in arrays of its own.

    Values of a run may be NaN or infinite; its times may not, and lie between t0 and t_end in s.
    """
    if not isinstance(value, Trajectory):
        raise refused("measure()", value, "a Trajectory")
    if not isinstance(value.work, Work):
        raise refused("work", value.work, "a Work")
    ok = one_of(value.status, "status", STATUSES) == "ok"
    t = _times(value.t, t0, t_end, ok)

    def rows(group: str) -> np.ndarray:
        given, shape = getattr(value, group), (len(t), sizes.of(group))
        if not len(t) and isinstance(given, np.ndarray) and not given.size:
            return np.zeros(shape)
        return array(given, group, shape, finite=False)

    more: dict[str, Any] = {}
    phased = len(t) if np.size(value.phase) else 0  # else rows lie in the phases of their times
    if phased or np.size(value.xd):
        more["xd"] = rows("xd")
        more["phase"] = array(value.phase, "phase", (phased,)).astype(int)
        more["events"] = array(value.events, "events", ("events", 2))
    notes = dictionary(value.notes, "notes", "arrays by name")
    counts = {n: None if c is None else whole(c, f"work.{n}") for n, c in vars(value.work).items()}
    return Trajectory(
        t,
        **{group: rows(group) for group in (*VARIABLES, "xdot")},
        status=value.status,
        message=text(value.message, "message", empty=ok),
        work=Work(**counts),
        notes={
            text(name, "the name of a note", empty=False): array(
                note, f"notes[{name!r}]", t.shape, finite=False
            )
            for name, note in notes.items()
        },
        **more,
    )


def _times(value: object, t0: float, t_end: float, ok: bool) -> np.ndarray:
    t = array(value, "t", ("k",))
    slack = _ROUNDING * max(1.0, abs(t0), abs(t_end))
    if ok and not len(t):
        raise FalseAnswer("t has no times, expected those of all rows of a run that is ok.")
    if len(t) and abs(t[0] - t0) > slack:
        raise refused("the first of t", float(t[0]), f"the start of the interval, {t0:.9g} s")
    if len(t) and t.max() > t_end + slack:
        raise refused("the largest of t", float(t.max()), f"no time after the end, {t_end:.9g} s")
    # Before a run fails its steps may fall below the rounding of time.
    for k in np.flatnonzero(np.diff(t) <= 0 if ok else np.diff(t) < 0):
        raise refused(f"t[{k + 1}]", float(t[k + 1]), f"a time after t[{k}], {t[k]:.9g} s")
    return t
