"""Union of the stores of several machines; each record keeps the machine that measured it."""

from __future__ import annotations

import datetime
import os
import tempfile
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path

import msgspec

from bench.results.drift import LongRun
from bench.results.experiments import ExperimentResult
from bench.results.records import (
    INTERRUPTED,
    Damping,
    Environment,
    Plan,
    Record,
    SceneRecord,
    Study,
)
from bench.results.store import FILE, Store
from problems.spec import SpecError

#: Date of records whose environment tells none.
_LONG_AGO = datetime.datetime.min.replace(tzinfo=datetime.UTC)


def merge(folders: Sequence[Path], out: Path) -> tuple[int, int]:
    """Put the stores of the folders into a new one.

    Of a cell that several stores hold, the record that was measured last is kept, of those
    measured at one time the one of the folder named last. Scenes follow the same rule, by the
    last measurement of their store.

    Returns
    -------
    tuple
        Numbers of records and of environments.

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
    with ExitStack() as opened:
        stores = [opened.enter_context(Store(folder)) for folder in folders]
        machines = [store.environments() for store in stores]
        records = [
            (_worth(record, own), k, record)
            for k, (store, own) in enumerate(zip(stores, machines, strict=True))
            for record in store.records().values()
        ]
        out.mkdir(parents=True, exist_ok=True)
        # Only a store that is whole takes its place.
        with tempfile.TemporaryDirectory(dir=out, prefix="merging-") as scratch:
            with Store(Path(scratch), create=True) as new:
                if plans := [plan for store in stores if (plan := store.plan())]:
                    new.keep(_united(plans))
                last = [max((w for w, j, _ in records if j == k), default=(False, _LONG_AGO))
                        for k in range(len(stores))]  # fmt: skip
                for k in sorted(range(len(stores)), key=lambda k: last[k]):
                    new.take(stores[k], (SceneRecord, LongRun, ExperimentResult, Damping))
                # A store may hold what it was merged from, or be a copy: one invocation is one.
                known = {msgspec.json.encode(e): e for own in machines for e in own.values()}
                number = {key: new.save_environment(e) for key, e in known.items()}
                numbers = [
                    {n: number[msgspec.json.encode(e)] for n, e in own.items()} for own in machines
                ]
                for _, k, record in sorted(records, key=lambda entry: entry[:2]):
                    _copy(record, numbers[k], stores[k], new)
                count = len(new.records()), len(number)
            os.replace(Path(scratch) / FILE, out / FILE)
    return count


def _worth(record: Record, machines: Mapping[int, Environment]) -> tuple[bool, datetime.datetime]:
    """Whether a record has a verdict, and when it was measured (or long ago)."""
    machine = machines.get(record.environment)
    try:
        date = datetime.datetime.fromisoformat(machine.date if machine else "")
    except ValueError:
        date = _LONG_AGO
    return record.status != INTERRUPTED, date if date.tzinfo else date.replace(tzinfo=datetime.UTC)


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
    titles = dict.fromkeys(plan.title for plan in plans)
    return Plan(
        name=" + ".join(dict.fromkeys(plan.name for plan in plans)),
        title=" + ".join(titles) if all(titles) else "",
        samples=max(plan.samples for plan in plans),
        budget_s=max(plan.budget_s for plan in plans),
        studies=list(studies.values()),
        mine=next((plan.mine for plan in plans if plan.mine), ""),
    )
