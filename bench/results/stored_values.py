"""Values of the store as JSON: checked when they are read, and made storable when written."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

import msgspec

from bench.results.drift import LongRun
from bench.results.experiments import ExperimentResult
from bench.results.records import Damping, Record, Rows, SceneRecord
from problems.plain_text import clean

T = TypeVar("T")

#: Most characters of a reason, and of a name that was too long.
_LONGEST = 200
#: An escape in JSON; the first alternative passes over escaped backslashes.
_ESCAPE = re.compile(rb"\\(?:[^u]|u([0-9a-fA-F]{4}))")


class Unreadable(ValueError):
    """A value that is not what the store holds; the message says why."""


def decoded(raw: object, kind: type[T]) -> T:
    """Read a value, with clean text.

    Raises
    ------
    Unreadable
        If it is not of this kind.
    """
    if not isinstance(raw, bytes | str):
        raise Unreadable(f"not text, but {type(raw).__name__}")
    try:
        text = clean_json(raw if isinstance(raw, bytes) else raw.encode())
        value = msgspec.json.decode(text, type=kind)
    except UnicodeError:
        raise Unreadable("not UTF-8") from None
    except RecursionError:
        raise Unreadable("nested too deeply") from None
    except msgspec.DecodeError as error:
        raise Unreadable(clean(str(error))[:_LONGEST]) from None
    if reason := _flaw(value):
        raise Unreadable(reason)
    return value


def encoded(value: object) -> bytes:
    """Write a value so that it can be read again.

    Raises
    ------
    Unreadable
        If it could not be read.
    """
    try:
        raw = msgspec.json.encode(value)
    except UnicodeEncodeError:  # half a surrogate pair somewhere
        raw = clean(json.dumps(msgspec.to_builtins(value), ensure_ascii=False)).encode()
    except (TypeError, ValueError, OverflowError, RecursionError) as error:
        raise Unreadable(clean(str(error))[:_LONGEST]) from None
    decoded(raw, type(value))
    return raw


def storable_or(value: T, instead: Callable[[Unreadable], T]) -> tuple[T, bytes]:
    """Return a value, or what is kept ``instead`` of one that could not be read, and its JSON."""
    try:
        return value, encoded(value)
    except Unreadable as error:
        other = instead(error)
        return other, encoded(other)


def storable(value: object) -> bool:
    """Whether a value can be written and read again."""
    try:
        encoded(value)
    except Unreadable:
        return False
    return True


def crashed(record: Record, reason: object) -> Record:
    """The record of a cell whose result cannot be stored: how it was run, and the reason."""
    texts = ("key", "problem", "integrator", "family", "formulation", "fingerprint")
    kept = ("h", "pattern", "rtol", "atol", "t0", "t_end", "environment", "budget_s")
    return Record(
        **{name: _text(getattr(record, name)) for name in texts},
        **{name: getattr(record, name) for name in kept},
        controls="step" if record.h is not None else "tolerance",
        status="crashed",
        message=f"The result cannot be stored: {reason}.",
    )


def undescribed(scene: SceneRecord, reason: object) -> SceneRecord:
    """The record of a scene whose description cannot be stored: its key and the reason."""
    return SceneRecord(
        problem=_text(scene.problem),
        t_end=scene.t_end,
        t0=scene.t0,
        description=f"The description of this scene cannot be stored: {reason}.",
        fingerprint=_text(scene.fingerprint),
    )


def clean_json(text: bytes) -> bytes:
    """Return JSON whose texts are clean; pairs of surrogates stay.

    Raises
    ------
    UnicodeDecodeError
        If it is not UTF-8.
    """
    if b"\\u" in text:
        text = _ESCAPE.sub(_clean_escape, text)
    return clean(text.decode()).encode() if not text.isascii() or b"\x7f" in text else text


def _clean_escape(found: re.Match[bytes]) -> bytes:
    digits = found[1]
    # Halves of pairs are left: msgspec joins two, and refuses one.
    if (
        not digits
        or 0xD800 <= int(digits, 16) <= 0xDFFF
        or clean(chr(int(digits, 16))) != "\N{REPLACEMENT CHARACTER}"
    ):
        return found[0]
    return b"\\ufffd"


def _text(value: object) -> str:
    """Clean text; one that is too long ends in a digest, so that two stay different."""
    text = clean(value) if isinstance(value, str) else f"({type(value).__name__})"
    if len(text) <= _LONGEST:
        return text
    return f"{text[:_LONGEST]}...{hashlib.sha256(text.encode()).hexdigest()[:8]}"


def _flaw(value: object) -> str:
    """Fault of a value that its types do not tell; empty if there is none."""
    if isinstance(value, Record):
        wanted = ("rtol", "atol") if value.controls == "tolerance" else ("h",)
        lacking = [name for name in wanted if getattr(value, name) is None]
        if lacking:
            return f"it has no {lacking[0]}"
        return "" if value.t0 < value.t_end else f"it ends at {value.t_end:g} s, before its start"
    if isinstance(value, Rows):
        return _ragged(value)
    if isinstance(value, SceneRecord):
        return _ragged(value.reference)
    if isinstance(value, Damping):
        known = {name: getattr(value, name) for name in ("radius", "ratio", "period_error")}
        return _unequal({"omega_h": value.omega_h} | {n: v for n, v in known.items() if v})
    if isinstance(value, ExperimentResult):
        cases = [case for part in value.parts for case in part.cases]
        pairs = [(case.x, case.y) for case in cases] + [c.history for c in cases if c.history]
        return next(filter(None, (_unequal({"x": x, "y": y}) for x, y in pairs)), "")
    if isinstance(value, LongRun):
        ends = [(n, band) for n, d in value.drifts.items() for band in (d.least, d.most)]
        return next(filter(None, (_unequal({"t": value.t, n: band}) for n, band in ends)), "")
    return ""


def _ragged(rows: Rows) -> str:
    uneven = [n for n, values in rows.values.items() if len({len(row) for row in values}) > 1]
    if uneven:
        return f"rows of {clean(uneven[0])} have different lengths"
    return _unequal({"t": rows.t, **rows.values, **rows.notes})


def _unequal(lists: Mapping[str, Sequence[Any]]) -> str:
    (first, wanted), *others = lists.items()
    for name, values in others:
        if len(values) != len(wanted):
            return f"{len(values)} values of {clean(name)[:40]} at {len(wanted)} of {first}"
    return ""
