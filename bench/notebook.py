"""The functions for notebooks: what the commands do, as arrays, frames and charts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from bench.commands.options import BUDGET_S, RESULTS, Given, budget_of
from bench.commands.suite import run_suite, suite_of_orders, write_reports
from bench.results.flat_rows import flatten
from bench.results.orders import Fit
from bench.results.quantities import GROUPS, NORMS
from bench.results.records import Record, Rows, endings
from bench.results.store import Store
from bench.running.inventory import Inventory
from bench.running.plan import make_suite, read_profile
from bench.running.runner import OnStandardError
from bench.running.session import solve as run_one
from bench.running.session import solve_cells
from problems.base.spec import SpecError

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class Solution:
    """A run of one integrator on one scene; a notebook shows its components over time.

    ``status`` is "ok", with notes on what is wrong as ``message``, or how it ended, with the
    reason. ``t`` are times in s of the rows that are kept: the first steps, and 100 to 200 more; q,
    v, a, lam, x, y and xd have a row for each and a column per component, whose names with units
    are ``components[group]``. ``errors[group][norm]`` are relative errors, of the worst component;
    ``work`` has counts by name, ``operations`` all of them (None if they are not known), and
    ``seconds`` is the median time of the bare solve; None if it was not timed.
    """

    problem: str
    integrator: str
    resolution: str
    status: str
    message: str
    t: np.ndarray
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    lam: np.ndarray
    x: np.ndarray
    y: np.ndarray
    xd: np.ndarray
    components: dict[str, list[str]]
    errors: dict[str, dict[str, float | None]]
    work: dict[str, int | None]
    operations: float | None
    seconds: float | None
    _rows: Rows = field(repr=False)

    def __repr__(self) -> str:
        about = f"{self.integrator} on {self.problem}, {self.resolution}: {self.status}"
        return f"<{about}; {len(self.t)} rows>"

    def _repr_svg_(self) -> str | None:
        from reports.charts.notebooks import solution_chart

        return solution_chart(self.integrator, self._rows, self.components)


@dataclass(frozen=True)
class Orders:
    """Orders of convergence of one integrator on one scene; a notebook shows errors over steps.

    By group and norm, ``fits`` have the order (None if not determined) with its window and verdict,
    and ``errors`` are relative, one for each of the ``steps`` in s. ``status`` is how each run
    ended.
    """

    steps: list[float]
    fits: dict[str, dict[str, Fit]]
    errors: dict[str, dict[str, list[float | None]]]
    status: list[str]
    _records: list[Record] = field(repr=False)

    @property
    def orders(self) -> dict[str, dict[str, float | None]]:
        """The orders by group and norm; None if not determined."""
        return {g: {n: fit.order for n, fit in own.items()} for g, own in self.fits.items()}

    @property
    def frame(self) -> pd.DataFrame:
        """A pandas frame with a row for each group and norm."""
        return _pandas().DataFrame(
            {"group": group, "norm": norm} | msgspec.structs.asdict(fit)
            for group, by_norm in self.fits.items()
            for norm, fit in by_norm.items()
        )

    def _repr_svg_(self) -> str | None:
        from reports.charts.notebooks import orders_chart

        return orders_chart(self._records)


@dataclass(frozen=True)
class Results:
    """The results in a folder as pandas frames.

    ``runs`` has a row per run: names, resolution, status, ``error_a_max`` ..., ``work_residuals``
    ..., ``operations``, ``run_s_median``; pattern, ``run_s`` and the errors of components are
    lists. ``scenes`` has sizes, parameters (a dictionary), the reference and its own error.
    """

    folder: Path
    runs: pd.DataFrame
    scenes: pd.DataFrame
    _state: str = field(repr=False)

    def __repr__(self) -> str:
        return f"<{self.folder}: {self._state}>"


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

    Names may have options in brackets: ``"generalized_alpha[rho_inf=0.8]"``. A method with constant
    steps takes ``step`` in s, perhaps a ``pattern`` of fractions of it that take turns; one that
    chooses its steps takes tolerances. ``t_end`` is in s, the scene's own if None. ``plugins`` are
    Python files, or folders of them, with more scenes or integrators. The run is timed so many
    times as there are ``samples``, and stopped after ``budget`` seconds of processor time. One that
    fails is a solution with a status and a message.

    Raises
    ------
    problems.base.spec.SpecError
        If a name, an option or a number is not known or not allowed.

    Examples
    --------
    >>> found = solve("pendulum", "newmark", step=0.01, parameters={"th0": 1.0})
    >>> found.errors["q"]["max"] < 1e-3
    True
    """
    if samples < 0:
        raise SpecError(f"{samples} samples are not allowed; give 0 at least.")
    fractions = tuple(pattern) if pattern else None
    sizes = {"step": step, "pattern": fractions, "rtol": rtol, "atol": atol, "t_end": t_end}
    asked = problem, integrator, plugins, budget_of(budget), OnStandardError()
    (record, rows), names = run_one(*asked, parameters=parameters, samples=samples, **sizes)
    same = "problem", "integrator", "resolution", "status", "errors", "work", "seconds"
    told: dict[str, Any] = {name: getattr(record, name) for name in same}
    told |= {group: _array(rows, group) for group in GROUPS}
    return Solution(
        **told,
        message=" ".join(record.notes) or record.message,
        t=np.array(rows.t),
        components=names,
        operations=record.cost("operations"),
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
    """Fit the order of convergence of an integrator at constant steps, in every norm.

    ``steps`` are step sizes in s, three at least; halvings of the scene's nominal step if None. All
    else, and what is raised, is as in `solve`.

    Examples
    --------
    >>> found = order("pendulum", "generalized_alpha[rho_inf=0.8]", [0.02, 0.01, 0.005])
    >>> round(found.orders["q"]["settled"])
    2
    """
    from reports.series import groups_of, series_of

    o = Given(problem=problem, settings=parameters or {}, plugins=plugins)
    asked = [integrator], budget_of(budget), steps, pattern, t_end
    cells = [*suite_of_orders(o.registry, o.asked_scene, *asked).cells.values()]
    records = [r for r, _ in solve_cells(cells, budget, progress=OnStandardError())]
    series, *_ = series_of(records)
    groups = groups_of(records)
    return Orders(
        [record.h or 0.0 for record in records],
        {group: {norm: series.fit(group, norm) for norm in NORMS} for group in groups},
        {g: {norm: [r.error(g, norm) for r in records] for norm in NORMS} for g in groups},
        [record.status for record in records],
        records,
    )


def run(
    suite: str | Path = "quick",
    out: str | Path = RESULTS,
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

    What the folder ``out`` holds already is not measured again, unless ``fresh``. Lists restrict
    the suite (a built-in one, or a TOML file) to scenes and integrators, or add some; ``mine`` is
    run beside the others, and highlighted. ``jobs`` is the number of worker processes; after
    ``budget`` seconds of processor time (the suite's if None) a run is stopped. What is raised is
    as in `solve`.

    Examples
    --------
    >>> results = run("quick", "first", problems=["pendulum"])  # doctest: +SKIP
    >>> results.runs.pivot(index="h", columns="integrator", values="error_a_max")  # doctest: +SKIP
    """
    if jobs < 1:
        raise SpecError(f"{jobs} jobs are not allowed; give 1 at least.")
    _pandas()  # before the work
    registry, profile = Inventory(plugins), read_profile(str(suite))
    planned = make_suite(*profile, registry, problems, integrators, budget_of(budget), mine)
    _, told = run_suite(planned, registry, Path(out), fresh, jobs)
    print(*told, sep="\n")
    write_reports(Path(out))
    return load(out)


def load(folder: str | Path = RESULTS) -> Results:
    """Load the results in a folder as pandas frames; raise StoreError if it holds no store,
    ImportError if pandas is not installed.

    Examples
    --------
    >>> fine = load("first").runs.query("h < 0.01")  # doctest: +SKIP
    """
    frame = _pandas().DataFrame
    with Store(Path(folder)) as store:
        records, machines = list(store.records().values()), store.environments()
        scenes = store.scenes()
    names = "problem", "title", "t0", "t_end", "tags", "components"
    names += "reference_method", "reference_error"
    own = [
        {name: getattr(s, name) for name in names}
        | {**s.sizes, "parameters": {p["name"]: p["value"] for p in s.parameters}}
        for s in scenes.values()
    ]
    runs = [flatten(record, machines) for record in records]
    state = f"{len(records)} runs: {endings(records)}"
    return Results(Path(folder), frame(runs), frame(own), state)


# ---- parts -------------------------------------------------------------------------------
def _array(rows: Rows, group: str) -> np.ndarray:
    """The values of a group, a row per time; without columns if the scene lacks the group."""
    values = rows.values.get(group) or [[] for _ in rows.t]
    return np.array(values, dtype=float).reshape(len(rows.t), len(values[0]) if values else 0)


def _pandas() -> Any:
    """Return pandas; raise ImportError that names the extra if it is not installed."""
    try:
        import pandas
    except ImportError:
        raise ImportError("pandas is not installed; install stepbench[notebook].") from None
    return pandas
