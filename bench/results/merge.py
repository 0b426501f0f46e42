"""Union of the stores of several machines; each record keeps the machine that measured it."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

import msgspec

from bench.results.drift import LongRun
from bench.results.experiments import ExperimentResult
from bench.results.records import INTERRUPTED, Plan, SceneRecord, Study
from bench.results.store import FILE, Store
from problems.base.spec import SpecError


def merge(folders: Sequence[Path], out: Path) -> tuple[int, int]:
    """Put the stores of the folders into a new one, one after the other.

    Of a cell or a scene that several stores hold, that of the folder named last is kept; a run that
    was interrupted takes no place of another.

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
        plans = [plan for store in stores if (plan := store.plan())]
        cells = [store.records() for store in stores]
        out.mkdir(parents=True, exist_ok=True)
        # Only a store that is whole takes its place.
        with tempfile.TemporaryDirectory(dir=out, prefix="merging-") as scratch:
            with Store(Path(scratch), create=True) as new:
                if plans:
                    new.keep(_united(plans))
                # A store may hold what it was merged from, or be a copy: one invocation is one.
                known: dict[bytes, int] = {}
                kept: set[str] = set()
                for store, records in zip(stores, cells, strict=True):
                    new.take(store, (SceneRecord, LongRun, ExperimentResult))
                    numbers = {0: 0}
                    for n, machine in store.environments().items():
                        key = msgspec.json.encode(machine)
                        numbers[n] = known[key] = known.get(key) or new.save_environment(machine)
                    for key, record in records.items():
                        if record.status == INTERRUPTED and key in kept:
                            continue
                        kept.add(key)
                        # Samples have a table of their own.
                        own = {"environment": numbers.get(record.environment, 0)}
                        bare = msgspec.structs.replace(record, run_s=[], rounds=[], **own)
                        new.save(bare, store.rows(key))
                        for (n, number), s in zip(record.rounds, record.run_s, strict=True):
                            new.add_sample(key, number, s, numbers.get(n, 0))
            os.replace(Path(scratch) / FILE, out / FILE)
    return len(kept), len(known)


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
