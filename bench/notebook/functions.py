"""The functions for notebooks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bench.commands import options
from bench.commands.orders import order_records
from bench.commands.pages import write_reports
from bench.commands.suite import run_suite
from bench.notebook.answers import Orders, Results, Solution, pandas_module
from bench.results.flat_rows import flatten
from bench.results.orders import order_summary
from bench.results.quantities import GROUPS
from bench.results.records import Rows, endings
from bench.results.store import Store
from bench.running.inventory import Inventory
from bench.running.plan import make_suite
from bench.running.profiles import read_profile
from bench.running.progress import OnStandardError
from bench.running.solve import Request
from bench.running.solve import solve as run_one
from problems.spec import SpecError

#: Processor time in s after which a run is stopped, if no other is given.
BUDGET_S = 300.0


def solve(
    problem: str,
    integrator: str,
    *,
    step: float | None = None,
    pattern: Sequence[float] | None = None,
    rtol: float | None = None,
    atol: float | None = None,
    t_end: float | None = None,
    parameters: Mapping[str, Any] | None = None,
    plugins: Sequence[str | Path] = (),
    samples: int = 7,
    budget: float = BUDGET_S,
) -> Solution:
    """Run one integrator on one scene, as ``stepbench solve`` does.

    Parameters
    ----------
    problem, integrator
        Names, with options in brackets: ``"generalized_alpha[rho_inf=0.8]"``.
    step, pattern
        Step size in s of a method with fixed steps, and fractions of it that take turns.
    rtol, atol
        Tolerances of a method that chooses its steps.
    t_end
        End time in s; the scene's own if None.
    parameters
        Parameters of the scene.
    plugins
        Python files, or folders of them, with more scenes or integrators.
    samples
        How often the run is timed.
    budget
        Processor time in s after which the run is stopped.

    Returns
    -------
    Solution
        Values, errors and work. A run that fails is one with a ``status`` and a ``message``.

    Raises
    ------
    problems.spec.SpecError
        If a name, an option or a number is not known or not allowed.

    Examples
    --------
    >>> found = solve("pendulum", "newmark", step=0.01, parameters={"th0": 1.0})
    >>> found.errors["q"]["max"] < 1e-3
    True
    """
    _check(budget=budget, samples=samples)
    fractions = tuple(pattern) if pattern else None
    sizes = {"step": step, "pattern": fractions, "rtol": rtol, "atol": atol, "t_end": t_end}
    request = Request(problem, integrator, parameters or {}, **sizes, samples=samples)
    (record, rows), names = run_one(request, plugins, budget, OnStandardError())
    return Solution(
        problem=record.problem,
        integrator=record.integrator,
        resolution=record.resolution,
        status=record.status,
        message=" ".join(record.notes) or record.message,
        t=np.array(rows.t),
        **{group: _array(rows, group) for group in GROUPS},
        components=names,
        errors=record.errors,
        work=record.work,
        operations=record.cost("operations"),
        seconds=record.seconds,
        _rows=rows,
    )


def order(
    problem: str,
    integrator: str,
    steps: Sequence[float] | None = None,
    *,
    pattern: Sequence[float] | None = None,
    t_end: float | None = None,
    parameters: Mapping[str, Any] | None = None,
    plugins: Sequence[str | Path] = (),
    budget: float = BUDGET_S,
) -> Orders:
    """Fit the order of convergence of a fixed-step integrator, as ``stepbench order`` does.

    Parameters
    ----------
    steps
        Step sizes in s, three at least; halvings of the scene's nominal step if None.
    problem, integrator, pattern, t_end, parameters, plugins, budget
        As in `solve`.

    Raises
    ------
    problems.spec.SpecError
        If a name, an option or a number is not known or not allowed.

    Examples
    --------
    >>> found = order("pendulum", "generalized_alpha[rho_inf=0.8]", [0.02, 0.01, 0.005])
    >>> round(found.orders["q"]["settled"])
    2
    """
    _check(budget=budget)
    records = order_records(
        problem,
        integrator,
        plugins,
        budget,
        OnStandardError(),
        steps=steps,
        pattern=tuple(pattern) if pattern else None,
        t_end=t_end,
        settings=parameters,
    )
    return Orders(**order_summary(records), _records=records)


def run(
    suite: str | Path = "quick",
    out: str | Path = options.RESULTS,
    *,
    problems: Sequence[str] = (),
    integrators: Sequence[str] = (),
    mine: str | None = None,
    plugins: Sequence[str | Path] = (),
    fresh: bool = False,
    jobs: int = 2,
    budget: float | None = None,
) -> Results:
    """Run a suite, write its report, and load the results, as ``stepbench run`` does.

    What the folder holds already is not measured again.

    Parameters
    ----------
    suite
        The name of a built-in suite, or a TOML file.
    out
        Folder of the results and of the report.
    problems, integrators
        Only these scenes and integrators; all of the suite if empty.
    mine
        An integrator that is run beside the others, and highlighted in the report.
    plugins
        Python files, or folders of them, with more scenes or integrators.
    fresh
        Whether earlier results in the folder are forgotten.
    jobs
        Number of worker processes.
    budget
        Processor time of a run in s, after which it is stopped; the suite's if None.

    Raises
    ------
    problems.spec.SpecError
        If a name, an option or a number is not known or not allowed.

    Examples
    --------
    >>> results = run("quick", "first", problems=["pendulum"])  # doctest: +SKIP
    >>> results.runs.pivot(index="h", columns="integrator", values="error_a_max")  # doctest: +SKIP
    """
    _check(budget=budget, jobs=jobs)
    pandas_module()  # before the work
    registry, folder = Inventory(plugins), Path(out)
    planned = make_suite(
        *read_profile(str(suite)), registry, problems, integrators, budget, mine=mine
    )
    for sentence in run_suite(planned, registry, folder, fresh, jobs).sentences:
        print(sentence)
    write_reports(folder)
    return load(folder)


def load(folder: str | Path = options.RESULTS) -> Results:
    """Load the results in a folder as pandas frames.

    Raises
    ------
    bench.results.store.StoreError
        If the folder holds no readable store.
    ImportError
        If pandas is not installed.

    Examples
    --------
    >>> fine = load("first").runs.query("h < 0.01")  # doctest: +SKIP
    """
    frame = pandas_module().DataFrame
    with Store(Path(folder)) as store:
        records, machines = list(store.records().values()), store.environments()
        scenes = store.scenes()
    return Results(
        folder=Path(folder),
        runs=frame([flatten(record, machines) for record in records]),
        samples=frame(
            [
                {"key": r.key, "problem": r.problem, "integrator": r.integrator}
                | {"number": number, "seconds": seconds}
                for r in records
                for (_, number), seconds in zip(r.rounds, r.run_s, strict=True)
            ]
        ),
        scenes=frame(
            [
                {"problem": s.problem, "title": s.title, "t0": s.t0, "t_end": s.t_end, **s.sizes}
                | {"tags": s.tags, "components": s.components}
                | {"parameters": {p["name"]: p["value"] for p in s.parameters}}
                | {"reference_method": s.reference_method, "reference_error": s.reference_error}
                for s in scenes.values()
            ]
        ),
        environments=frame(
            [
                {"name": e.name, "date": e.date, "command": e.command, "cpu": e.cpu}
                | {"cores": e.cores, "memory_gib": e.memory_gib, "platform": e.platform}
                | {f"version_{name}": version for name, version in e.versions.items()}
                for e in machines.values()
            ]
        ),
        _state=f"{len(records)} runs: {endings(records)}",
    )


# ---- parts -------------------------------------------------------------------------------
def _check(budget: float | None, samples: int = 0, jobs: int = 1) -> None:
    """Refuse numbers that the command line refuses."""
    if budget is not None and not 0 < budget <= options.LARGEST_BUDGET:
        raise SpecError(
            f"The budget is {budget}; give a time in s above 0, at most {options.LARGEST_BUDGET:g}."
        )
    if samples < 0:
        raise SpecError(f"A run cannot be timed {samples} times; give 0 or more samples.")
    if jobs < 1:
        raise SpecError(f"The number of worker processes is {jobs}; give 1 or more jobs.")


def _array(rows: Rows, group: str) -> np.ndarray:
    """The values of a group, a row per time; without columns if the scene lacks the group."""
    values = rows.values.get(group) or [[] for _ in rows.t]
    return np.array(values, dtype=float).reshape(len(rows.t), len(values[0]) if values else 0)
