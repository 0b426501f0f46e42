"""Union of the stores of several machines; each record keeps the machine that measured it."""

from __future__ import annotations

import datetime
import os
import tempfile
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import msgspec

from bench.results.drift import LongRun
from bench.results.experiments import ExperimentResult
from bench.results.records import INTERRUPTED, Damping, Plan, Record, SceneRecord, Study
from bench.results.store import FILE, Store
from problems.spec import SpecError

#: Date of records whose environment tells none.
_LONG_AGO = datetime.datetime.min.replace(tzinfo=datetime.UTC)


class _Source:
    """A store with all that it holds but the sampled values, which are copied one by one."""

    def __init__(self, store: Store) -> None:
        self.store, self.plan = store, store.plan()
        self.environments, self.records = store.environments(), store.records()
        self.measured = max(map(self._date, self.records.values()), default=_LONG_AGO)

    def worth(self, record: Record) -> tuple[bool, datetime.datetime]:
        """Return whether a record has a verdict, and when it was measured (or long ago)."""
        return record.status != INTERRUPTED, self._date(record)

    def _date(self, record: Record) -> datetime.datetime:
        environment = self.environments.get(record.environment)
        try:
            date = datetime.datetime.fromisoformat(environment.date if environment else "")
        except ValueError:
            return _LONG_AGO
        return date if date.tzinfo else date.replace(tzinfo=datetime.UTC)


@dataclass
class Merged:
    """Counts of a union; ``twice`` counts, by folder, the kept records of cells that came twice."""

    records: int
    stores: int
    environments: int
    twice: dict[Path, int]


def merge(folders: Sequence[Path], out: Path) -> Merged:
    """Put the stores of the folders into a new one.

    Of a cell that several stores hold, the record that was measured last is kept, of those
    measured at one time the one of the folder named last. Scenes follow the same rule, by the
    last measurement of their store.

    Raises
    ------
    SpecError
        If there are fewer than two folders, or ``out`` holds results already.
    bench.results.store.StoreError
        If a store cannot be read, or the new one not be written; then there is none.
    """
    if len(folders) < 2:
        raise SpecError("To merge takes two folders or more; name them before --out.")
    if (out / FILE).exists():
        raise SpecError(f"{out} holds results already; name a new folder with --out.")
    kept: dict[str, _Source] = {}
    twice: dict[str, None] = {}
    with ExitStack() as opened:
        sources = [_Source(opened.enter_context(Store(folder))) for folder in folders]
        for source in sources:
            for key, record in source.records.items():
                other = kept.get(key)
                if other is not None:
                    twice[key] = None
                    if source.worth(record) < other.worth(other.records[key]):
                        continue
                kept[key] = source
        out.mkdir(parents=True, exist_ok=True)
        # Only a store that is whole takes its place.
        with tempfile.TemporaryDirectory(dir=out, prefix="merging-") as scratch:
            count = _write(sources, kept, Path(scratch))
            os.replace(Path(scratch) / FILE, out / FILE)
    return Merged(
        records=len(kept),
        stores=len(sources),
        environments=count,
        twice=Counter(kept[key].store.folder for key in twice),
    )


def _write(sources: Sequence[_Source], kept: dict[str, _Source], folder: Path) -> int:
    """Write the new store; returns the number of its environments."""
    numbers: dict[bytes, int] = {}
    with Store(folder, create=True) as store:
        if plans := [source.plan for source in sources if source.plan]:
            store.keep(_united(plans))
        for source in sorted(sources, key=lambda source: source.measured):
            store.take(source.store, (SceneRecord, LongRun, ExperimentResult, Damping))
        for source in sources:
            own = {}
            for number, environment in source.environments.items():
                # A store may hold what it was merged from, or be a copy: one invocation is one.
                same = msgspec.json.encode(environment)
                if same not in numbers:
                    numbers[same] = store.save_environment(environment)
                own[number] = numbers[same]
            for key, record in source.records.items():
                if kept[key] is source:
                    _copy(record, own, source.store, store)
    return len(numbers)


def _copy(record: Record, numbers: Mapping[int, int], origin: Store, store: Store) -> None:
    # A record is stored without its samples, which have a table of their own.
    environment = numbers.get(record.environment, 0)
    bare = msgspec.structs.replace(record, environment=environment, run_s=[], rounds=[])
    store.save(bare, origin.rows(record.key))
    for (invocation, number), seconds in zip(record.rounds, record.run_s, strict=True):
        store.add_sample(record.key, number, seconds, numbers.get(invocation, 0))


def _united(plans: Sequence[Plan]) -> Plan:
    """One plan of all studies; studies that differ only in their cells become one."""
    studies: dict[bytes, Study] = {}
    for study in (study for plan in plans for study in plan.studies):
        about = msgspec.json.encode(msgspec.structs.replace(study, cells=[]))
        cells = [*(studies[about].cells if about in studies else []), *study.cells]
        studies[about] = msgspec.structs.replace(study, cells=list(dict.fromkeys(cells)))
    return Plan(
        name=" + ".join(dict.fromkeys(plan.name for plan in plans)),
        title=" + ".join(dict.fromkeys(plan.title for plan in plans))
        if all(plan.title for plan in plans)
        else "",
        samples=max(plan.samples for plan in plans),
        budget_s=max(plan.budget_s for plan in plans),
        studies=list(studies.values()),
        mine=next((plan.mine for plan in plans if plan.mine), ""),
    )
