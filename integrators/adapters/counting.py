"""Counting of a function's evaluations inside compiled code.

A counted program calls two functions in C by name, through XLA's foreign function interface. Such a
program is the same in every process, so that JAX keeps it in its persistent compilation cache. The
functions are compiled with the header of the installed release, whose layout they so have. Without
a C compiler, or if XLA refuses them, ``jax.debug.callback`` counts: its calls take some 40
microseconds, and every process compiles its programs again.
"""

from __future__ import annotations

import ctypes
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple

from integrators.lowering.native import load
from problems.runtime import jax, slower

#: Names under which compiled programs call. Cached programs hold them.
EVALUATION = "stepbench_count_evaluation"
LINEARISATION = "stepbench_count_linearisation"
_NAMES = (EVALUATION, LINEARISATION)


class Counts(NamedTuple):
    """Numbers of evaluations and linearisations of a watched function."""

    evaluations: int
    linearisations: int


class _Way(NamedTuple):
    """A way to count: ``call(name)`` puts a call that counts into the program that is traced; the
    tally is one for the process, as a compiled program knows names and no objects."""

    call: Callable[[str], None]
    tally: dict[str, ctypes.c_int64]


def watch(rate: Callable) -> Callable:
    """Return the same function of (t, s, p), counted in runs under `run_counted`.

    A linearisation in s counts once, however many directions follow: the calls that count take no
    arguments, so that they stand outside of its linear part.
    """
    return _watch(rate, _way().call)


def watch_block(block: Callable) -> Callable:
    """Return the same block of a scene, counted in runs under `run_counted`.

    A linearisation counts once, too, in whatever arguments it is.
    """
    count = _way().call

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
    # The way is tried out here, at the latest: the one thread cannot wait for a trial in itself.
    return _run_counted(_way(), program, *arguments)


def counts_by_name() -> bool:
    """Whether counted programs call functions by name, so that they can be kept for other
    processes."""
    return _way().call is _count_by_name


def _run_counted(way: _Way, program: Callable, *arguments: Any) -> tuple[Any, Counts]:
    def run() -> tuple[Any, Counts]:
        for number in way.tally.values():
            number.value = 0
        result = jax.block_until_ready(program(*arguments))
        jax.effects_barrier()  # the last callbacks may still be under way
        return result, Counts(*(number.value for number in way.tally.values()))

    # Not in the main thread: Ctrl-C would wait there for the end of the program, or be raised in
    # the midst of a callback, which cannot hand it on.
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


# ---- ways to count from compiled code --------------------------------------------------
@cache
def _way() -> _Way:
    """The first way that counts rightly here.

    Raises
    ------
    RuntimeError
        If there is none: numbers of calls are right or there are none.
    """
    try:
        return _tried(_by_name())
    except Exception as error:  # of whatever kind: there is another way to count
        slower(f"Counting is slow and its programs are not cached: {error}.")
    try:
        return _tried(_by_callback())
    except Exception as error:
        raise RuntimeError(
            f"this release of JAX has no way to count evaluations in compiled programs ({error}); "
            f"install an earlier release of jax"
        ) from error


def _tried(way: _Way) -> _Way:
    """The same way, after a program with the traps of the real ones: a loop, equal calls, unused
    results."""
    square = _watch(lambda t, s, p: s * s, way.call)

    def once(_: int, s: Any) -> Any:
        square(0.0, s, None)
        _, push = jax.linearize(lambda s: square(0.0, s, None), s)
        return push(s) + push(2 * s)

    found = _run_counted(way, jax.jit(lambda: jax.lax.fori_loop(0, 3, once, 1.0)))[1]
    if found != Counts(3, 3):
        raise RuntimeError(f"3 evaluations and 3 linearisations were counted as {found}")
    return way


def _by_name() -> _Way:
    # XLA refuses by an exception only when it is up. Before, it would keep the function and then
    # fail to start.
    jax.local_devices()
    library = load(header() + _COUNTING + "\n".join(f"COUNTING({name})" for name in _NAMES))
    for name in _NAMES:
        function = jax.ffi.pycapsule(getattr(library, name))
        jax.ffi.register_ffi_target(name, function, platform="cpu")
    tally = {name: ctypes.c_int64.in_dll(library, f"{name}s") for name in _NAMES}
    return _Way(_count_by_name, tally)


def _count_by_name(name: str) -> None:
    # The side effect keeps XLA from dropping, merging or hoisting calls without a result.
    # In a function of its own: of calls that stand bare in two equal loops, JAX 0.10 hands on the
    # first without the version of its interface, and XLA does not find it.
    jax.jit(jax.ffi.ffi_call(name, (), has_side_effect=True))()


def header() -> str:
    """The text of XLA's interface, as the installed release has it."""
    return Path(jax.ffi.include_dir(), "xla/ffi/api/c_api.h").read_text()


#: Makes a function for XLA to call, and its tally. XLA asks each for its version of the interface
#: first. The type of what extends a frame has another name in each release, and is not named here.
_COUNTING = """
static XLA_FFI_Error *count(XLA_FFI_CallFrame *frame, _Atomic int64_t *tally)
{
    if (frame->extension_start && frame->extension_start->type == XLA_FFI_Extension_Metadata) {
        XLA_FFI_Metadata *about = ((XLA_FFI_Metadata_Extension *)frame->extension_start)->metadata;
        about->api_version.major_version = XLA_FFI_API_MAJOR;
        about->api_version.minor_version = XLA_FFI_API_MINOR;
        about->traits = 0;
    } else if (frame->stage == XLA_FFI_ExecutionStage_EXECUTE) {
        ++*tally;
    }
    return 0;
}
#define COUNTING(name) \\
    _Atomic int64_t name##s; \\
    XLA_FFI_Error *name(XLA_FFI_CallFrame *frame) { return count(frame, &name##s); }
"""


def _by_callback() -> _Way:
    tally, lock = {name: ctypes.c_int64() for name in _NAMES}, threading.Lock()

    def add_one(name: str) -> None:
        with lock:  # XLA may call from several threads
            tally[name].value += 1

    return _Way(lambda name: jax.debug.callback(partial(add_one, name)), tally)
