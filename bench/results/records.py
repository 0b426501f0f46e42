"""Records: the typed results of runs that are stored, and all that reports read."""

from __future__ import annotations

import hashlib
import statistics
from collections import Counter
from collections.abc import Iterable, Sequence
from typing import Annotated, Any

import msgspec
from msgspec import Meta

from bench.results.quantities import GROUPS, NORM, TRUST, WRONG
from bench.results.table import short_exponent

#: Version of the records below. A store of another version is refused with a hint.
SCHEMA = 5

#: Status of a cell whose run somebody or something ended from outside; it is run again.
INTERRUPTED = "interrupted"
#: Status of a cell whose integrator cannot take the scene: no failure of a run.
UNSUPPORTED = "unsupported"
#: Formulation, clock and machine of runs whose times and counts are not measured here.
TOLD = "as told by the author"
#: Statuses of cells whose integrator was not tried: nothing is known of its result.
NOT_TRIED = {INTERRUPTED, UNSUPPORTED}

#: No more timing samples of a run are taken once they have lasted this long, in s, unless it may
#: win (`bench.results.timings.contenders`): a long run averages the machine's noise itself.
TIMING_SECONDS = 1.0

#: Numbers within their bounds, which are checked when a value is read.
Positive = Annotated[float, Meta(gt=0)]
NotNegative = Annotated[float, Meta(ge=0)]
Count = Annotated[int, Meta(ge=0, le=2**62)]
#: Texts that charts show, of a length that they can show.
Name = Annotated[str, Meta(max_length=1000)]
Controls = Annotated[str, Meta(pattern="^(step|tolerance)$")]


class Digits(msgspec.Struct, kw_only=True):
    """Published values of a quantity at the time ``t`` in s, and computed ones, in their units.

    ``tolerance`` is the difference up to which the published ones hold.
    """

    quantity: Name
    t: float
    published: list[float]
    computed: list[float]
    tolerance: NotNegative

    @property
    def difference(self) -> float:
        """Largest difference of an entry."""
        pairs = zip(self.published, self.computed, strict=True)
        return max((abs(a - b) for a, b in pairs), default=0.0)


class Environment(msgspec.Struct, kw_only=True):
    """The machine, the versions and the command of one invocation that measured something.

    ``clock`` names the time of which its timing samples are seconds.
    """

    date: str
    command: str
    cpu: str
    cores: int
    memory_gib: float
    platform: str
    versions: dict[str, str]
    clock: str = "wall clock"

    @property
    def name(self) -> str:
        """The machine and the start in words, as tables name it."""
        return f"{self.cpu}, {self.cores} cores, {self.date}"

    @property
    def machine(self) -> dict[str, Any]:
        """All by which times are comparable or not: machine, clock and versions."""
        kept = {name: getattr(self, name) for name in ("cpu", "cores", "platform", "clock")}
        return kept | self.versions

    @property
    def number(self) -> int:
        """Its number in all stores: a digest."""
        return int(hashlib.sha256(msgspec.json.encode(self)).hexdigest()[:8], 16)


