"""What a measurement was made on."""

from __future__ import annotations

import datetime
import platform
import shlex
import sys
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import psutil

from bench.results.records import Environment

_PACKAGES = (
    "stepbench",
    "jax",
    "jaxlib",
    "diffrax",
    "optimistix",
    "scikit-sundae",
    "scipy",
    "numpy",
)


def environment() -> Environment:
    """Describe this machine, its versions and the command in work."""
    versions = {"python": platform.python_version()}
    for package in _PACKAGES:
        try:
            versions[package] = version(package)
        except PackageNotFoundError:
            continue
    command = [Path(sys.argv[0]).name, *sys.argv[1:]]
    return Environment(
        date=datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        command=shlex.join(command),
        cpu=_cpu_name(),
        cores=psutil.cpu_count(logical=True) or 1,
        memory_gib=round(psutil.virtual_memory().total / 2**30, 1),
        platform=platform.platform(),
        versions=versions,
    )


def _cpu_name() -> str:
    info = Path("/proc/cpuinfo")
    if info.is_file():
        for line in info.read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()
