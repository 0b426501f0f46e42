"""Rate methods on scenes: the cheapest resolution that meets a rule, by runs in a store."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import msgspec

from bench.plugins.facts import MethodFacts, SceneFacts
from bench.results.quantities import ASKED, ERROR_NAMES, NORMS, group_and_norm
from bench.results.records import UNSUPPORTED, Record, Study
from bench.results.store import Store
from bench.running.inventory import Inventory
from bench.running.plan import Cell, Suite
from bench.running.profiles import FIGURES
from bench.running.runner import Runner
from bench.running.search import Sizes, bracket
from bench.running.session import measure_suite, time_suite
from problems.spec import SpecError

#: The change of energy, which a rule may limit like an error.
ENERGY = "energy"


class Demand(NamedTuple):
    """A demand of a rule: an error, in words and as a function of a run, and its limit.

    ``floor`` gives the reference's own error, if the error is one against the reference.
    """

    title: str
    limit: float
    error: Callable[[Record], float | None]
    floor: Callable[[Record], float] = lambda record: 0.0

    def __str__(self) -> str:
        return f"{self.title} <= {self.limit:g}"

    def of(self, record: Record) -> float:
        """Return the error of a run; a run that failed has an infinite one."""
        found = self.error(record) if record.status == "ok" else None
        return math.inf if found is None else found


def demand(text: str) -> Demand:
    """Read a demand as a person writes it: "a:1e-3", "q:end:1e-6" or "energy:1e-4".

    Raises
    ------
    SpecError
        If it is none of these.
    """
    what, _, last = text.rpartition(":")
    try:
        limit = float(last)
    except ValueError:
        limit = math.nan
    if not (what and 0 < limit < math.inf):
        raise SpecError(
            f"{text!r} is no demand; give a quantity and its largest error, such as a:1e-3, "
            f"q:end:1e-6 or {ENERGY}:1e-4."
        )
    if what == ENERGY:
        return Demand("change of energy", limit, lambda record: record.energy_drift)
    group, norm = group_and_norm(what, ASKED)
    return Demand(
        f"error in {ERROR_NAMES[group]} ({NORMS[norm]})",
        limit,
        lambda record: record.error(group, norm),
        lambda record: record.floor(group, norm),
    )


@dataclass
class Candidate:
    """A method on a scene, with the cells and records of its search by their sizes."""

    scene: SceneFacts
    method: MethodFacts
    t_end: float
    cells: dict[float, Cell] = field(default_factory=dict)
    runs: dict[float, Record] = field(default_factory=dict)

    @property
    def refusal(self) -> str:
        """The reason why the method does not take the scene, if so."""
        return next((r.message for r in self.runs.values() if r.status == UNSUPPORTED), "")

    def next(self, rule: Sequence[Demand]) -> Cell | None:
        """Return the cell to try next for any of the demands."""
        if self.refusal:
            return None
        sizes = Sizes.of(self.scene, self.method, self.t_end)
        for asked in rule:
            size = sizes.next(self.errors(asked), asked.limit)
            if size is not None:
                resolution = sizes.resolution(size)
                cell = Cell(self.scene.spec, self.method.spec, self.t_end, resolution)
                return self.cells.setdefault(size, cell)
        return None

    def take(self, records: Mapping[str, Record]) -> None:
        """Take the records of all cells that have one."""
        self.runs = {s: records[c.key] for s, c in self.cells.items() if c.key in records}

    def errors(self, asked: Demand) -> dict[float, float]:
        """Return the errors of a demand by sizes."""
        return {size: asked.of(record) for size, record in self.runs.items()}

    def best(self, asked: Demand) -> Record | None:
        """Return the run with the coarsest good size, if there is one."""
        good = bracket(self.errors(asked), asked.limit).good
        return None if good is None else self.runs[good]

    @property
    def obstacle(self) -> str:
        """The reason why finer sizes do not help: the end of the finest run."""
        finest = self.runs[min(self.runs)]
        if finest.status == "ok":
            return f"Errors do not fall below that; the finest run had {finest.resolution}."
        return f"{finest.status}: {finest.message}"

    def nearest(self, asked: Demand) -> Record:
        """Return the run with the smallest error."""
        return min(self.runs.values(), key=asked.of)


def rate(
    candidates: Sequence[Candidate],
    rule: Sequence[Demand],
    suite: Suite,
    store: Store,
    registry: Inventory,
    runner: Runner,
) -> None:
    """Search for each candidate's coarsest resolution for each demand, and take its time.

    Runs are stored as they end; those that the store has are not made again.

    Parameters
    ----------
    suite
        Limits and number of timings; its cells are those of the candidates.
    """

    def restricted(cells: Iterable[Cell]) -> Suite:
        plan = msgspec.structs.replace(suite.plan, studies=_studies(candidates))
        return replace(suite, plan=plan, cells={cell.key: cell for cell in cells})

    while cells := [cell for c in candidates if (cell := c.next(rule))]:
        measure_suite(restricted(cells), store, registry, runner)
        records = store.records()
        for c in candidates:
            c.take(records)
    best = {r.key for c in candidates for asked in rule if (r := c.best(asked))}
    every = (cell for c in candidates for cell in c.cells.values())
    time_suite(restricted(cell for cell in every if cell.key in best), store, registry, runner)
    records = store.records()
    for c in candidates:
        c.take(records)


def _studies(candidates: Sequence[Candidate]) -> list[Study]:
    """Return a study of each scene with all its runs."""
    return [
        Study(
            title=problem,
            problem=problem,
            t_end=t_end,
            figures=list(FIGURES),
            cells=[
                cell.key
                for c in candidates
                if (c.scene.spec, c.t_end) == (problem, t_end)
                for cell in c.cells.values()
            ],
        )
        for problem, t_end in dict.fromkeys((c.scene.spec, c.t_end) for c in candidates)
    ]
