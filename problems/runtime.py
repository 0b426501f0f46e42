"""JAX as this project uses it: 64 bits, a persistent compilation cache, loaded late.

JAX reads these settings from the environment when it is first imported, so they are set here,
and the names ``jax`` and ``jnp`` below import it only when an attribute is asked for: listing
plugins or printing a help page must not wait for a compiler.
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
    # An operation has one thread, for every solver alike: it is the method that is measured. Loops
    # over little data that call no library become one function each: handing over from one
    # compiled piece to the next costs more than what small scenes compute in it.
    "XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false"
    f" --xla_backend_extra_options={_JOINED}=1000000",
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    # Reloading a cached program on a sibling CPU warns at length about instruction sets.
    "TF_CPP_MIN_LOG_LEVEL": "3",
}


def configure() -> None:
    """Set what JAX and the linear algebra read at import; a user's own settings win."""
    for name, value in _SETTINGS.items():
        os.environ.setdefault(name, value)
    if "jax" in sys.modules:  # imported before us, for example in a notebook
        sys.modules["jax"].config.update("jax_enable_x64", True)


def one_thread() -> None:
    """All programs of this process on one thread, before JAX is used; a user's own setting wins.

    JAX has a thread for each processor, on which programs run side by side if they are called from
    several threads, as in ensembles. Parts of one program are also shared out to them, which costs
    more than it gains where parts are small: for a process that takes times.
    """
    os.environ.setdefault("NPROC", "1")


@cache
def _loaded(name: str) -> ModuleType:
    """JAX or a module of it; programs run where they are called: handing each over to a thread of
    JAX's, as it does by default, costs more than a short one takes."""
    module = importlib.import_module(name)
    sys.modules["jax"].config.update("jax_cpu_enable_async_dispatch", False)
    return module


def joins_loops() -> bool:
    """Whether XLA was told to compile loops over little data to one function each."""
    return _JOINED in os.environ["XLA_FLAGS"]


class _LateModule:
    """Stands for a module that is imported at the first use of one of its names."""

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
