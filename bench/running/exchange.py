"""Runs of other programs, which are judged.

A file has the rows of one run; its step or tolerance, seconds and counts stand beside the rows, as
the author tells them.
"""

from __future__ import annotations

import csv
import hashlib
import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import NamedTuple
from zipfile import BadZipFile

import msgspec
import numpy as np

from bench.results.quantities import point_notes
from bench.results.records import TOLD, Environment, MethodFacts, Plan, SceneRecord, Study
from bench.results.store import Store
from bench.running.plan import FIGURES, Cell
from bench.running.process import PREPARING
from bench.running.worker import CellResult, Worker
from integrators.contract import Trajectory, Work
from integrators.resolutions import Steps, Tolerances
from problems.base.spec import SpecError, as_number, convert, is_name, options_of, suggest
from problems.base.text import said
from problems.equations.initial_values import consistent_start
from problems.system import MechatronicSystem
from problems.truth.reference import named_points
from problems.variables import VARIABLES

Resolution = Steps | Tolerances
#: Most rows of a file: errors are no better known by more.
MOST_ROWS = 1_000_000
#: Counts that an author may tell, and all facts.
_COUNTS = tuple(field.name for field in fields(Work))
FACTS = ("step", "rtol", "atol", "seconds", "method", *_COUNTS)
#: Rows begin where the scene does, up to this part of the size of each group, and of the interval.
_SAME_START, _SAME_TIME = 1e-6, 1e-9
_FACT = re.compile(r"""([\w.:]+)\s*=\s*("[^"]*"|'[^']*'|\S+)""")


class Told(NamedTuple):
    """The contents of a file: facts in words, and columns ``(k,)`` by their names."""

    file: str
    facts: dict[str, str]
    columns: dict[str, np.ndarray]
    digest: str

    def number(self, name: str) -> float | None:
        """Return a fact that is a number from 0 up, or None if the file does not tell it."""
        if 0 <= (value := as_number(self.facts.get(name, 0))) < math.inf:
            return value if name in self.facts else None
        raise SpecError(f"{self.file} says {name}={self.facts[name]}; give a number from 0 up.")


# ---- files -------------------------------------------------------------------------------
def read_told(path: Path) -> Told:
    """Read a file of rows.

    It is CSV with a head (facts stand in comments as ``# step=0.01 seconds=0.2``), or ``.npz`` or
    ``.json`` with an entry for each column, or for each group a table ``(k, n)``, and each fact.

    Raises
    ------
    SpecError
        If it cannot be read, has no times or too many rows, or its columns are not finite numbers
        of the same length.
    """
    read = _read_entries if path.suffix in (".npz", ".json") else _read_csv
    try:
        facts, columns = read(path)
        content = hashlib.sha256(path.read_bytes()).hexdigest()
    except SpecError as error:
        raise SpecError(f"{path}: {error}") from None
    except OSError as error:
        raise SpecError(f"{path} cannot be read: {error.strerror or error}.") from None
    except (ValueError, KeyError, TypeError, EOFError, BadZipFile) as error:
        raise SpecError(f"{path} is not as expected: {said(error)}.") from None
    if "t" not in columns:
        raise SpecError(f"{path} has no column t; its columns are {', '.join(columns) or 'none'}.")
    count = len(columns["t"])
    if not 2 <= count <= MOST_ROWS:
        more = "write fewer, such as every tenth" if count > MOST_ROWS else "write more"
        raise SpecError(f"{path} has {count} rows; 2 to {MOST_ROWS} are judged: {more}.")
    for name, column in columns.items():
        if column.shape != (count,):
            raise SpecError(f"{path}: {name} has shape {column.shape}, and t has {count} rows.")
        if not np.isfinite(column).all():
            k = int(np.argmin(np.isfinite(column)))
            raise SpecError(
                f"{path}: {name} is {column[k]} in row {k + 1} (t={columns['t'][k]:g} s); leave "
                "out columns that are not known, and rows after the end of a run."
            )
    return Told(str(path), facts, columns, content)


