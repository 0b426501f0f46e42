"""JAX as this project uses it: 64 bits, a persistent compilation cache, loaded late.

JAX reads these settings from the environment when it is first imported, so they are set here,
and the names ``jax`` and ``jnp`` below import it at the first use of an attribute: a list of
plugins or a help page must not wait for a compiler. ``Array``, ``Float`` ... are the types of
arrays, for annotations.

A flag of ours that a newer XLA refuses is left out, an option that it no longer heeds is noticed:
both cost speed alone.
"""

from __future__ import annotations

import hashlib
import importlib
import logging
import os
import signal
import sys
import warnings
from contextlib import suppress
from functools import cache
from importlib.metadata import version
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

import platformdirs

from problems.other_programs import run_program
from problems.usage import cores
from problems.whole_files import keep, kept

CACHE = Path(platformdirs.user_cache_dir("stepbench"))
#: Option of XLA: loops that access fewer bytes than this are compiled to one function each.
_JOINED = "xla_cpu_small_while_loop_byte_threshold"
#: Every operation has one thread, so that methods are compared and not the use of cores. Loops over
#: little data that call no library become one function each: for small scenes the calls from one
#: compiled piece to the next would cost more than their work.
_FLAGS = (
    "--xla_cpu_multi_thread_eigen=false",
    f"--xla_backend_extra_options={_JOINED}=1000000",
)
if version("jaxlib").startswith(("0.9.", "0.10.")):
    # XLA had two ways of writing a piece then, and as fast a program by the older one is compiled
    # sooner. Later releases end a process at this flag, also one whose plugin imports JAX first.
    _FLAGS += ("--xla_cpu_use_fusion_emitters=false",)
_SETTINGS = {
    "JAX_ENABLE_X64": "1",
    "JAX_PLATFORMS": "cpu",
    "JAX_COMPILATION_CACHE_DIR": str(CACHE / "jax"),
    "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
    "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "-1",
    "XLA_FLAGS": " ".join(_FLAGS),
    # Places in the source of each operation, for dumps of programs, take a tenth of compiling.
    "JAX_TRACEBACK_IN_LOCATIONS_LIMIT": "0",
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    # Reloading a cached program on a sibling CPU warns at length about instruction sets.
    "TF_CPP_MIN_LOG_LEVEL": "3",
}
#: Variable of XLA: its number of threads, else one for each core. A program runs on them, whoever
#: calls it. LAPACK's functions of many matrices (jaxlib 0.10.0 to 0.11.0) share their work out to
#: them once more, and wait on one of them: when all wait, nobody works. So one is spare there.
_THREADS = "NPROC"
SPARE_THREADS = int(version("jaxlib").startswith(("0.10.", "0.11.0")))
#: Without optimisation, a program is compiled in a third of the time, and takes four times as long.
_OPTIMISATION = "xla_backend_optimization_level"
#: What this adds to XLA_FLAGS: numbers are the same but for rounding.
SOONER = f" --{_OPTIMISATION}=0"
#: Room for addresses in bytes below which JAX does not start: XLA then asks for it without end.
_LEAST_ADDRESSES = 3 * 2**29
#: Starts XLA's compiler, which reads XLA_FLAGS then, and ends the process at a flag it refuses.
_START_XLA = "import jax; jax.local_devices(backend='cpu')"


class RuntimeFault(RuntimeError):
    """The environment keeps JAX from computing; the message names the variable and the remedy."""


def configure() -> None:
    """Set the environment that JAX and linear algebra read at import; a user's settings win."""
    for name, value in _SETTINGS.items():
        os.environ.setdefault(name, value)
    if "jax" in sys.modules:  # imported earlier, for example in a notebook: it may have threads
        sys.modules["jax"].config.update("jax_enable_x64", True)
    else:
        os.environ.setdefault(_THREADS, str(cores() + SPARE_THREADS))


def use_threads(callers: int) -> None:
    """Run all programs of this process on one thread, or on as many as call them, and a spare one.

    It has to be called before JAX is used; a user's own setting wins. JAX shares the parts of a
    program out to its threads: for small parts this costs more than it gains, so that a process
    that measures times has one.
    """
    usual = str(cores() + SPARE_THREADS)
    if os.environ.get(_THREADS, usual) == usual:  # nobody's, or `configure`'s
        os.environ[_THREADS] = "1" if callers == 1 else str(callers + SPARE_THREADS)


def one_thread() -> None:
    """Run all programs of this process on one thread; see `use_threads`."""
    use_threads(1)


