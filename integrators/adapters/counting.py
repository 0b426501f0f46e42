"""Counting of a function's evaluations inside compiled code.

A counted program calls functions of this process by name, through XLA's foreign function
interface. Such a program is the same in every process, so that JAX keeps it in its persistent
compilation cache. If the interface refuses our functions, ``jax.debug.callback`` counts: its calls
take some 40 microseconds instead of 10, and every process compiles its programs again.
"""

from __future__ import annotations

import ctypes
import logging
import re
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple

from problems.runtime import jax

#: Names under which compiled programs call. Cached programs hold them.
EVALUATION = "stepbench_count_evaluation"
LINEARISATION = "stepbench_count_linearisation"


class Counts(NamedTuple):
    """Numbers of evaluations and linearisations of a watched function."""

    evaluations: int
    linearisations: int


# One tally for the process: a compiled program knows names, not objects.
_tally: dict[str, int] = {EVALUATION: 0, LINEARISATION: 0}
_tally_lock = threading.Lock()  # XLA may call from several threads


def watch(rate: Callable) -> Callable:
    """Return the same function of (t, s, p), counted in runs under `run_counted`.

    A linearisation in s counts once, however many directions follow: the calls that count take no
    arguments, so that they stand outside of its linear part.
    """
    return _watch(rate, _way_to_count())


def watch_block(block: Callable) -> Callable:
    """Return the same block of a scene, counted in runs under `run_counted`.

    A linearisation counts once, too, in whatever arguments it is.
    """
    count = _way_to_count()

    @jax.custom_jvp
    def counted(*arguments: Any) -> Any:
        count(EVALUATION)
        return block(*arguments)

    @counted.defjvp
    def linearise(arguments: tuple, directions: tuple) -> tuple:
        count(LINEARISATION)
        return jax.jvp(block, arguments, directions)

    return counted


def run_counted(program: Callable, *arguments: Any) -> tuple[Any, Counts]:
    """Call a program made of watched functions.

    Returns
    -------
    The finished result of ``program(*arguments)``, and the counts of the call.
    """

    def run() -> tuple[Any, Counts]:
        _tally.update(dict.fromkeys(_tally, 0))
        result = jax.block_until_ready(program(*arguments))
        jax.effects_barrier()  # the last callbacks may still be under way
        return result, Counts(*_tally.values())

    # Not in the main thread: Ctrl-C would be raised there in the midst of a function that XLA
    # called, which cannot hand it on.
    return _counting_thread().submit(run).result()


@cache
def _counting_thread() -> ThreadPoolExecutor:
    """The one thread of all counted runs: a run begins when the one before has ended, even if
    Ctrl-C ended the wait for that one."""
    return ThreadPoolExecutor(1)


def _watch(rate: Callable, count: Callable[[str], None]) -> Callable:
    @jax.custom_jvp
    def counted(t: Any, s: Any, p: Any) -> Any:
        count(EVALUATION)
        return rate(t, s, p)

    @counted.defjvp
    def linearise(arguments: tuple, directions: tuple) -> tuple:
        count(LINEARISATION)
        t, s, p = arguments
        # Along s alone: nothing here differentiates with respect to time or parameters.
        return jax.jvp(lambda s: rate(t, s, p), (s,), (directions[1],))

    return counted


def add_one(name: str) -> None:
    with _tally_lock:
        _tally[name] += 1


# ---- ways to count from compiled code --------------------------------------------------
def _count_by_name(name: str) -> None:
    # The side effect keeps XLA from dropping, merging or hoisting calls without a result.
    # In a function of its own: of calls that stand bare in two equal loops, JAX 0.10 hands on the
    # first without the version of its interface, and XLA does not find it.
    jax.jit(jax.ffi.ffi_call(name, (), has_side_effect=True))()


def _count_by_callback(name: str) -> None:
    jax.debug.callback(partial(add_one, name))


def _way_to_count() -> Callable[[str], None]:
    """A way that counts rightly here.

    Raises
    ------
    RuntimeError
        If there is none: numbers of calls are right or there are none.
    """
    # Registered here, ahead of any program that calls the functions, compiled or out of a cache.
    if names_are_registered():
        return _count_by_name
    if not _callbacks_count():
        raise RuntimeError(
            "this release of JAX has no way to count evaluations in compiled programs; install an "
            "earlier release of jax"
        )
    return _count_by_callback


@cache
def _callbacks_count() -> bool:
    return run_counted(_three_of_each(_count_by_callback))[1] == Counts(3, 3)


@cache
def names_are_registered() -> bool:
    """Make both functions known to XLA, once, and try them out."""
    try:
        # XLA refuses by an exception only when it is up. Before, it would keep the function
        # and then fail to start.
        jax.local_devices()
        check_layout(header())
        for name in _tally:
            jax.ffi.register_ffi_target(name, jax.ffi.pycapsule(_handler(name)), platform="cpu")
        found = run_counted(_three_of_each(_count_by_name))[1]
        if found != Counts(3, 3):
            raise RuntimeError(f"3 evaluations and 3 linearisations were counted as {found}")
    except Exception as error:  # of whatever kind: there is another way to count
        reason = "Counting is slow and its programs are not cached, as XLA calls no function of"
        logging.getLogger(__name__).warning("%s ours: %s", reason, error)
        return False
    return True


