"""Profiles: TOML files that describe suites, built-in ones and others.

A person reads "suite" for both.
"""

from __future__ import annotations

import math
import tomllib
from importlib import resources
from itertools import product
from pathlib import Path
from typing import Any

import msgspec

from problems.base import spec
from problems.base.spec import SpecError

#: Figures that a study can show, and the table of orders, claimed and measured.
FIGURES = ("trajectory", "convergence", "work_precision")
TABLES = ("orders",)
#: Most integrators of a study.
_MOST_VARIED = 10_000
#: Most timing samples of a run; largest budget of one, in s of time and in GiB of memory.
MOST_SAMPLES, LARGEST_BUDGET = 1000, 1e9


class StudyFile(msgspec.Struct, kw_only=True, forbid_unknown_fields=True):
    """A ``[[study]]`` of a profile.

    ``vary`` maps option names to values: every integrator is taken with every combination of
    them. ``components`` is what is drawn over time, such as "q4" or "x1", or over another one, as
    the path "q2:q1"; the first few of every group if there are none.
    """

    problems: list[str]
    integrators: list[str]
    vary: dict[str, list[str]] = {}
    title: str = ""
    note: str = ""
    t_end: float | None = None
    steps: list[float] | None = None
    pattern: tuple[float, ...] = (1.0,)
    rtol: list[float] | None = None
    atol: float | None = None
    figures: tuple[str, ...] = FIGURES
    components: list[str] = []

    def __post_init__(self) -> None:
        for figure in self.figures:
            spec.one_of(figure, FIGURES + TABLES, "figure")


class ProfileFile(msgspec.Struct, kw_only=True, forbid_unknown_fields=True):
    """A profile: ``samples`` timings per run, ``budget_s`` and ``memory_gib`` per cell; the
    experiments of the failure ``atlas`` that belong to it (true: all); profiles whose studies it
    takes, too."""

    study: list[StudyFile]
    include: list[str] = []
    title: str = ""
    samples: int = 7
    budget_s: float = 60.0
    memory_gib: float = 4.0
    atlas: bool | list[str] = False

    def __post_init__(self) -> None:
        if not 0 <= self.samples <= MOST_SAMPLES:
            raise SpecError(f"samples={self.samples} is not allowed; give 0 (no timing) to 1000")
        for key in ("budget_s", "memory_gib"):
            if not 0 < (given := getattr(self, key)) <= LARGEST_BUDGET:
                raise SpecError(f"{key}={given} is not allowed; give a number above 0, up to 1e9")


def built_in_profiles() -> dict[str, Path]:
    """Return the files of the profiles that ship with the tool, by name."""
    folder = Path(str(resources.files("bench"))) / "profiles"
    return {file.stem: file for file in sorted(folder.glob("*.toml"))}


def suite_titles() -> dict[str, str]:
    """Return the titles of the suites that ship with the tool, by name."""
    files = built_in_profiles()
    return {name: str(_read_toml(file).get("title", name)) for name, file in files.items()}


def is_suite(name: str) -> bool:
    """Whether a name is that of a suite that ships with the tool, or of a TOML file."""
    return name in built_in_profiles() or name.endswith(".toml")


def read_profile(name: str) -> tuple[str, ProfileFile]:
    """Read a built-in profile by name or any TOML file by path; return its name and contents.

    The studies of profiles that it includes follow its own.

    Raises
    ------
    SpecError
        If it is not there, is not TOML, or has an unknown key or a value of the wrong type; or if
        it includes a profile that includes others itself.
    """
    known = built_in_profiles()

    def read(name: str) -> tuple[Path, ProfileFile]:
        path = known.get(name, Path(name))
        if path.suffix != ".toml":
            raise SpecError(
                f"There is no suite {name!r}; {spec.suggest(name, known)}, or give a .toml file."
            )
        try:
            profile = msgspec.convert(_read_toml(path), ProfileFile)
        except msgspec.ValidationError as error:
            raise SpecError(f"The suite {path} is not as expected: {error}.") from None
        return path, profile

    path, profile = read(name)
    studies = [*profile.study]
    for other in profile.include:
        _, included = read(other)
        if included.include:
            raise SpecError(f"{path} includes {other}, which includes others; name them all there.")
        studies += included.study
    return path.stem, msgspec.structs.replace(profile, study=[*map(_varied, studies)], include=[])


def _read_toml(path: Path) -> dict[str, Any]:
    try:
        if path.exists() and not path.is_file():  # a pipe or a device might never end
            raise SpecError(f"The suite {path} is not a file.")
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise SpecError(f"The suite {path} cannot be read: {error.strerror}.") from None
    # Of TOML, of UTF-8, of a null byte in the path, of a huge number.
    except (ValueError, RecursionError) as error:
        raise SpecError(f"The suite {path} is not valid TOML: {error}.") from None


def _varied(study: StudyFile) -> StudyFile:
    """Return the study with every combination of the options that it varies written out."""
    count = len(study.integrators) * math.prod(map(len, study.vary.values()))
    if count > _MOST_VARIED:
        raise SpecError(f"A [[study]] varies {count} integrators; {_MOST_VARIED} are allowed.")
    combinations = [
        dict(zip(study.vary, values, strict=True)) for values in product(*study.vary.values())
    ]
    integrators = []
    for text in study.integrators:
        name, options = spec.split_spec(text)
        for more in combinations:
            every = ",".join(f"{key}={value}" for key, value in (options | more).items())
            integrators.append(f"{name}[{every}]" if every else name)
    return msgspec.structs.replace(study, integrators=integrators, vary={})
