"""A whole store to be spoilt, and fixtures of it, for the attacks on stores."""

from __future__ import annotations

import shutil
import sqlite3
from contextlib import closing
from pathlib import Path

import msgspec
import pytest
from planted import everything, plant
from small_stores import A_LONG_RUN

from bench.results.experiments import CaseResult, Expected, ExperimentResult, PartResult
from bench.results.records import Damping, IntegratorFacts
from bench.results.store import FILE, Store

METHOD = "good[rho_inf=0.8]"
AN_EXPERIMENT = ExperimentResult(
    name="e",
    number=1,
    title="t",
    claim="c",
    remedy="r",
    source="s",
    parts=[
        PartResult(
            text="x",
            quantity="y",
            take="slope",
            healthy=(1.8, None),
            cases=[
                CaseResult(
                    label="l",
                    integrator=METHOD,
                    family="alpha",
                    axis="h",
                    x=[0.1, 0.05],
                    y=[1.0, 0.5],
                    number=1.0,
                    expected=Expected((0.9, 1.1), "theory", "", "reason"),
                    as_expected=True,
                    healthy=True,
                    history=([0.0, 1.0], [1.0, 2.0]),
                )
            ],
        )
    ],
)
#: A row of each kind: table, column, and the row's place.
PLACES = {
    "plan": ("meta", "value", "name = 'plan'"),
    "environments": ("environments", "value", "id = 1"),
    "scenes": ("scenes", "value", "problem = 'pendulum'"),
    "damping": ("damping", "value", f"integrator = '{METHOD}'"),
    "experiments": ("experiments", "value", "name = 'e'"),
    "long_runs": ("long_runs", "value", "key LIKE '%| 100 x%'"),
    "records": ("records", "value", f"key = 'pendulum | {METHOD} | h=0.1'"),
    "rows": ("records", "rows", f"key = 'pendulum | {METHOD} | h=0.1'"),
}


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A store with two rows or more of every kind."""
    few = [
        record
        for record in everything()
        if (record.h or 0) >= 0.025
        and record.integrator not in ("good[rho_inf=0.5]", "ringing[rho_inf=1]")
        and (record.rtol or 1) > 1e-5
    ]
    folder = plant(tmp_path_factory.mktemp("stores") / "good", few)
    known = Damping(omega_h=[0.1, 1.0], radius=[0.9, None], ratio=[0.1, 0.2])
    with Store(folder, create=True) as store:
        store.save_damping(METHOD, known)
        store.save_damping("poor", known)
        store.save_experiment(AN_EXPERIMENT)
        store.save_experiment(msgspec.structs.replace(AN_EXPERIMENT, name="f", number=2))
        store.save_long_run(A_LONG_RUN)
        store.save_long_run(msgspec.structs.replace(A_LONG_RUN, asked=200))
        store.save_environment(store.environments()[1])
        plan = store.plan()
        assert plan
        facts = {METHOD: IntegratorFacts(title="G", orders={"q": 2}, source="S")}
        store.save_plan(msgspec.structs.replace(plan, integrators=facts))
    return folder


@pytest.fixture(scope="module")
def whole(good: Path) -> dict[str, dict]:
    """All that the good store gives."""
    return content(good)


@pytest.fixture
def folder(good: Path, tmp_path: Path) -> Path:
    """A copy of the good store, to be spoilt."""
    return shutil.copytree(good, tmp_path / "spoilt")


def change(folder: Path, sql: str, *values: object) -> None:
    """Change a store behind its back."""
    with closing(sqlite3.connect(folder / FILE)) as db, db:
        db.execute(sql, values)


def content(folder: Path) -> dict[str, dict]:
    """All that a store gives, by table and key."""
    with Store(folder) as store:
        records = store.records()
        return {
            "plan": {"plan": store.plan()} if store.plan() else {},
            "environments": store.environments(),
            "scenes": store.scenes(),
            "damping": store.damping(),
            "experiments": store.experiments(),
            "long_runs": store.long_runs(),
            "measurements": store.measurements(),
            "records": records,
            "rows": {key: rows for key in records if (rows := store.rows(key)) and rows.t},
        }