def _three_of_each(count: Callable[[str], None]) -> Callable:
    """A program with the traps of the real ones: a loop, equal calls, unused results."""
    square = _watch(lambda t, s, p: s * s, count)

    def once(_: int, s: Any) -> Any:
        square(0.0, s, None)
        _, push = jax.linearize(lambda s: square(0.0, s, None), s)
        return push(s) + push(2 * s)

    return jax.jit(lambda: jax.lax.fori_loop(0, 3, once, 1.0))


# ---- the C interface of XLA's foreign functions ----------------------------------------
# Field by field as in xla/ffi/api/c_api.h, which jaxlib installs under jax.ffi.include_dir(), with
# its names. XLA owns these structures, and its minor versions only add fields at their ends. Fields
# after the last one used here are left out.
_METADATA_EXTENSION = 1  # XLA_FFI_Extension_Metadata
_EXECUTE = 3  # XLA_FFI_ExecutionStage_EXECUTE


class _Version(ctypes.Structure):  # XLA_FFI_Api_Version
    _fields_ = (
        ("struct_size", ctypes.c_size_t),
        ("extension_start", ctypes.c_void_p),
        ("major_version", ctypes.c_int),
        ("minor_version", ctypes.c_int),
    )


class _Metadata(ctypes.Structure):  # XLA_FFI_Metadata
    _fields_ = (
        ("struct_size", ctypes.c_size_t),
        ("api_version", _Version),
        ("traits", ctypes.c_uint32),
    )


class _Extension(ctypes.Structure):  # XLA_FFI_Extension_Base
    _fields_ = (
        ("struct_size", ctypes.c_size_t),
        ("type", ctypes.c_int),
        ("next", ctypes.c_void_p),
    )


class _MetadataExtension(ctypes.Structure):  # XLA_FFI_Metadata_Extension
    _fields_ = (("extension_base", _Extension), ("metadata", ctypes.POINTER(_Metadata)))


class _Api(ctypes.Structure):  # XLA_FFI_Api
    _fields_ = (
        ("struct_size", ctypes.c_size_t),
        ("extension_start", ctypes.c_void_p),
        ("api_version", _Version),
    )


class _CallFrame(ctypes.Structure):  # XLA_FFI_CallFrame
    _fields_ = (
        ("struct_size", ctypes.c_size_t),
        ("extension_start", ctypes.POINTER(_MetadataExtension)),
        ("api", ctypes.POINTER(_Api)),
        ("ctx", ctypes.c_void_p),
        ("stage", ctypes.c_int),
    )


#: The structures by their names in the header.
_STRUCTURES = {
    "XLA_FFI_Api_Version": _Version,
    "XLA_FFI_Metadata": _Metadata,
    "XLA_FFI_Extension_Base": _Extension,
    "XLA_FFI_Metadata_Extension": _MetadataExtension,
    "XLA_FFI_Api": _Api,
    "XLA_FFI_CallFrame": _CallFrame,
}


def header() -> str:
    """The text of XLA's interface, as the installed release has it."""
    return Path(jax.ffi.include_dir(), "xla/ffi/api/c_api.h").read_text()


def check_layout(header: str) -> None:
    """Compare our structures with XLA's own text of them; another layout would be a crash.

    Raises
    ------
    RuntimeError
        If they differ.
    """
    code = re.sub(r"//.*", "", header)
    if not re.search(r"#define XLA_FFI_API_MAJOR 0\s", code):
        raise RuntimeError("XLA's interface has another major version than 0")
    for name, ours in _STRUCTURES.items():
        body = re.search(rf"struct {name} \{{(.*?)\}}", code, re.DOTALL)
        theirs = re.findall(r"(\w+);", body[1]) if body else []
        if theirs[: len(ours._fields_)] != [field for field, *_ in ours._fields_]:
            raise RuntimeError(f"XLA's structure {name} has other fields")


_Handler = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.POINTER(_CallFrame))


@cache  # also keeps it alive: XLA holds a bare pointer
def _handler(name: str) -> Any:
    """A function for XLA to call: it counts under a name and returns no error."""

    @_Handler
    def handle(pointer: Any) -> None:
        frame = pointer.contents
        extension = frame.extension_start
        if extension and extension.contents.extension_base.type == _METADATA_EXTENSION:
            metadata = extension.contents.metadata.contents
            # The fields above are of major version 0; any minor version agrees. Older releases do
            # not tell theirs.
            api, version = frame.api, metadata.api_version
            version.major_version = 0
            version.minor_version = api.contents.api_version.minor_version if api else 1
            metadata.traits = 0
        elif frame.stage == _EXECUTE:
            add_one(name)

    return handle
