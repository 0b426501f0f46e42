"""Messages between processes: bytes behind their length; answers are data of a known type.

Tasks go to a process as pickles, since they come from this program. Answers come from a process in
which foreign code runs: they are msgspec data, decoded as the type that the job states.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from functools import cache
from typing import Any, get_type_hints

import msgspec
import numpy as np

_LENGTH = struct.Struct("<Q")
#: A longer message, in bytes, is none.
_MOST_BYTES = 2**28
#: Kinds of messages of a process.
PHASE, DONE, REFUSED, FAILED = "phase", "done", "refused", "failed"


class Message(msgspec.Struct, array_like=True, frozen=True):
    """A message of a process: its kind, and its content encoded."""

    kind: str
    content: msgspec.Raw


class _Array(msgspec.Struct, array_like=True):
    kind: str
    shape: tuple[int, ...]
    data: bytes


class BrokenMessage(ValueError):
    """Bytes that are no message, or a message of another type than expected."""


def encode(content: Any) -> bytes:
    """Encode data of msgspec's types, dataclasses and real arrays."""
    return msgspec.msgpack.encode(content, enc_hook=_encoded)


def decode(content: bytes | msgspec.Raw, kind: Any) -> Any:
    """Decode data as a type.

    Raises
    ------
    BrokenMessage
        If it is not of that type.
    """
    try:
        return msgspec.msgpack.decode(content, type=kind, dec_hook=_decoded)
    except (msgspec.MsgspecError, UnicodeDecodeError, ValueError, TypeError) as error:
        raise BrokenMessage(f"{error}") from None


@cache
def answer_type(job: Callable[..., Any]) -> Any:
    """Return the type of the answers of a job, which its annotation states."""
    return get_type_hints(job)["return"]


def message(kind: str, content: Any) -> bytes:
    """Return a message ready to be sent."""
    sent = encode(Message(kind, msgspec.Raw(encode(content))))
    return _LENGTH.pack(len(sent)) + sent


def messages(received: bytearray) -> Iterator[Message]:
    """Yield the complete messages among the bytes that came, and take them off.

    Raises
    ------
    BrokenMessage
        If the bytes are no messages.
    """
    while len(received) >= _LENGTH.size:
        (length,) = _LENGTH.unpack_from(received)
        if length > _MOST_BYTES:
            raise BrokenMessage("it is no message")
        end = _LENGTH.size + length
        if len(received) < end:
            return
        content = bytes(received[_LENGTH.size : end])
        del received[:end]
        yield decode(content, Message)


def _encoded(value: Any) -> Any:
    if isinstance(value, np.ndarray) and value.dtype.kind in "fiub":
        return _Array(value.dtype.str, value.shape, np.ascontiguousarray(value).tobytes())
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"{type(value).__name__} cannot be sent")


def _decoded(kind: Any, value: Any) -> Any:
    if kind is not np.ndarray:
        raise TypeError(f"{kind} cannot be received")
    array = msgspec.convert(value, _Array)
    if np.dtype(array.kind).kind not in "fiub" or min(array.shape, default=0) < 0:
        raise ValueError("an array of numbers was expected")
    return np.frombuffer(array.data, array.kind).reshape(array.shape)
