"""Fingerprints: digests of everything that decides the numbers of a scene or an integrator; and
the machine, the versions and the command of a measurement.

These are the source of this project, the files beside a plugin's own, the versions of the libraries
that compute, and the flags of the compiler. A cell whose fingerprint changes is measured anew. Of a
class that was written from a model (`problems.from_sympy`) its text counts, too.
"""

from __future__ import annotations

import datetime
import hashlib
import os
import platform
import re
import shlex
import sys
from contextlib import suppress
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import psutil

from bench.plugins.registry import Registry
from bench.results.records import Environment
from problems.base.runtime import CACHE, SOONER
from problems.base.text import clean
from problems.system import MechatronicSystem

#: Libraries that compute, by the names of their packages; some may be missing.
LIBRARIES = (
    *("jax", "jaxlib", "diffrax", "optimistix", "lineax", "equinox", "scikit-sundae", "scipy"),
    *("numpy", "klujax", "asdex", "solve_dae", "mujoco"),
)


def environment() -> Environment:
    """Describe this machine, its versions and the command in work."""
    command, info = [Path(sys.argv[0]).name, *sys.argv[1:]], Path("/proc/cpuinfo")
    cpu = re.search("^model name[^:]*:(.*)", info.read_text() if info.is_file() else "", re.M)
    return Environment(
        date=datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        command=clean(shlex.join(command)),
        cpu=cpu[1].strip() if cpu else platform.processor() or platform.machine(),
        cores=psutil.cpu_count(logical=True) or 1,
        memory_gib=round(psutil.virtual_memory().total / 2**30, 1),
        platform=platform.platform(),
        versions={"python": platform.python_version()} | versions(("stepbench", *LIBRARIES)),
        clock="processor time of all threads of the process, a sample the least of its runs",
    )


@cache
def versions(packages: tuple[str, ...]) -> dict[str, str]:
    """Return the versions of the packages that are installed."""
    found = {}
    for package in packages:
        with suppress(PackageNotFoundError):
            found[package] = version(package)
    return found


#: Variables of the environment that change what JAX computes.
FLAGS = ("XLA_FLAGS", "JAX_ENABLE_X64")
_PROJECT = Path(__file__).parents[2]
#: Folders whose source decides references, and those that decide all other numbers.
_SCENES = ("problems",)
_ALL = (*_SCENES, "integrators", "bench/running", "bench/stability", "bench/atlas")
#: Packages whose source, or whose version, is in every fingerprint.
_ELSEWHERE = {"problems", "integrators", "bench", *sys.stdlib_module_names}


@cache
def fingerprint(made: type = object, folders: tuple[str, ...] = _ALL) -> str:
    """Return 12 hexadecimal digits of a class of scenes or integrators, or of this project."""
    digest = hashlib.sha256("".join(_source(_PROJECT / f, "**/*.py") for f in folders).encode())
    for base in made.__mro__:
        file = Path(getattr(sys.modules.get(base.__module__), "__file__", None) or "")
        if file.suffix == ".py" and base.__module__.partition(".")[0] not in _ELSEWHERE:
            digest.update(_source(file.parent, "*.py").encode())
        digest.update(str(vars(base).get("source_text", "")).encode())  # no module has written it
    flags = [os.environ.get(flag, "").replace(SOONER, "") for flag in FLAGS]
    digest.update(repr((sorted(versions(LIBRARIES).items()), flags)).encode())
    return digest.hexdigest()[:12]


@cache
def _source(folder: Path, pattern: str) -> str:
    """The digest of the files of a folder, wherever it is."""
    digest = hashlib.sha256()
    for file in sorted(folder.glob(pattern)):
        with suppress(OSError):  # a link to nothing
            digest.update(f"{file.name} {hashlib.sha256(file.read_bytes()).hexdigest()}\n".encode())
    return digest.hexdigest()


def reference_file(registry: Registry, scene: MechatronicSystem, t_end: float) -> Path | None:
    """Return the file that keeps the reference of a scene up to t_end in s; its name is a digest of
    all that decides it. None for a scene that is not in the registry."""
    plugin = registry.problems.get(scene.name)
    if plugin is None or plugin.cls is not type(scene):
        return None
    made = fingerprint(type(scene), _SCENES)
    about = made, scene.spec, sorted(scene.parameters().items()), t_end
    digest = hashlib.sha256(repr(about).encode()).hexdigest()[:32]
    return CACHE / "references" / f"{scene.name}-{digest}"
