"""Suites and plans, made from a profile and the command line.

A profile is a TOML file that describes a suite, built-in or not; a person reads "suite" for both. A
suite is the list of cells to be run that a profile and the command line ask for. Its plan is the
part that is stored: title, studies, and limits.
"""

from __future__ import annotations

import math
import re
import tomllib
from collections import defaultdict
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field
from importlib import resources
from itertools import product
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from bench.plugins.registry import Unavailable
from bench.results.records import MethodFacts, Plan, Record, Study
from bench.running.inventory import Inventory, SceneFacts
from integrators.resolutions import Steps, Tolerances, check_end
from problems.base import spec
from problems.base.checks import tidy
from problems.base.spec import SpecError

Facts = TypeVar("Facts")
#: Steps (halvings of the nominal step) and tolerances of a scene if a profile gives none.
DEFAULT_HALVINGS = 6
DEFAULT_RTOL = (1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10)
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
            if path.exists() and not path.is_file():  # a pipe or a device might never end
                raise OSError(0, "it is not a file")
            table = tomllib.loads(path.read_text(encoding="utf-8"))
            return path, msgspec.convert(table, ProfileFile)
        except msgspec.ValidationError as error:
            raise SpecError(f"The suite {path} is not as expected: {error}.") from None
        except OSError as error:
            raise SpecError(f"The suite {path} cannot be read: {error.strerror}.") from None
        # Of TOML, of UTF-8, of a null byte in the path, of a huge number.
        except (ValueError, RecursionError) as error:
            raise SpecError(f"The suite {path} is not valid TOML: {error}.") from None

    path, profile = read(name)
    studies = [*profile.study]
    for other in profile.include:
        _, included = read(other)
        if included.include:
            raise SpecError(f"{path} includes {other}, which includes others; name them all there.")
        studies += included.study
    return path.stem, msgspec.structs.replace(profile, study=[*map(_varied, studies)], include=[])


def _varied(study: StudyFile) -> StudyFile:
    """Return the study with every combination of the options that it varies written out."""
    count = len(study.integrators) * math.prod(map(len, study.vary.values()))
    if count > _MOST_VARIED:
        raise SpecError(f"A [[study]] varies {count} integrators; {_MOST_VARIED} are allowed.")
    integrators = [
        spec.join_spec(name, options | dict(zip(study.vary, values, strict=True)))
        for name, options in map(spec.split_spec, study.integrators)
        for values in product(*study.vary.values())
    ]
    return msgspec.structs.replace(study, integrators=integrators, vary={})


# ---- suites ------------------------------------------------------------------------------
@dataclass(frozen=True)
class Cell:
    """One run to be measured: a scene, an integrator, an end time in s and a resolution."""

    scene: SceneFacts
    method: MethodFacts = field(hash=False)
    t_end: float
    resolution: Steps | Tolerances

    @property
    def problem(self) -> str:
        """Return the printed name of the scene."""
        return self.scene.spec

    @property
    def integrator(self) -> str:
        """Return the printed name of the integrator."""
        return self.method.spec

    @property
    def key(self) -> str:
        """Return the key of the cell in the store, readable and unique."""
        r = self.resolution
        if isinstance(r, Steps):
            refined = f"h={r.h!r} x {'/'.join(map(repr, r.pattern))}"
        else:
            refined = f"rtol={r.rtol!r} atol={r.atol!r}"
        return f"{self.problem} | {self.integrator} | {refined} | t_end={self.t_end!r}"

    @property
    def fingerprint(self) -> str:
        """Return the fingerprints of the scene and the integrator."""
        return f"{self.scene.fingerprint}-{self.method.fingerprint}"

    def record(self, status: str, message: str = "") -> Record:
        """Make the record of this cell with all that is known without a run."""
        scene, method = self.scene, self.method
        if method.fault:
            status, message = "crashed", method.fault
        form, t0, r = method.formulation, scene.interval[0], self.resolution
        if scene.constrained:
            form = ", ".join(filter(None, (form, method.drift)))
        elif form != "ode":
            form = "unconstrained"
        known: dict[str, Any] = {"controls": "tolerance", **vars(r)}
        if isinstance(r, Steps):
            h = (self.t_end - t0) / r.count(t0, self.t_end)
            known = {"controls": "step", "h": h, "pattern": r.pattern}
        return Record(
            key=self.key,
            problem=self.problem,
            integrator=self.integrator,
            family=method.family,
            formulation=form,
            t0=t0,
            t_end=self.t_end,
            status=status,
            message=tidy(message),
            fingerprint=self.fingerprint,
            **known,
        )


@dataclass(frozen=True)
class Suite:
    """A plan, the part that is stored, with its cells by key in the order of the studies, and its
    scenes by name and end time in s.

    A cell may take ``memory_gib`` of memory. Experiments of the failure ``atlas`` belong to it
    (True: all, False: none). ``lost`` are sentences on plugins that have no cells, as they gave no
    facts.
    """

    plan: Plan
    cells: dict[str, Cell]
    scenes: dict[tuple[str, float], SceneFacts]
    memory_gib: float
    atlas: bool | list[str] = False
    lost: tuple[str, ...] = ()


#: A study of a profile, one of its scenes, and its integrators.
_Entry = tuple[StudyFile, SceneFacts, list[MethodFacts]]