class Record(msgspec.Struct, kw_only=True):
    """One cell: one integrator on one scene at one resolution.

    ``errors[group][norm]`` are relative errors of the worst component of each group, of "|q|" in
    the 2-norm of the group, and ``components[group][norm]`` those of all components; a group that
    the scene lacks is absent, a value that is not finite is None. They are measured at ``rows`` of
    the steps of the run. ``later[k][group]`` are those of the same motion from later starts, in the
    norm by which runs are judged; a run that does not reach the end has none.
    ``constraint[level]`` is the largest residual over the rows, in ``constraint_unit`` (per s, per
    s^2) if that is known; ``errors`` has it relative to the scene's size, by the names of
    ``VIOLATIONS``.
    ``energy_drift`` is the largest change relative to the motion's largest kinetic energy, for
    scenes that conserve it. ``reference_error[group][norm]`` is the reference's own estimated
    error, relative like ``errors``: below a hundred times that, an error says nothing.
    ``points`` are the coordinates of the named points at the end, in m; ``history_error`` is the
    error of `bench.running.errors.history_error` over time; ``published`` has the published digits
    for which the run has a row.
    ``events`` compares the events of the run with those of the reference, by
    `bench.running.errors.event_errors`.
    ``operations`` is the bill of the run: floating-point operations by part, empty where a part is
    not known.
    ``claims`` are the orders that the integrator claims on the scene at equal steps, by group; None
    where they are not known.
    ``stopped`` is the phase in which a budget ran out (bench.running.process), the reference's too;
    the budgets were ``budget_s`` and ``memory_gib``.
    ``run_s`` holds every timing sample in s, and ``rounds`` the invocation and the round in it of
    each; ``environment`` is the number of the one that measured.
    """

    key: Name
    problem: Name
    integrator: Name
    family: Name
    formulation: Name
    controls: Controls
    claims: dict[str, int] | None = None
    h: Positive | None = None
    pattern: Annotated[tuple[Positive, ...], Meta(min_length=1)] = (1.0,)
    rtol: Positive | None = None
    atol: NotNegative | None = None
    t0: float
    t_end: float
    status: Name
    message: str = ""
    errors: dict[str, dict[str, NotNegative | None]] = {}
    reference_error: dict[str, dict[str, NotNegative]] = {}
    components: dict[str, dict[str, list[NotNegative | None]]] = {}
    later: list[dict[str, NotNegative | None]] = []
    rows: Count = 0
    constraint: dict[str, NotNegative | None] = {}
    constraint_unit: Name = ""
    energy_drift: NotNegative | None = None
    points: dict[Name, list[float]] = {}
    history_error: NotNegative | None = None
    published: list[Digits] = []
    events: dict[Name, float] = {}
    work: dict[str, Count | None] = {}
    operations: dict[str, Annotated[float, Meta(ge=0, le=1e100)]] = {}
    compile_s: NotNegative | None = None
    run_s: list[Positive] = []
    rounds: list[tuple[int, int]] = []
    environment: int = 0
    fingerprint: str = ""
    budget_s: float | None = None
    memory_gib: float | None = None
    stopped: str = ""
    schema: int = SCHEMA

    @property
    def resolution(self) -> str:
        """The step and its pattern, or the tolerances, in words."""
        if self.controls == "tolerance":
            return short_exponent(f"rtol={self.rtol:g}, atol={self.atol:g}")
        pattern = "" if len(self.pattern) == 1 else " x " + "/".join(f"{f:g}" for f in self.pattern)
        return short_exponent(f"h={self.h:.6g}{pattern}")

    @property
    def size(self) -> float:
        """The step in s, or the relative tolerance of a run that chooses its steps."""
        return (self.h if self.controls == "step" else self.rtol) or 0.0

    @property
    def seconds(self) -> float | None:
        """Median of the timing samples in s."""
        return median(self.run_s)

    def error(self, group: str, norm: str, start: int = 0) -> float | None:
        """Return a relative error, or None if the run has none.

        ``start`` is the number of the later start, 0 for none. Those have errors in the norm `NORM`
        alone; a run without them has its own errors there.
        """
        if 0 < start <= len(self.later) and norm == NORM:
            return self.later[start - 1].get(group)
        return self.errors.get(group, {}).get(norm)

    def floor(self, group: str, norm: str) -> float:
        """Return the reference's own error."""
        return self.reference_error.get(group, {}).get(norm, 0.0)

    def wrong(self, group: str) -> bool:
        """Whether it reached the end with nothing right in the group, as far as can be judged.

        It is so without warning if it has no ``message``.
        """
        error, least = self.error(group, NORM), max(WRONG, TRUST * self.floor(group, NORM))
        return self.status == "ok" and error is not None and error > least

    @property
    def notes(self) -> list[str]:
        """Sentences on a run that reached the end and is wrong, or may be; a failed one has none.

        ``message`` is told without the reference, the last sentence by it.
        """
        if self.status != "ok":
            return []
        wrong = {g: self.errors[g][NORM] or 0.0 for g in GROUPS if self.wrong(g)}
        group, error = next(iter(wrong.items()), ("", 0.0))
        why = (
            f"the error of {group} is {error / self.rtol:.2g} times rtol"
            if self.rtol
            else f"its steps are too large for order {self.claims[group]}"
            if self.claims and group in self.claims
            else "the method claims no order of it"
        )
        each = ", ".join(f"{g} {e:.2g}" for g, e in wrong.items())
        judged = f"Errors above {WRONG:g} of the size (largest over time): {each}; {why}."
        return [*filter(None, [self.message]), *([judged] if wrong else [])]

    def cost(self, name: str) -> float | None:
        """Return a cost by its name in `COSTS`, or of its work; None if it is not known."""
        if name == "seconds":
            return self.seconds
        if name == "operations":
            return sum(self.operations.values()) or None
        return self.work.get(name)


class Rows(msgspec.Struct, kw_only=True):
    """Sampled values, as in integrators.Trajectory, ready to be stored: ``values[name][k][i]``, all
    finite (`bench.running.measure.stored_rows`), and ``notes[name][k]``, None where there is none.
    """

    t: list[float]
    values: dict[str, list[list[float]]] = {}
    notes: dict[str, list[float | None]] = {}


