"""The machine, the versions and the command of a measurement."""

from __future__ import annotations

import datetime
import platform
import shlex
import sys
from collections.abc import Iterable
from contextlib import suppress
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import psutil

from bench.results.records import Environment
from problems.base.text import clean

#: Libraries that compute, by the names of their packages; some may be missing.
LIBRARIES = (
    *("jax", "jaxlib", "diffrax", "optimistix", "lineax", "equinox", "scikit-sundae", "scipy"),
    *("numpy", "klujax", "asdex", "solve_dae", "mujoco"),
)


def environment() -> Environment:
    """Describe this machine, its versions and the command in work."""
    command = [Path(sys.argv[0]).name, *sys.argv[1:]]
    return Environment(
        date=datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        command=clean(shlex.join(command)),
        cpu=_cpu_name(),
        cores=psutil.cpu_count(logical=True) or 1,
        memory_gib=round(psutil.virtual_memory().total / 2**30, 1),
        platform=platform.platform(),
        versions={"python": platform.python_version()}
        | _versions(("stepbench",))
        | library_versions(),
        clock="processor time of all threads of the process, the least of single runs",
    )


@cache
def library_versions() -> dict[str, str]:
    """Return the versions of the installed libraries that compute."""
    return _versions(LIBRARIES)


def _versions(packages: Iterable[str]) -> dict[str, str]:
    found = {}
    for package in packages:
        with suppress(PackageNotFoundError):
            found[package] = version(package)
    return found


def _cpu_name() -> str:
    info = Path("/proc/cpuinfo")
    if info.is_file():
        for line in info.read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()
