"""A store with one of everything, for tests that change it behind its back."""

import sqlite3
from contextlib import closing
from pathlib import Path

import msgspec

from bench.results.records import Environment, Plan, Record, Rows, SceneRecord
from bench.results.store import FILE, Store
from bench.results.studies import CaseResult, Drift, Expected, ExperimentResult, LongRun, PartResult

NO_ROWS = Rows(t=[])
AN_EXPERIMENT = ExperimentResult(
    name="e", number=1, title="", claim="", remedy="", source="", parts=[]
)
#: One with a chart, as pages show it.
A_SHOWN_EXPERIMENT = msgspec.structs.replace(
    AN_EXPERIMENT,
    **dict.fromkeys(("title", "remedy", "source"), "A word."),
    claim="Accelerations that a loop feeds back.",
    parts=[
        PartResult(
            text="a part",
            quantity="error",
            take="slope",
            healthy=(1.8, None),
            cases=[
                CaseResult(
                    label="mine", integrator="mine", family="other", axis="h", x=[0.1, 0.05],
                    y=[0.2, 0.1], number=1.0, expected=Expected((0.9, 1.1), "theory", "", "reason"),
                    as_expected=True, healthy=False,
                )
            ],
        )
    ],
)  # fmt: skip


def atlas_with(method, *names):
    """Experiments of these names in which a method fails and another one is spared."""
    given = {"label": "", "family": "", "axis": "", "x": [], "y": [], "number": None}
    given |= {"expected": None, "as_expected": None}
    cases = [
        CaseResult(integrator=method, healthy=False, **given),
        CaseResult(integrator="spared", healthy=True, **given),
    ]
    part = PartResult(text="", quantity="", take="last", healthy=(0.0, 1.0), cases=cases)
    made = ({"name": name, "title": f"About {name}: it fails", "parts": [part]} for name in names)
    return {own["name"]: msgspec.structs.replace(AN_EXPERIMENT, **own) for own in made}


A_LONG_RUN = LongRun(
    problem="pendulum",
    integrator="newmark",
    status="ok",
    message="",
    asked=100,
    steps=100,
    h=0.1,
    t_end=10.35,
    rows=101,
    t=[5.35, 10.35],
    drifts={
        "energy": Drift(
            largest=0.5, per_s=0.05, straight=1.0, apart=0.55, least=[0.0, 0.25], most=[0.25, 0.5]
        )
    },
)


def a_record(key="k", **more):
    given = {
        "problem": "pendulum",
        "integrator": "newmark",
        "family": "f",
        "formulation": "index3",
        "controls": "step",
        "h": 0.1,
        "pattern": (0.3, 0.7),
        "t0": 0.35,
        "t_end": 1.35,
        "status": "ok",
        "errors": {"q": {"end": 1e-3, "max": None}},
        "work": {"steps": 10},
        "constraint": {"position": 1e-12},
        "reference_error": {"q": {"end": 1e-15}},
    } | more
    return Record(key=key, **given)


A_SCENE = SceneRecord(
    problem="pendulum",
    t_end=1.35,
    title="A pendulum.",
    components={"q": ["X", "Y"]},
    sizes={"nq": 2},
    t0=0.35,
    reference_method="closed form",
    reference_error={"q": 1e-15},
    reference=Rows(t=[0.35], values={"q": [[0.0, 1.0]]}),
)


def change(folder: Path, sql: str) -> None:
    """Change a store behind its back."""
    with closing(sqlite3.connect(folder / FILE)) as db, db:
        db.execute(sql)


def filled(folder: Path) -> Path:
    """A folder with a store that has one of everything."""
    machine = Environment(
        date="", command="", cpu="", cores=1, memory_gib=1.0, platform="", versions={}
    )
    with Store(folder, create=True) as store:
        store.keep(Plan(name="p", title="", samples=1, budget_s=1.0, studies=[]))
        store.keep(machine)
        store.keep(A_SCENE)
        store.keep(AN_EXPERIMENT)
        store.keep(A_LONG_RUN)
        store.save(a_record(), NO_ROWS)
        store.add_sample("k", 0, 1.0)
    return folder
