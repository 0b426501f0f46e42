"""Suites and plans, made from a profile and the command line.

A profile is a TOML file. A suite is the list of cells to be run that a profile and the command
line ask for. Its plan is the part that is stored: title, studies, and limits.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from bench.plugins.registry import Sources, Unavailable
from bench.results.records import IntegratorFacts, Plan, Record, Study
from bench.running.inventory import Inventory, MethodFacts, SceneFacts
from bench.running.profiles import FIGURES, ProfileFile, StudyFile
from integrators.contract import Integrator
from integrators.resolutions import Steps, Tolerances, check_end
from problems.base.checks import tidy
from problems.base.spec import SpecError
from problems.system import MechatronicSystem

#: Steps (halvings of the nominal step) and tolerances of a scene if a profile gives none.
DEFAULT_HALVINGS = 6
DEFAULT_RTOL = (1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10)


@dataclass(frozen=True)
class Cell:
    """One run to be measured: a scene, an integrator, an end time and a resolution."""

    problem: str
    integrator: str
    t_end: float
    resolution: Steps | Tolerances

    @property
    def key(self) -> str:
        """Return the key of the cell in the store, readable and unique."""
        r = self.resolution
        if isinstance(r, Steps):
            refined = f"h={r.h!r} x {'/'.join(map(repr, r.pattern))}"
        else:
            refined = f"rtol={r.rtol!r} atol={r.atol!r}"
        return f"{self.problem} | {self.integrator} | {refined} | t_end={self.t_end!r}"

    def record(
        self, scene: SceneFacts, method: MethodFacts, status: str, message: str = ""
    ) -> Record:
        """Make the record of this cell with all that is known without a run."""
        if method.fault:
            status, message = "crashed", method.fault
        form, t0, r = method.formulation, scene.interval[0], self.resolution
        if scene.constrained:
            form = ", ".join(filter(None, (form, method.drift)))
        elif form != "ode":
            form = "unconstrained"
        known: dict[str, Any] = {}
        if isinstance(r, Steps):
            h = (self.t_end - t0) / r.count(t0, self.t_end)
            known = {"h": h, "pattern": r.pattern}
        else:
            known = {"rtol": r.rtol, "atol": r.atol}
        return Record(
            key=self.key,
            problem=self.problem,
            integrator=self.integrator,
            family=method.family,
            formulation=form,
            controls="step" if isinstance(r, Steps) else "tolerance",
            t0=t0,
            t_end=self.t_end,
            status=status,
            message=tidy(message),
            fingerprint=f"{scene.fingerprint}-{method.fingerprint}",
            **known,
        )

    def facts(self, inventory: Inventory) -> tuple[SceneFacts, MethodFacts]:
        """Return the facts of the cell's scene and integrator."""
        return inventory.problem(self.problem), inventory.integrator(self.integrator)

    def fingerprint(self, inventory: Inventory) -> str:
        """Return the fingerprints of the cell's scene and integrator."""
        return "-".join(facts.fingerprint for facts in self.facts(inventory))

    def sources(self, inventory: Inventory) -> Sources:
        """Return the plugins from outside that a run needs."""
        scene, method = self.facts(inventory)
        return scene.sources | method.sources


@dataclass(frozen=True)
class Suite:
    """A plan with its cells.

    Parameters
    ----------
    plan
        The part that is stored.
    cells
        The cells by key, in the order of the studies.
    memory_gib
        The most memory that a cell may take.
    atlas
        Experiments of the failure atlas that belong to it (True: all, False: none).
    lost
        Sentences on plugins that have no cells, as they gave no facts.
    """

    plan: Plan
    cells: dict[str, Cell]
    memory_gib: float
    atlas: bool | list[str] = False
    lost: tuple[str, ...] = ()


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
    scenes = [registry.problem(text) for text in _usable(problems, registry.problem, lost)]
    integrators = _usable(integrators, registry.integrator, lost)
    own_method = registry.integrator(mine) if mine is not None else None
    entries = [
        _Entry(file, registry.problem(problem), [registry.integrator(text) for text in texts])
        for file in profile.study
        for texts in [_usable(file.integrators, registry.integrator, lost)]
        for problem in _usable(file.problems, registry.problem, lost)
    ]
    lost += registry.broken_files()
    # An integrator that no study of a scene names goes into its first study alone.
    placed: defaultdict[str, set[str]] = defaultdict(set)
    for entry in entries:
        placed[entry.scene.spec].update(method.spec for method in entry.methods)
    studies, cells = [], {}
    for file, scene, own in _of_scenes(entries, scenes) if problems else entries:
        chosen = _select_integrators(own, registry, integrators) if integrators else own
        if own_method and own_method not in chosen:
            chosen = [*chosen, own_method]
        chosen = [i for i in chosen if i in own or i.spec not in placed[scene.spec]]
        placed[scene.spec].update(i.spec for i in chosen)
        if chosen:
            study, more = _expand(file, scene, chosen, registry)
            studies.append(study)
            cells.update(more)
    if not cells:
        reason = "Nothing is left to run; check the names that are given."
        raise SpecError(" ".join([reason, *dict.fromkeys(lost)]))
    plan = Plan(
        name=name,
        title="" if problems or integrators else profile.title or name,
        samples=profile.samples,
        budget_s=budget_s or profile.budget_s,
        studies=studies,
        integrators={
            text: planned(registry.integrator(text))
            for text in dict.fromkeys(cell.integrator for cell in cells.values())
        },
        mine=own_method.spec if own_method else "",
    )
    # A part of the profile goes without the atlas.
    atlas = not (problems or integrators) and profile.atlas
    return Suite(plan, cells, profile.memory_gib, atlas, tuple(dict.fromkeys(lost)))