def most_callers() -> int:
    """Return how many threads may call programs at a time: at least one, and else no spare one.

    Each program that runs may block one of XLA's threads; a single thread never blocks itself.
    """
    given = os.environ.get(_THREADS, "")
    return max(1, (int(given) if given.isdecimal() else cores()) - SPARE_THREADS)


def compile_sooner() -> None:
    """Compile all programs without optimisation, for runs that are not timed.

    It has to be called before JAX is used.
    """
    os.environ["XLA_FLAGS"] += SOONER


@cache
def _loaded(name: str) -> ModuleType:
    """Import JAX or a module of it, and have programs run in the thread that calls them.

    By default JAX hands each program over to a thread of its own, which takes longer than a short
    program.
    """
    if "jax" not in sys.modules:
        _refuse_little_room()
        _leave_out_refused_flags()
        _leave_out_unusable_cache()
        _tell_once_of_broken_programs()
    module = importlib.import_module(name)
    # It imports more of JAX, which has all that was compiled before compiled again.
    importlib.import_module("jax.extend")
    runs_at_once()
    return module


@cache
def runs_at_once() -> bool:
    """Ask JAX to run a program before its call returns, and return whether it will."""
    try:
        importlib.import_module("jax").config.update("jax_cpu_enable_async_dispatch", False)
        return True
    except AttributeError:
        slower("Short programs take longer: JAX has no jax_cpu_enable_async_dispatch any more.")
        return False


@cache
def on_gpu() -> bool:
    """Whether JAX computes on a GPU: thousands of equal things at once, and each call is dear."""
    return jax.default_backend() != "cpu"


@cache
def joins_loops() -> bool:
    """Whether programs are best without a call of a library: XLA compiles loops over little data to
    one function each, which is found by trying it, or everything to few pieces, on a GPU."""
    if on_gpu():
        return True
    if _JOINED not in os.environ["XLA_FLAGS"]:
        return False
    loop = jax.jit(lambda x: jax.lax.fori_loop(0, 9, lambda k, y: k + jnp.sin(y), x))
    # XLA marks such loops by this word in the compiled program.
    joined = "xla_cpu_small_call" in str(loop.lower(1.0).compile().as_text())
    if not joined:
        slower(f"Small scenes run slowly: XLA no longer joins loops by {_JOINED}.")
    return joined


@cache
def known_options(**options: Any) -> dict[str, Any]:
    """Return those options of a compiled program that XLA knows."""
    known = {}
    for name, value in options.items():
        try:
            jax.jit(lambda x: x, compiler_options={name: value})(0.0)
            known[name] = value
        except Exception:  # of whatever kind: programs compile without it, too
            slower(f"Some programs take longer: XLA no longer knows {name}.")
    return known


def few_calls() -> dict[str, Any]:
    """Return the options of a program that is called a few times: no optimisation."""
    return known_options(**{_OPTIMISATION: 0})


@cache
def slower(sentence: str) -> None:
    """Tell, once, what a library no longer offers, which costs time and nothing else."""
    logging.getLogger(__name__).warning(sentence)


class _LateModule:
    """Placeholder of a module, which is imported at the first use of one of its names."""

    def __init__(self, name: str) -> None:
        self._name = name

    def __getattr__(self, attribute: str) -> Any:
        return getattr(_loaded(self._name), attribute)


# ---- the user's environment, and newer libraries ---------------------------------------
def check_runtime() -> str:
    """Return the sentence on what makes the numbers of this process wrong, or nothing.

    To be called before anything is measured, and after plugins are loaded: JAX starts, on this
    computer's processor, with 64-bit floats.
    """
    try:
        platform = jax.local_devices()[0].platform
    except RuntimeFault as fault:
        return str(fault)
    except Exception as error:  # of whatever kind: JAX has none for a platform that is missing
        reason = next(iter(str(error).splitlines()), "") or type(error).__name__
        return f"JAX does not start ({reason}); unset {users_settings() or 'its variables'}."
    if platform != "cpu":
        return f"JAX computes on {platform}, but runs are measured on cpu; unset JAX_PLATFORMS."
    if jnp.result_type(float).itemsize != 8:
        return (
            "JAX computes with 32-bit floats, which decide the errors of all methods; unset "
            "JAX_ENABLE_X64, or take the change of jax_enable_x64 out of the plugin."
        )
    return ""


