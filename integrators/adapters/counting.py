"""Counting of a function's evaluations inside compiled code.

A counted program calls two functions of this process by name, through XLA's foreign function
interface. Such a program is the same in every process, so that JAX keeps it in its persistent
compilation cache. The functions are Python's, made by ctypes: no compiler is needed, and a call
takes some two microseconds.
"""

from __future__ import annotations

import ctypes
import re
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from ctypes import POINTER, c_int, c_size_t, c_uint32, c_void_p
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from problems.runtime import jax

#: Names under which compiled programs call. Cached programs hold them.
EVALUATION = "stepbench_count_evaluation"
LINEARISATION = "stepbench_count_linearisation"
#: Numbers of calls by name: one tally for the process, as a compiled program knows names alone.
_TALLY = {EVALUATION: 0, LINEARISATION: 0}


class Counts(NamedTuple):
    """Numbers of evaluations and linearisations of a watched function."""

    evaluations: int
    linearisations: int


def watch(rate: Callable) -> Callable:
    """Return the same function of (t, s, p), counted in runs under `run_counted`.

    A linearisation in s counts once, however many directions follow: the calls that count take no
    arguments, so that they stand outside of its linear part.
    """

    def along(arguments: tuple, directions: tuple) -> tuple:
        t, s, p = arguments
        # Along s alone: nothing here differentiates with respect to time or parameters.
        return jax.jvp(lambda s: rate(t, s, p), (s,), (directions[1],))

    _check_counting()
    return _counted(rate, along)


def watch_block(block: Callable) -> Callable:
    """Return the same block of a scene, counted in runs under `run_counted`.

    A linearisation counts once, too, in whatever arguments it is.
    """
    _check_counting()
    return _counted(block, lambda arguments, directions: jax.jvp(block, arguments, directions))


def _counted(function: Callable, linearised: Callable[[tuple, tuple], tuple]) -> Callable:
    @jax.custom_jvp
    def counted(*arguments: Any) -> Any:
        _count(EVALUATION)
        return function(*arguments)

    @counted.defjvp
    def linearise(arguments: tuple, directions: tuple) -> tuple:
        _count(LINEARISATION)
        return linearised(arguments, directions)

    return counted


def run_counted(program: Callable, *arguments: Any) -> tuple[Any, Counts]:
    """Call a program of watched functions; return its finished result and the counts."""
    # Here, at the latest: the one thread cannot wait for a trial in itself.
    _check_counting()
    return _run_counted(program, *arguments)


def _run_counted(program: Callable, *arguments: Any) -> tuple[Any, Counts]:
    def run() -> tuple[Any, Counts]:
        _TALLY.update(dict.fromkeys(_TALLY, 0))
        result = jax.block_until_ready(program(*arguments))
        return result, Counts(*_TALLY.values())

    # Not in the main thread: Ctrl-C would wait there for the end of the program, or be raised in
    # the midst of a call that counts, which cannot hand it on.
    return _counting_thread().submit(run).result()


@cache
def _counting_thread() -> ThreadPoolExecutor:
    """The one thread of all counted runs: a run begins when the one before has ended, even if
    Ctrl-C ended the wait for that one."""
    return ThreadPoolExecutor(1)


def _count(name: str) -> None:
    """Put a call that counts into the program that is traced."""
    # The side effect keeps XLA from dropping, merging or hoisting calls without a result.
    # In a function of its own: of calls that stand bare in two equal loops, JAX 0.10 hands on the
    # first without the version of its interface, and XLA does not find it.
    jax.jit(jax.ffi.ffi_call(name, (), has_side_effect=True))()


# ---- XLA's interface -------------------------------------------------------------------
# The first fields of its structures; later releases add others at their ends. A frame with an
# extension asks for the version of the interface, the others are calls in one of several stages.
def _structure(**fields: Any) -> Any:
    return type("Structure", (ctypes.Structure,), {"_fields_": [*fields.items()]})


_Version = _structure(size=c_size_t, next=c_void_p, major=c_int, minor=c_int)
_Metadata = _structure(size=c_size_t, version=_Version, traits=c_uint32)
_Extension = _structure(size=c_size_t, type=c_int, next=c_void_p, metadata=POINTER(_Metadata))
_Frame = _structure(
    size=c_size_t, extension=POINTER(_Extension), api=c_void_p, context=c_void_p, stage=c_int
)
_METADATA, _EXECUTE = 1, 3


def _handler(name: str) -> Any:
    """The function that XLA calls by a name."""

    @ctypes.CFUNCTYPE(c_void_p, POINTER(_Frame))
    def handler(pointer: Any) -> None:
        frame = pointer.contents
        if frame.extension and frame.extension.contents.type == _METADATA:
            metadata = frame.extension.contents.metadata.contents
            metadata.version.major, metadata.version.minor = interface_version()
            metadata.traits = 0
        elif frame.stage == _EXECUTE:
            _TALLY[name] += 1

    return handler


#: They live as long as the process: XLA keeps their addresses.
_HANDLERS = {name: _handler(name) for name in _TALLY}


@cache
def interface_version() -> tuple[int, int]:
    """Return the version of XLA's interface, by the header that it installs."""
    header = Path(jax.ffi.include_dir(), "xla/ffi/api/c_api.h").read_text()
    found = dict(re.findall(r"#define XLA_FFI_API_(MAJOR|MINOR) (\d+)", header))
    return int(found["MAJOR"]), int(found["MINOR"])


@cache
def _check_counting() -> None:
    """Hand the functions to XLA, and try out whether they count rightly."""
    try:
        _register()
        _try_counting()
    except Exception as error:  # of whatever kind: it says why
        raise RuntimeError(
            f"this release of JAX has no way to count evaluations in compiled programs ({error}); "
            f"install an earlier release of jax"
        ) from error


def _register() -> None:
    # XLA refuses by an exception only when it is up. Before, it would keep the function and then
    # fail to start.
    jax.local_devices()
    if interface_version()[0]:
        raise RuntimeError("the structures of its interface are new")
    for name, handler in _HANDLERS.items():
        jax.ffi.register_ffi_target(name, jax.ffi.pycapsule(handler), platform="cpu")


def _try_counting() -> None:
    """Count in a program with the traps of the real ones: a loop, equal calls, unused results."""
    square = _counted(lambda s: s * s, lambda at, along: jax.jvp(lambda s: s * s, at, along))

    def once(_: int, s: Any) -> Any:
        square(s)
        _, push = jax.linearize(square, s)
        return push(s) + push(2 * s)

    found = _run_counted(jax.jit(lambda: jax.lax.fori_loop(0, 3, once, 1.0)))[1]
    if found != Counts(3, 3):
        raise RuntimeError(f"3 evaluations and 3 linearisations were counted as {found}")