def _read_csv(path: Path) -> tuple[dict[str, str], dict[str, np.ndarray]]:
    with path.open("rb") as file:
        lines = sum(block.count(b"\n") for block in iter(lambda: file.read(2**20), b""))
    if lines > 2 * MOST_ROWS:
        return {}, {"t": np.empty(lines)}
    facts, rows = {}, []
    for line in path.read_text(encoding="utf-8-sig").splitlines():
        if line.lstrip().startswith("#"):
            facts |= {name: value.strip("\"'") for name, value in _FACT.findall(line)}
        elif line.strip():
            rows.append(line)
    if not rows:
        raise SpecError("it is empty; write a head such as t,q1,v1 and a row for each time.")
    sign = next((sign for sign in (";", "\t") if sign in rows[0]), ",")
    cells = next(csv.reader([rows[0]], delimiter=sign))
    head = [re.sub(r"\s*\[.*\]$", "", name.strip()) for name in cells]
    if twice := {name for name in head if head.count(name) > 1}:
        raise SpecError(f"it has the column {min(twice)!r} twice.")
    for k, row in enumerate(rows[1:], 1):
        if row.count(sign) != len(head) - 1 or (sign != "," and "," in row):
            raise SpecError(
                f"row {k} is {row[:60]!r}, and the head has {len(head)} columns; write numbers "
                "with a point, as 0.5, and a cell for each column."
            )
    table = np.loadtxt(rows[1:], delimiter=sign, ndmin=2) if rows[1:] else np.empty((0, len(head)))
    return facts, dict(zip(head, table.T, strict=True))


def _read_entries(path: Path) -> tuple[dict[str, str], dict[str, np.ndarray]]:
    """Facts and columns of entries: scalars are facts, tables ``(k, n)`` have numbered columns."""
    if path.suffix == ".npz":
        with np.load(path, allow_pickle=False) as archive:
            found = dict(archive)
    else:
        found = json.loads(path.read_text(encoding="utf-8"))
    if not isinstance(found, dict):
        raise SpecError("it is no object with a list for each column.")
    facts, columns = {}, {}
    for name, value in ((name, np.asarray(entry)) for name, entry in found.items()):
        if not value.ndim:
            facts[name] = str(value)
        elif value.dtype.kind not in "iuf" or value.ndim > 2:
            raise SpecError(f"{name} is an array of {value.dtype} of shape {value.shape}.")
        elif value.ndim == 2:
            columns |= {f"{name}{i}": column for i, column in enumerate(value.T.astype(float), 1)}
        else:
            columns[name] = value.astype(float)
    return facts, columns


# ---- rows --------------------------------------------------------------------------------
def places(scene: MechatronicSystem) -> dict[str, tuple[str, int]]:
    """Return the group and the place of each column that a file may have.

    A column is named by its number ("v2"), its group and name ("v:th"), or its name alone: that of
    a coordinate, multiplier, state or output.
    """
    found: dict[str, tuple[str, int]] = {}
    for group in VARIABLES:
        for i, component in enumerate(scene.components(group)):
            found[f"{group}{i + 1}"] = found[f"{group}:{component.name}"] = group, i
    for group in ("q", "lam", "x", "y"):
        for i, component in enumerate(scene.components(group)):
            found.setdefault(component.name, (group, i))
    return found


def trajectory_of(scene: MechatronicSystem, told: Told) -> tuple[Trajectory, list[str]]:
    """Return the rows of a file as a run that reached the end, and the names of what it lacks.

    Components that the file lacks are NaN.

    Raises
    ------
    SpecError
        If a column is not known, times do not increase from the start of the scene within its
        interval, or the first row is not the scene's start.
    """
    t, known, notes = _times(scene, told), places(scene), {}
    shapes = {group: (len(t), scene.sizes.of(group)) for group in (*VARIABLES, "xdot")}
    rows = {group: np.full(shape, np.nan) for group, shape in shapes.items()}
    points = named_points(scene, scene.start().q[None])
    of_points = [note for name, p in points.items() for note in point_notes(name, p.shape[1])]
    axes = {note.partition(" [")[0]: note for note in of_points}
    for name, column in told.columns.items():
        if name in known:
            group, i = known[name]
            rows[group][:, i] = column
        elif name in axes:
            notes[axes[name]] = column
        elif name != "t":
            raise SpecError(
                f"{told.file}: {scene.spec} has no {name!r}; {suggest(name, [*known, *axes])}."
            )
    for group, values in zip("qvx", scene.start(), strict=True):
        first, size = rows[group][0], np.abs(values).max(initial=1.0)
        if (off := np.abs(first - values) > _SAME_START * size).any():
            i = int(off.argmax())
            raise SpecError(
                f"{told.file} starts with {group}{i + 1}={first[i]:.9g}, and {scene.spec} with "
                f"{values[i]:.9g}; start there, or set the scene's start by --set."
            )
    lacking = []
    for group in VARIABLES:
        missing = np.flatnonzero(np.isnan(rows[group][0]))
        whole = len(missing) == scene.sizes.of(group)
        lacking += [group] * (len(missing) > 0) if whole else [f"{group}{i + 1}" for i in missing]
    counts = {name: told.number(name) for name in _COUNTS}
    work = Work(**{name: None if n is None else int(n) for name, n in counts.items()})
    q, v, a, lam, x, y, xdot = rows.values()
    return Trajectory(t, q, v, a, lam, x, xdot, y, work=work, notes=notes), lacking


