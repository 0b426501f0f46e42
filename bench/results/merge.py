"""Union of the stores of several machines; each record keeps the machine that measured it."""

from __future__ import annotations

import datetime
import os
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec

from bench.results.records import INTERRUPTED, Environment, Plan, Record, SceneRecord, Study
from bench.results.store import FILE, Store
from problems.spec import SpecError


@dataclass
class Source:
    """The contents of a store without the sampled values, which are copied one by one."""

    folder: Path
    plan: Plan | None
    environments: dict[int, Environment]
    scenes: dict[tuple[str, float], SceneRecord]
    records: dict[str, Record]

    def worth(self, record: Record) -> tuple[bool, datetime.datetime]:
        """Return whether a record has a verdict, and when it was measured (or long ago)."""
        environment = self.environments.get(record.environment)
        return record.status != INTERRUPTED, _date(environment.date if environment else "")


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
    sources = [_read(folder) for folder in folders]
    kept: dict[str, Source] = {}
    twice: dict[str, None] = {}
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
    winners = [kept[key].folder for key in twice]
    return Merged(
        records=len(kept),
        stores=len(sources),
        environments=count,
        twice={folder: winners.count(folder) for folder in dict.fromkeys(winners)},
    )


def _read(folder: Path) -> Source:
    with Store(folder) as store:
        return Source(folder, store.plan(), store.environments(), store.scenes(), store.records())


def _write(sources: Sequence[Source], kept: dict[str, Source], folder: Path) -> int:
    """Write the new store; returns the number of its environments."""
    numbers: dict[bytes, int] = {}
    with Store(folder, create=True) as store:
        plan = _united(source.plan for source in sources if source.plan)
        if plan:
            store.save_plan(plan)
        for source in sorted(sources, key=_latest):
            for scene in source.scenes.values():
                store.save_scene(scene)
            with Store(source.folder) as origin:
                for run in origin.long_runs().values():
                    store.save_long_run(run)
                for found in origin.experiments().values():
                    store.save_experiment(found)
                for integrator, damping in origin.damping().items():
                    store.save_damping(integrator, damping)
        for source in sources:
            own = {}
            for number, environment in source.environments.items():
                # A store may hold what it was merged from, or be a copy: one invocation is one.
                same = msgspec.json.encode(environment)
                if same not in numbers:
                    numbers[same] = store.save_environment(environment)
                own[number] = numbers[same]
            with Store(source.folder) as origin:
                for key, record in source.records.items():
                    if kept[key] is source:
                        _copy(record, own, origin, store)
    return len(numbers)


def _copy(record: Record, numbers: Mapping[int, int], origin: Store, store: Store) -> None:
    # A record is stored without its samples, which have a table of their own.
    environment = numbers.get(record.environment, 0)
    bare = msgspec.structs.replace(record, environment=environment, run_s=[], rounds=[])
    store.save(bare, origin.rows(record.key))
    for (invocation, number), seconds in zip(record.rounds, record.run_s, strict=True):
        store.add_sample(record.key, number, seconds, numbers.get(invocation, 0))


def _united(plans: Iterable[Plan]) -> Plan | None:
    """One plan of all studies; studies that differ only in their cells become one."""
    plans = list(plans)
    if not plans:
        return None
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


def _latest(source: Source) -> datetime.datetime:
    return max((source.worth(record)[1] for record in source.records.values()), default=_date(""))


def _date(text: str) -> datetime.datetime:
    try:
        date = datetime.datetime.fromisoformat(text)
    except ValueError:
        return datetime.datetime.min.replace(tzinfo=datetime.UTC)
    return date if date.tzinfo else date.replace(tzinfo=datetime.UTC)