def make_suite(
    name: str,
    profile: ProfileFile,
    registry: Inventory,
    problems: Sequence[str] = (),
    integrators: Sequence[str] = (),
    budget_s: float | None = None,
    mine: str | None = None,
) -> Suite:
    """Make the suite of a profile, restricted or extended by the command line.

    A name in ``problems`` or ``integrators`` selects the profile's entries of that name. A name
    that the profile lacks is added with the steps and tolerances of the profile's other entries (or
    the scene's own for a scene of its own). The integrator ``mine`` comes beside those selected.

    Raises
    ------
    SpecError
        If a name, option or number is not known or not allowed, or nothing is left to do.
    """
    lost: list[str] = []

    def usable(facts_of: Callable[[str], Facts], names: Sequence[str]) -> list[tuple[str, Facts]]:
        """Names with their facts; sentences on those that have none are lost."""
        found = []
        for text in names:
            try:
                found.append((text, facts_of(text)))
            except Unavailable as error:
                lost.append(str(error))
        return found

    scenes = dict(usable(registry.problem, problems)).values()
    wanted = usable(registry.integrator, integrators)
    own_method = [] if mine is None else [registry.integrator(mine)]
    entries: list[_Entry] = [
        (file, scene, methods)
        for file in profile.study
        for methods in [[m for _, m in usable(registry.integrator, file.integrators)]]
        for _, scene in usable(registry.problem, file.problems)
    ]
    lost += registry.broken_files()
    # An integrator that no study of a scene names goes into its first study alone.
    placed: defaultdict[str, set[str]] = defaultdict(set)
    for _, scene, methods in entries:
        placed[scene.spec].update(method.spec for method in methods)
    studies, cells = [], {}
    for file, scene, own in _of_scenes(entries, scenes) if problems else entries:
        asked = [
            method
            for text, one in wanted
            for method in [m for m in own if m.spec == one.spec or m.name == text] or [one]
        ]
        known, there = [m.spec for m in own], placed[scene.spec]
        found = [*(asked if integrators else own), *own_method]
        every = {m.spec: m for m in found if m.spec in known or m.spec not in there}
        there.update(every)
        if every:
            study, more = _expand(file, scene, [*every.values()], registry)
            studies.append(study)
            cells.update(more)
    told = tuple(dict.fromkeys(lost))
    if not cells:
        nothing = "Nothing is left to run; check the names that are given."
        raise SpecError(" ".join([nothing, *told]))
    part = bool(problems or integrators)  # of the profile, which goes without title and atlas
    plan = Plan(
        name=name,
        title="" if part else profile.title or name,
        samples=profile.samples,
        budget_s=budget_s or profile.budget_s,
        studies=studies,
        integrators={cell.integrator: cell.method for cell in cells.values()},
        mine=own_method[0].spec if own_method else "",
    )
    places = {(cell.problem, cell.t_end): cell.scene for cell in cells.values()}
    return Suite(plan, cells, places, profile.memory_gib, not part and profile.atlas, told)


def _of_scenes(entries: list[_Entry], scenes: Collection[SceneFacts]) -> list[_Entry]:
    """Return the entries of these scenes; one that has none gets one with all integrators."""
    kept = [entry for entry in entries if entry[1] in scenes]
    there = [scene for _, scene, _ in kept]
    every = {method.spec: method for *_, methods in entries for method in methods}
    # Scenes of their own show the same as the others, if these agree on it.
    shown = {file.figures for file, *_ in entries}
    figures = shown.pop() if len(shown) == 1 else FIGURES
    file = StudyFile(problems=[], integrators=[], figures=figures)
    extra = {scene.spec: scene for scene in scenes if scene not in there}
    return kept + [(file, scene, [*every.values()]) for scene in extra.values()]


def _expand(
    file: StudyFile, scene: SceneFacts, integrators: list[MethodFacts], registry: Inventory
) -> tuple[Study, dict[str, Cell]]:
    t0, default_end = scene.interval
    t_end = check_end(t0, default_end if file.t_end is None else file.t_end)
    steps = file.steps or [scene.nominal_step * 2.0**-k for k in range(DEFAULT_HALVINGS)]
    fixed = [Steps(h, file.pattern) for h in steps]
    for resolution in fixed:
        resolution.count(t0, t_end)  # refuses a step that does not fit the interval
    resolutions: dict[str, Sequence[Steps | Tolerances]] = {
        "step": fixed,
        "tolerance": [Tolerances(r, file.atol) for r in file.rtol or DEFAULT_RTOL],
    }
    cells = {
        cell.key: cell
        for integrator in (registry.integrator_on(method, scene) for method in integrators)
        for resolution in resolutions[integrator.controls]
        if (cell := Cell(scene, integrator, t_end, resolution))
    }
    names = registry.components(scene.spec) if file.components else {}  # loads JAX
    for part in (part for text in file.components for part in text.split(":", 1)):
        match = re.fullmatch(r"(q|v|a|lam|x|y)([1-9]\d{0,8})", part)
        if not match or int(match[2]) > len(names[match[1]]):
            raise SpecError(
                f"{scene.spec} has no component {part!r}; give a group and a number such as "
                f"q1, or two as q2:q1 for one over the other."
            )
    study = Study(
        title=file.title or scene.spec,
        note=file.note,
        problem=scene.spec,
        t_end=t_end,
        figures=list(file.figures),
        components=list(file.components),
        cells=list(cells),
    )
    return study, cells