def users_settings() -> str:
    """Variables that decide how JAX starts and that the user has set, as "NAME=value, ..."."""
    return ", ".join(
        f"{name}={value}"
        for name, value in sorted(os.environ.items())
        if name.startswith(("JAX_", "XLA_"))
        and value != _SETTINGS.get(name)
        and "CACHE" not in name
    )


def _refuse_little_room() -> None:
    try:
        import resource
    except ImportError:  # a system without such limits
        return
    room, _ = resource.getrlimit(resource.RLIMIT_AS)
    if 0 <= room < _LEAST_ADDRESSES:
        raise RuntimeFault(
            f"JAX needs {_LEAST_ADDRESSES / 2**30:g} GiB of virtual memory, and a process may have "
            f"{room / 2**30:.3g} GiB; raise the limit by 'ulimit -v'."
        )


def _leave_out_refused_flags() -> None:
    """Take out of XLA_FLAGS those of ours that this XLA refuses."""
    value = os.environ["XLA_FLAGS"]
    words = _refusal(value)
    if not words:
        return
    refused = [flag for flag in value.split() if _refusal(flag)] or value.split()
    if set(refused) - set(_FLAGS):
        raise RuntimeFault(f"XLA_FLAGS={value} is refused: {words}; correct or unset XLA_FLAGS.")
    # Without a word: the user can do nothing about it.
    os.environ["XLA_FLAGS"] = " ".join(f for f in value.split() if f not in refused)


def _refusal(flags: str) -> str:
    """XLA's last words with these flags, nothing if it takes them.

    They are tried in another process, once for each release of jaxlib.
    """
    key = hashlib.sha256(f"{version('jaxlib')} {flags}".encode()).hexdigest()[:16]
    file = CACHE / "flags" / key
    if (known := kept(file)) is not None:
        return known.decode()
    words = _start_of_xla(flags)
    if words is None or (words and _start_of_xla("") != ""):  # the flags are not the reason
        return ""
    with suppress(OSError):
        keep(file, words.encode())
    return words


def _start_of_xla(flags: str) -> str | None:
    """The last line that XLA writes if it ends itself at these flags, nothing if it starts; None if
    something else ended it, or it hangs."""
    try:
        done = run_program([sys.executable, "-c", _START_XLA], XLA_FLAGS=flags, JAX_PLATFORMS="cpu")
    except OSError:
        return None
    if done.returncode < 0 and done.returncode != -signal.SIGABRT:
        return None
    lines = done.stderr.decode(errors="replace").strip().splitlines() if done.returncode else [""]
    last = lines[-1] if lines else f"exit code {done.returncode}"
    return last.rpartition("] ")[2]  # XLA's lines begin with [a date and a place]


def _leave_out_unusable_cache() -> None:
    """Keep no compiled programs if there is no folder for them; JAX would warn at each one."""
    name = "JAX_COMPILATION_CACHE_DIR"
    folder = os.environ[name]
    if not folder or "://" in folder:
        return
    try:
        Path(folder).mkdir(parents=True, exist_ok=True)
        if os.access(folder, os.W_OK | os.X_OK):
            return
        reason = "it cannot be written"
    except (OSError, ValueError) as error:
        reason = str(getattr(error, "strerror", None) or error)
    os.environ[name] = ""
    slower(
        f"Compiled programs are not kept, as {name}={folder} is no folder for them ({reason}); set "
        f"it to one."
    )


def _tell_once_of_broken_programs() -> None:
    """Put one sentence in the place of JAX's warnings about each program in its cache."""
    shown = warnings.showwarning

    def show(message: Warning | str, *rest: Any, **options: Any) -> None:
        if "persistent compilation cache entry" not in str(message):
            return shown(message, *rest, **options)
        folder = os.environ["JAX_COMPILATION_CACHE_DIR"]
        return slower(
            f"Runs start slowly: compiled programs in {folder} cannot be used or written; "
            f"empty this folder, or set JAX_COMPILATION_CACHE_DIR to another one."
        )

    warnings.showwarning = show


class _Annotation:
    """Type of an array where no type is checked: jaxtyping and JAX are slow to import."""

    def __class_getitem__(cls, shape: Any) -> type[_Annotation]:
        return cls


configure()
if TYPE_CHECKING:
    import jax
    import jax.numpy as jnp
    from jax import Array as Array
    from jaxtyping import Bool as Bool
    from jaxtyping import Float as Float
    from jaxtyping import Int as Int
    from jaxtyping import UInt as UInt
else:
    Array = Bool = Float = Int = UInt = _Annotation
    jax = _LateModule("jax")
    jnp = _LateModule("jax.numpy")