def _times(scene: MechatronicSystem, told: Told) -> np.ndarray:
    """The times, of which the first is the start of the scene to the last digit."""
    t, (t0, t_end) = told.columns["t"].copy(), scene.interval
    slack = _SAME_TIME * (t_end - t0)
    if len(back := np.flatnonzero(np.diff(t) <= 0)):
        k = int(back[0])
        raise SpecError(
            f"{told.file}: t={t[k + 1]:.9g} s in row {k + 2} follows t={t[k]:.9g} s; write times "
            "that increase."
        )
    if abs(t[0] - t0) > slack or t[-1] > t_end + slack:
        raise SpecError(
            f"{told.file} has times from {t[0]:.9g} s to {t[-1]:.9g} s; {scene.spec} starts at "
            f"{t0:g} s and ends at {t_end:g} s."
        )
    t[0], t[-1] = t0, t_end if t[-1] > t_end - slack else t[-1]
    return t


def template(worker: Worker, problem: str) -> str:
    """Do a job of a worker: return an empty file of rows with its head and the scene's start."""
    scene = worker.problem(problem)
    z = consistent_start(scene).z
    names = [f"{group}{i + 1}" for group in VARIABLES for i in range(scene.sizes.of(group))]
    values = [scene.interval[0], *np.concatenate([getattr(z, group) for group in VARIABLES])]
    told = ", ".join(
        f"{group}{i}: {component.text}"
        for group in VARIABLES
        for i, component in enumerate(scene.components(group), 1)
    )
    return (
        f'# scene="{scene.spec}", from {scene.interval[0]:g} s to {scene.interval[1]:g} s; {told}\n'
        "# step=0.01 method=my_method seconds=0.1 residuals=1000\n"
        f"t,{','.join(names)}\n{','.join(f'{value:.17g}' for value in values)}\n"
    )


# ---- judgement ---------------------------------------------------------------------------
class Judgement(NamedTuple):
    """Results of all files, their scene if it is described, their method, and what each lacks."""

    results: list[CellResult]
    scene: SceneRecord | None
    method: MethodFacts
    lacking: list[list[str]]


def judge_job(
    worker: Worker,
    problem: str,
    files: Sequence[str],
    given: Mapping[str, Sequence[float]],
    method: str | None,
    describe: bool,
) -> Judgement:
    """Do a job of a worker: measure the errors of the runs in files against the reference.

    Parameters
    ----------
    given
        Facts that the files do not tell: "step" or "rtol", of a number for each file.
    method
        Name of the method; None: as the files tell it.
    describe
        Whether the scene is described, too.

    Raises
    ------
    SpecError
        If a file is not as `read_told` and `trajectory_of` want it, tells facts that are not known,
        or other parameters than the scene's, or the files are not runs of one method up to one end.
    """
    worker.notify(PREPARING, "reading files")
    scene = worker.problem(problem)
    told = [read_told(Path(file)) for file in files]
    runs: dict[Resolution, Trajectory] = {}
    lacking = []
    for k, one in enumerate(told):
        _check_facts(scene, one)
        resolution = _resolution(one, {n: v[k] for n, v in given.items()})
        if resolution in runs:
            raise SpecError(f"{one.file} has the step or tolerance of a file before it.")
        runs[resolution], missing = trajectory_of(scene, one)
        lacking.append(missing)
    ends = {float(f"{run.t[-1]:.9g}") for run in runs.values()}
    names = {one.facts.get("method", "told") if method is None else method for one in told}
    for word, found in (("end times", map(str, sorted(ends))), ("methods", sorted(names))):
        if len(several := [*found]) > 1:
            raise SpecError(f"The files have {word} {', '.join(several)}; judge one.")
    t_end = float(next(iter(runs.values())).t[-1])
    of_scene, facts = worker.inventory.problem(problem), _method(worker, names.pop(), runs, told)
    results = []
    for one, (resolution, run) in zip(told, runs.items(), strict=True):
        found = worker.judge(Cell(of_scene, facts, t_end, resolution), run)
        found.record.run_s = [seconds] if (seconds := one.number("seconds")) else []
        results.append(found)
    described = worker.scene(scene.spec, t_end) if describe else None
    return Judgement(results, described, facts, lacking)


