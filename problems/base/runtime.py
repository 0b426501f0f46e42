"""JAX as this project uses it: 64 bits, a persistent compilation cache, loaded late.

JAX reads these settings from the environment when it is first imported, so they are set here,
and the names ``jax`` and ``jnp`` below import it at the first use of an attribute: a list of
plugins or a help page must not wait for a compiler. ``Array``, ``Float`` ... are the types of
arrays, for annotations.
"""

from __future__ import annotations

import importlib
import logging
import os
import sys
import warnings
from functools import cache
from importlib.metadata import version
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

import platformdirs

CACHE = Path(platformdirs.user_cache_dir("stepbench"))
#: Every operation has one thread, so that methods are compared and not the use of cores. Loops over
#: little data that call no library become one function each: for small scenes the calls from one
#: compiled piece to the next would cost more than their work.
_FLAGS = [
    "--xla_cpu_multi_thread_eigen=false",
    "--xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold=1000000",
]
if version("jaxlib").startswith(("0.9.", "0.10.")):
    # XLA had two ways of writing a piece then, and as fast a program by the older one is compiled
    # sooner. A later release ends its process at this flag; so `pyproject.toml` allows those alone
    # that have been tried.
    _FLAGS.append("--xla_cpu_use_fusion_emitters=false")
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
#: Variable of XLA: its number of threads, else one for each core.
_THREADS = "NPROC"
#: Options of a program that is called a few times. Without optimisation it is compiled in a third
#: of the time, and takes four times as long; numbers are the same but for rounding.
FEW_CALLS = {"xla_backend_optimization_level": 0}
#: What the same adds to XLA_FLAGS.
SOONER = " --xla_backend_optimization_level=0"


def configure() -> None:
    """Set the environment that JAX and linear algebra read at import; a user's settings win."""
    for name, value in _SETTINGS.items():
        os.environ.setdefault(name, value)
    if "jax" in sys.modules:  # imported earlier, for example in a notebook
        sys.modules["jax"].config.update("jax_enable_x64", True)


def use_one_thread() -> None:
    """Run all programs of this process on one thread.

    It has to be called before JAX is used; a user's own setting wins. JAX shares the parts of a
    program out to its threads: for small parts this costs more than it gains, so that a process
    that measures times has one.
    """
    os.environ.setdefault(_THREADS, "1")


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
        _tell_once_of_broken_programs()
    module = importlib.import_module(name)
    # It imports more of JAX, which has all that was compiled before compiled again.
    importlib.import_module("jax.extend")
    sys.modules["jax"].config.update("jax_cpu_enable_async_dispatch", False)
    return module


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


# ---- the user's environment ------------------------------------------------------------
def check_runtime() -> str:
    """Return the sentence on what makes the numbers of this process wrong, or nothing.

    To be called before anything is measured, and after plugins are loaded: JAX starts, on this
    computer's processor, with 64-bit floats.
    """
    try:
        platform = jax.local_devices()[0].platform
    except Exception as error:  # of whatever kind: JAX has none for a platform that is missing
        reason = next(iter(str(error).splitlines()), "") or type(error).__name__
        return f"JAX does not start ({reason}); unset variables that begin with JAX_ or XLA_."
    if platform != "cpu":
        return f"JAX computes on {platform}, but runs are measured on cpu; unset JAX_PLATFORMS."
    if jnp.result_type(float).itemsize != 8:
        return (
            "JAX computes with 32-bit floats, which decide the errors of all methods; unset "
            "JAX_ENABLE_X64, or take the change of jax_enable_x64 out of the plugin."
        )
    return ""


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