class _Entry(NamedTuple):
    """A scene of a study with the study's integrators."""

    file: StudyFile
    scene: SceneFacts
    methods: list[MethodFacts]


def _usable(names: Sequence[str], facts_of: Callable[[str], object], lost: list[str]) -> list[str]:
    """Return the names that have facts; sentences on the others go to ``lost``."""
    usable = []
    for text in names:
        try:
            facts_of(text)
            usable.append(text)
        except Unavailable as error:
            lost.append(str(error))
    return usable


def planned(method: MethodFacts) -> IntegratorFacts:
    """Return the facts of an integrator that a plan keeps."""
    return IntegratorFacts(
        title=method.title,
        orders=method.orders,
        formulation=method.formulation,
        source=method.source,
        files=[Path(file).name for file in sorted(method.sources)],
    )


def _of_scenes(entries: list[_Entry], scenes: list[SceneFacts]) -> list[_Entry]:
    """Return the entries of these scenes; one that has none gets one with all integrators."""
    kept = [entry for entry in entries if entry.scene in scenes]
    there = [entry.scene for entry in kept]
    every = {method.spec: method for entry in entries for method in entry.methods}
    # Scenes of their own show the same as the others, if these agree on it.
    shown = {entry.file.figures for entry in entries}
    file = StudyFile(
        problems=[], integrators=[], figures=shown.pop() if len(shown) == 1 else FIGURES
    )
    extra = {scene.spec: scene for scene in scenes if scene not in there}
    return kept + [_Entry(file, scene, [*every.values()]) for scene in extra.values()]


def _select_integrators(
    own: list[MethodFacts], registry: Inventory, wanted: Sequence[str]
) -> list[MethodFacts]:
    chosen: dict[str, MethodFacts] = {}
    for text in wanted:
        asked = registry.integrator(text)
        bare = "[" not in text
        found = [i for i in own if i.spec == asked.spec or (bare and i.name == asked.name)]
        for integrator in found or [asked]:
            chosen[integrator.spec] = integrator
    return list(chosen.values())


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
        if (cell := Cell(scene.spec, integrator.spec, t_end, resolution))
    }
    study = Study(
        title=file.title or scene.spec,
        note=file.note,
        problem=scene.spec,
        t_end=t_end,
        figures=list(file.figures),
        components=_components(file, scene, registry),
        cells=list(cells),
    )
    return study, cells


def _components(file: StudyFile, scene: SceneFacts, registry: Inventory) -> list[str]:
    if not file.components:
        return []
    names = registry.components(scene.spec)  # needs JAX, which takes a while to load
    for text in file.components:
        for part in text.split(":", 1):  # "q2:q1" is the second over the first
            match = re.fullmatch(r"(q|v|a|lam|x|y)([1-9]\d{0,8})", part)
            if not match or int(match[2]) > len(names[match[1]]):
                raise SpecError(
                    f"{scene.spec} has no component {part!r}; give a group and a number such as "
                    f"q1, or two as q2:q1 for one over the other."
                )
    return list(file.components)


def resolution_of(
    scene: SceneFacts | MechatronicSystem,
    method: MethodFacts | Integrator,
    step: float | None = None,
    pattern: tuple[float, ...] | None = None,
    rtol: float | None = None,
    atol: float | None = None,
) -> Steps | Tolerances:
    """Return the steps or tolerances of a run.

    Raises
    ------
    SpecError
        If options of the other kind are given: steps to a method that chooses its own, or
        tolerances to a method with fixed steps.
    """

    def refuse(takes: str, **given: Any) -> None:
        for option, value in given.items():
            if value is not None:
                raise SpecError(f"{method.spec} takes {takes} instead of --{option}.")

    if method.controls == "step":
        refuse("fixed steps; give --step", rtol=rtol, atol=atol)
        return Steps(scene.nominal_step if step is None else step, pattern or (1.0,))
    refuse("steps of its own; give --rtol", step=step, pattern=pattern)
    return Tolerances(atol=atol) if rtol is None else Tolerances(rtol, atol)
