"""The border to integrators: their answers are checked here once and turned into own types.

Each check returns text, Python numbers or fresh arrays, or raises `problems.answers.FalseAnswer`
with a sentence on what came and what was expected.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any, NamedTuple

import numpy as np

from integrators.contract import STATUSES, Integrator, PreparedRun, Trajectory, Work
from problems.answers import (
    FalseAnswer,
    array,
    asked,
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
_ROWS = (*VARIABLES, "xdot")


class Facts(NamedTuple):
    """An integrator's statements on itself, as in `integrators.contract.Integrator`."""

    formulation: str = ""
    drift: str = ""
    controls: str = "step"
    family: str = ""
    affinity: str = ""
    orders: Mapping[str, int] = {}
    source: str = ""
    calls: str = ""


def facts(integrator: Integrator) -> Facts:
    """Return the statements of an integrator on itself.

    Raises
    ------
    FalseAnswer
        If one is not of its kind.
    """
    found = {name: asked(integrator, name) for name in Facts._fields}
    one_of(found["controls"], "controls", ("step", "tolerance"))
    claimed = checked_orders(found.pop("orders"))
    words = {name: text(value, name) for name, value in found.items()}
    return Facts(**words, orders=claimed)


def stated(integrator: Integrator) -> tuple[Facts, str]:
    """Return `facts` and nothing, or facts of which none is known and the sentence on the fault."""
    try:
        return facts(integrator), ""
    except FalseAnswer as fault:
        return Facts(), str(fault)


def checked_orders(value: object, what: str = "orders") -> dict[str, int]:
    """Return claimed orders by group."""
    if not isinstance(value, Mapping):
        raise refused(what, value, "a dictionary of whole numbers by group")
    for group in value:
        one_of(group, f"a group of {what}", GROUPS)
    return {group: whole(order, f"{what}[{group!r}]") for group, order in value.items()}


def refusal(integrator: Integrator, scene: MechatronicSystem) -> str | None:
    """Ask an integrator whether it takes a scene; return None or its reason.

    Raises
    ------
    FalseAnswer
        If it answers neither None nor a sentence.
    """
    return _sentence(integrator.why_not(scene), "supports")


def caution(integrator: Integrator, scene: MechatronicSystem) -> str | None:
    """Ask an integrator why its runs on a scene may be wrong; see `refusal`."""
    return _sentence(integrator.caution(scene), "caution")


def _sentence(reason: object, about: str) -> str | None:
    if reason is None:
        return None
    if not isinstance(reason, str) or not reason.strip():
        raise refused(f"{about}()", reason, "None, or the reason in a sentence")
    return text(reason, f"{about}()")


def checked_run(value: Any) -> PreparedRun:
    """Return what `prepare` gave, which has ``measure`` and ``execute``."""
    missing = [name for name in ("measure", "execute") if not callable(getattr(value, name, None))]
    if missing:
        raise refused("prepare()", value, "a PreparedRun with measure() and execute()")
    return value


def checked_bill(value: object, parts: Collection[str]) -> dict[str, float]:
    """Return a bill of operations by part, of which ``parts`` are known."""
    if not isinstance(value, Mapping):
        raise refused("bill()", value, "a dictionary of operations by part")
    for part in value:
        one_of(part, "a part of bill()", parts)
    found = {part: number(cost, f"bill()[{part!r}]") for part, cost in value.items()}
    for part, cost in found.items():
        if cost < 0:
            raise refused(f"bill()[{part!r}]", cost, "a number that is not negative")
    return found


def checked_trajectory(value: object, sizes: Sizes, t0: float, t_end: float) -> Trajectory:
    """Return what `measure` gave, in arrays of its own.

    Values of a run may be NaN or infinite; its times may not.

    Parameters
    ----------
    sizes
        Dimensions of the scene.
    t0, t_end
        Interval of the run in s, in which all rows lie; the first one is at t0.

    Raises
    ------
    FalseAnswer
        If a part is not of its type or shape.
    """
    if not isinstance(value, Trajectory):
        raise refused("measure()", value, "a Trajectory")
    status = one_of(value.status, "status", STATUSES)
    t = _times(value.t, t0, t_end, strictly=status == "ok")
    if not len(t) and status == "ok":
        raise FalseAnswer("t has no times, expected those of all rows of a run that is ok.")
    return Trajectory(
        t,
        **{group: _rows(getattr(value, group), group, len(t), sizes.of(group)) for group in _ROWS},
        status=status,
        message=text(value.message, "message", empty=status == "ok"),
        work=_work(value.work),
        notes=_notes(value.notes, len(t)),
        **_at_jumps(value, len(t), sizes.nd),
    )


def _at_jumps(run: Trajectory, count: int, nd: int) -> dict[str, np.ndarray]:
    """Held values and phases of rows, and the events; nothing if none are given.

    Phases may be left out: rows then lie in those of their times.
    """
    if not np.size(run.phase) and not np.size(run.xd):
        return {}
    known = (count,) if np.size(run.phase) else (0,)
    return {
        "xd": _rows(run.xd, "xd", count, nd),
        "phase": array(run.phase, "phase", known).astype(int),
        "events": array(run.events, "events", (*np.shape(run.events)[:1], 2)),
    }


def _times(value: object, t0: float, t_end: float, strictly: bool) -> np.ndarray:
    if np.ndim(value) != 1:  # type: ignore[arg-type]
        raise refused("t", value, "an array of times of shape (k,)")
    t = array(value, "t", np.shape(value))  # type: ignore[arg-type]
    slack = _ROUNDING * max(1.0, abs(t0), abs(t_end))
    if len(t) and abs(t[0] - t0) > slack:
        raise refused("the first of t", float(t[0]), f"the start of the interval, {t0:.9g} s")
    if len(t) and t.max() > t_end + slack:
        raise refused("the largest of t", float(t.max()), f"no time after the end, {t_end:.9g} s")
    # Before a run fails its steps may fall below the rounding of time.
    later = np.diff(t) > 0 if strictly else np.diff(t) >= 0
    if not later.all():
        k = int(np.argmin(later))
        raise refused(f"t[{k + 1}]", float(t[k + 1]), f"a time after t[{k}], {t[k]:.9g} s")
    return t


def _rows(value: object, group: str, count: int, size: int) -> np.ndarray:
    if not count and isinstance(value, np.ndarray) and not value.size:
        return np.zeros((0, size))
    return array(value, group, (count, size), finite=False)


def _work(value: object) -> Work:
    """Return work counts as whole numbers, None where they are not known."""
    if not isinstance(value, Work):
        raise refused("work", value, "a Work")
    counts = {n: None if c is None else whole(c, f"work.{n}") for n, c in vars(value).items()}
    return Work(**counts)


def _notes(value: object, count: int) -> dict[str, np.ndarray]:
    if not isinstance(value, Mapping):
        raise refused("notes", value, "a dictionary of arrays by name")
    return {
        text(name, "the name of a note", empty=False): array(
            note, f"notes[{name!r}]", (count,), finite=False
        )
        for name, note in value.items()
    }
