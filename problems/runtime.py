"""JAX as this project uses it: 64 bits, a persistent compilation cache, loaded late.

JAX reads these settings from the environment when it is first imported, so they are set here,
and the names ``jax`` and ``jnp`` below import it at the first use of an attribute: a list of
plugins or a help page must not wait for a compiler.
"""

from __future__ import annotations

import importlib
import os
import sys
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

import platformdirs

#: Option of XLA: loops that access fewer bytes than this are compiled to one function each.
_JOINED = "xla_cpu_small_while_loop_byte_threshold"

_SETTINGS = {
    "JAX_ENABLE_X64": "1",
    "JAX_PLATFORMS": "cpu",
    "JAX_COMPILATION_CACHE_DIR": str(Path(platformdirs.user_cache_dir("stepbench")) / "jax"),
    "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
    "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "-1",
    # Every operation has one thread, so that methods are compared and not the use of cores. Loops
    # over little data that call no library become one function each: for small scenes the calls
    # from one compiled piece to the next would cost more than their work.
    "XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false"
    f" --xla_backend_extra_options={_JOINED}=1000000",
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    # Reloading a cached program on a sibling CPU warns at length about instruction sets.
    "TF_CPP_MIN_LOG_LEVEL": "3",
}


def configure() -> None:
    """Set the environment that JAX and linear algebra read at import; a user's settings win."""
    for name, value in _SETTINGS.items():
        os.environ.setdefault(name, value)
    if "jax" in sys.modules:  # imported earlier, for example in a notebook
        sys.modules["jax"].config.update("jax_enable_x64", True)


def one_thread() -> None:
    """Run all programs of this process on one thread; a user's own setting wins.

    It has to be called before JAX is used, by a process that measures times. JAX has a thread for
    each processor, and shares the parts of a program out to them: for small parts this costs more
    than it gains. Ensembles need the threads, as they call programs side by side.
    """
    os.environ.setdefault("NPROC", "1")


@cache
def _loaded(name: str) -> ModuleType:
    """Import JAX or a module of it, and run programs in the thread that calls them.

    By default JAX hands each program over to a thread of its own, which takes longer than a short
    program.
    """
    module = importlib.import_module(name)
    sys.modules["jax"].config.update("jax_cpu_enable_async_dispatch", False)
    return module


def joins_loops() -> bool:
    """Whether XLA has the option to compile loops over little data to one function each."""
    return _JOINED in os.environ["XLA_FLAGS"]


class _LateModule:
    """Placeholder of a module, which is imported at the first use of one of its names."""

    def __init__(self, name: str) -> None:
        self._name = name

    def __getattr__(self, attribute: str) -> Any:
        return getattr(_loaded(self._name), attribute)


configure()
if TYPE_CHECKING:
    import jax
    import jax.numpy as jnp
else:
    jax = _LateModule("jax")
    jnp = _LateModule("jax.numpy")