def _method(
    worker: Worker, name: str, runs: Mapping[Resolution, Trajectory], told: Sequence[Told]
) -> MethodFacts:
    """The facts of the method that made these runs."""
    if not is_name(name) or len(name) > 100 or name in worker.registry.integrators:
        raise SpecError(
            f"The method {name!r} is not allowed: it is a method of stepbench, or no word of "
            "at most 100 letters, digits, '_', '.' and '-'; name yours by --method."
        )
    digest = hashlib.sha256("".join(one.digest for one in told).encode()).hexdigest()
    kinds = {type(resolution) for resolution in runs}
    if len(kinds) > 1:
        raise SpecError("Some files have steps and others tolerances; judge them one by one.")
    return MethodFacts(
        spec=name,
        name=name,
        title="Another program, whose rows are judged.",
        family=name,
        formulation=TOLD,
        controls="step" if kinds == {Steps} else "tolerance",
        source=f"{TOLD}: seconds, counts; rows of {', '.join(Path(one.file).name for one in told)}",
        fingerprint=digest[:12],
    )


def _resolution(told: Told, given: Mapping[str, float]) -> Resolution:
    step, rtol = (given.get(n, told.number(n)) for n in ("step", "rtol"))
    if (step is None) == (rtol is None):
        both = "neither step nor rtol" if step is None else "both a step and an rtol"
        raise SpecError(
            f"{told.file} tells {both}; write one of them, as '# step=0.01' before the head, or "
            "give --steps or --rtols."
        )
    return Steps(step or 0.0) if rtol is None else Tolerances(rtol, told.number("atol"))


def _check_facts(scene: MechatronicSystem, told: Told) -> None:
    """Refuse facts that are not known, and another scene or other parameters than the scene's."""
    parameters = options_of(type(scene))
    for name, value in told.facts.items():
        if name in parameters:
            own = getattr(scene, name)
            if convert(scene.name, parameters[name], value) != own:
                raise SpecError(
                    f"{told.file} says {name}={value}, and the scene has {name}={own}; judge it "
                    f"with --set {name}={value}."
                )
        elif name == "scene":
            if value not in (scene.spec, scene.name):
                raise SpecError(f"{told.file} is a run of {value}, not of {scene.spec}.")
        elif name not in FACTS:
            raise SpecError(
                f"{told.file} tells {name}={value}, which is no fact and no parameter; "
                f"{suggest(name, [*FACTS, 'scene', *parameters])}."
            )


def store_judgement(store: Store, found: Judgement) -> None:
    """Keep judged runs beside others; their times belong to a machine that nobody knows."""
    unknown = dict.fromkeys(("date", "command", "cpu", "platform", "clock"), TOLD)
    machine = Environment(cores=0, memory_gib=0.0, versions={}, **unknown)
    store.keep(machine)
    for record, rows in found.results:
        record.environment = machine.number
        store.save(record, rows)
    study = Study(
        title=f"{found.method.name}, {TOLD}",
        problem=found.results[0].record.problem,
        t_end=found.results[0].record.t_end,
        figures=[*FIGURES],
        cells=[record.key for record, _ in found.results],
    )
    plan = store.plan() or Plan(
        name="judged", title="Judged runs", samples=0, budget_s=60.0, studies=[]
    )
    others = [s for s in plan.studies if (s.title, s.problem) != (study.title, study.problem)]
    methods = plan.integrators | {found.method.spec: found.method}
    store.keep(msgspec.structs.replace(plan, studies=[*others, study], integrators=methods))
    if found.scene:
        store.keep(found.scene)