class SceneRecord(msgspec.Struct, kw_only=True):
    """A scene as the report shows it; ``problem`` and ``t_end`` are its key.

    ``stopped`` is "reference" if that ran out of its budget, when a run had ``budget_s`` and
    ``memory_gib``.
    A parameter has "name", "value", "unit" and "doc", a drawing the time "t" in s and "lines" of
    points (x, y) in m, None for no number.
    ``growth`` is how often larger a small change of the start may become.
    ``faults`` are sentences on its false answers; the parts that they concern are empty.
    """

    problem: Name
    t_end: float
    t0: float
    title: Name = ""
    description: str = ""
    source: str = ""
    parameters: list[dict[str, Any]] = []
    components: dict[str, list[Name]] = {}
    sizes: dict[str, Count] = {}
    reference_method: str = ""
    reference_error: dict[str, float] = {}
    reference: Rows = msgspec.field(default_factory=lambda: Rows(t=[]))
    published: list[Digits] = []
    drawings: list[dict[str, Any]] = []
    fingerprint: str = ""
    stopped: str = ""
    budget_s: float | None = None
    memory_gib: float | None = None
    tags: list[str] = []
    difficulties: list[str] = []
    equations: list[str] = []
    rates: dict[str, float] | None = None
    growth: float | None = None
    faults: list[str] = []


class Study(msgspec.Struct, kw_only=True, frozen=True):
    """A part of a plan: some cells of one scene that belong on one chart."""

    title: str
    note: str = ""
    problem: str
    t_end: float
    figures: list[str]
    cells: list[str]
    components: list[str] = []


class MethodFacts(msgspec.Struct, kw_only=True, frozen=True):
    """An integrator's own statements (see `integrators.contract.Integrator`), and fingerprint.

    ``sources`` are the plugin files it came from, if it is no part of the project, ``fault`` is the
    sentence on a false statement, ``keeping_tangents`` the printed name where tangents are dear.
    """

    spec: str = ""
    name: str = ""
    title: str
    family: str = ""
    formulation: str = ""
    drift: str = ""
    controls: str = "step"
    affinity: str = ""
    orders: dict[str, int] = {}
    source: str = ""
    fingerprint: str = ""
    sources: frozenset[str] = frozenset()
    fault: str = ""
    keeping_tangents: str = ""


class Plan(msgspec.Struct, kw_only=True, frozen=True):
    """The task of a run folder: its title (none if it is a part of a suite), its studies, how often
    each run is timed, the time budget of a cell in s, the integrators by printed name, and the one
    that is the person's own (`--mine`), if any. It holds no results."""

    name: str
    title: str
    samples: int
    budget_s: float
    studies: list[Study]
    integrators: dict[str, MethodFacts] = {}
    mine: str = ""

    def heading(self, records: Iterable[Record]) -> str:
        """Return the title; of a part of a suite, what was run of it."""
        runs = list(records)
        if self.title or not runs:
            return self.title or self.name
        scenes, methods = len({r.problem for r in runs}), len({r.integrator for r in runs})
        return f"{self.name}: {counted(scenes, 'scene')}, {counted(methods, 'integrator')}"


def scene_titles(keys: Iterable[tuple[str, float]]) -> dict[tuple[str, float], str]:
    """Return the names of scenes by (problem, t_end), with the interval where one has several."""
    keys = dict.fromkeys(keys)
    several = Counter(problem for problem, _ in keys)
    return {(p, t): p if several[p] == 1 else f"{p}, t_end={t:g} s" for p, t in keys}


def counted(number: int, word: str) -> str:
    """Return a number with its word: "1 scene", "7 scenes"."""
    return f"{number} {word}{'' if number == 1 else 's'}"


def endings(records: Iterable[Any]) -> str:
    """Count how records, or others with ``status`` and ``message``, ended: "12 ok, 3 not supported,
    1 failed with a reason"."""
    records = list(records)
    statuses = Counter(record.status for record in records)
    ok, unsupported, cut = (statuses.pop(s, 0) for s in ("ok", UNSUPPORTED, INTERRUPTED))
    noted = sum(record.status == "ok" and record.message != "" for record in records)
    said = [f"{ok} ok{f' ({noted} with a warning)' if noted else ''}"]
    said += [f"{unsupported} not supported"] if unsupported else []
    said += [f"{statuses.total()} failed with a reason", f"{cut} interrupted" if cut else ""]
    return ", ".join(filter(None, said))


def median(values: Sequence[float]) -> float | None:
    """Return the median, or None if there are no values."""
    return statistics.median(values) if values else None
