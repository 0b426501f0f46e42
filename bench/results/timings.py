"""Times of runs: whether two differ, by the quotient of their samples, and whether all repeat.

Samples of one round are neighbours in time, so that a slow minute of the machine is in both and
leaves their quotient as it is. The interval of a median is that of order statistics (sign test).
"""

from __future__ import annotations

import math
import operator
import statistics
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

from bench.results.quantities import COST, COSTS, NORM
from bench.results.records import TIMING_SECONDS, Environment, Record, median

#: Probability with which an interval holds the median, and the fewest samples that give one.
LEVEL = 0.95
FEWEST = 6
#: Times are told apart from this quotient on. With fewer samples than `FEWEST` there is no
#: interval, and only a large quotient counts.
LEAST_QUOTIENT, LEAST_OF_FEW = COSTS["seconds"].tie, 2.0
#: Longest run in s that gets `FEWEST` samples where it may win.
LONGEST = 1.0
#: Timing samples in s by invocation and round.
Samples = dict[tuple[int, int], float]
#: Integrators are ranked by seconds if the median `interval_width` of their runs is at most this.
REPEATABLE = 0.2


class Repeatability(NamedTuple):
    """How far the times of a store can be trusted.

    ``width`` is the median `interval_width` of the ``runs`` that have `FEWEST` samples or more;
    ``machines`` counts those that took times, with their clocks and versions.
    """

    width: float | None
    runs: int
    machines: int

    @property
    def cost(self) -> str:
        """The cost by which integrators are ranked unless another is asked for."""
        repeat = self.width is not None and self.width <= REPEATABLE and self.machines < 2
        return "seconds" if repeat else COST


class Quotient(NamedTuple):
    """A quotient of times with its interval; ``least`` is the quotient that counts."""

    value: float
    low: float
    high: float
    least: float

    @property
    def differs(self) -> bool:
        """Whether one of the two is faster: the interval is on one side of 1, far enough."""
        close = 1 / self.least <= self.value <= self.least
        return not close and not self.low <= 1.0 <= self.high


def median_interval(values: Sequence[float]) -> tuple[float, float]:
    """Interval of the median by order statistics; the extremes of fewer than `FEWEST` values.

    Source: the sign test, e.g. Conover (1999), Practical Nonparametric Statistics, section 3.2.
    """
    ordered = sorted(values)
    n, cut = len(ordered), 0
    outside = 1 + n
    while 2 * outside <= (1 - LEVEL) * 2**n:
        cut += 1
        outside += math.comb(n, cut + 1)
    return ordered[cut], ordered[-1 - cut]


def interval_width(samples: Sequence[float]) -> float:
    """Width of the interval of the median of some times, relative to it."""
    low, high = median_interval(samples)
    return (high - low) / statistics.median(samples)


def repeatability(
    records: Iterable[Record], environments: Mapping[int, Environment]
) -> Repeatability:
    """Judge the times of the runs that reached the end; long runs have too few samples to tell."""
    timed = [r for r in records if r.status == "ok" and r.run_s]
    widths = [interval_width(r.run_s) for r in timed if len(r.run_s) >= FEWEST]
    used = (environments.get(r.environment) for r in timed)
    machines = {tuple(e.machine.items()) for e in used if e}
    return Repeatability(median(widths), len(widths), len(machines))


def contenders(records: Iterable[Record]) -> list[Record]:
    """Choose the runs of up to `LONGEST` that last too long for `FEWEST` samples, and may win.

    They may if no other run of their scene has errors as small, in all groups, in less than a
    `LEAST_OF_FEW`-th of their time.
    """
    timed = [r for r in records if r.status == "ok" and r.run_s and r.errors]

    def errors(record: Record) -> list[float]:
        each = (norms.get(NORM) for norms in record.errors.values())
        return [math.inf if error is None else error for error in each]

    def beaten(one: Record) -> bool:
        return any(
            LEAST_OF_FEW * statistics.median(two.run_s) < statistics.median(one.run_s)
            and (two.problem, two.t_end, [*two.errors]) == (one.problem, one.t_end, [*one.errors])
            and all(map(operator.le, errors(two), errors(one)))
            for two in timed
        )

    long = [r for r in timed if len(r.run_s) < FEWEST and sum(r.run_s) > TIMING_SECONDS]
    return [r for r in long if max(r.run_s) <= LONGEST and not beaten(r)]


def quotient(one: Samples, two: Samples) -> Quotient | None:
    """Time of ``two`` over that of ``one``, within rounds if all that one has are common to both.

    None if a run has no samples, or a short one has a single sample in another round.
    """
    quotients = [two[place] / one[place] for place in one if place in two]
    if not quotients or len(quotients) < min(len(one), len(two)):
        return quotient_of_medians([*one.values()], [*two.values()])
    return Quotient(statistics.median(quotients), *median_interval(quotients), _least(quotients))


def quotient_of_medians(one: Sequence[float], two: Sequence[float]) -> Quotient | None:
    """Median of ``two`` over that of ``one``, for samples in s without common rounds.

    None if a short run has a single sample.
    """
    if not (_precise(one) and _precise(two)):
        return None
    (a, b), (c, d) = median_interval(one), median_interval(two)
    value = statistics.median(two) / statistics.median(one)
    return Quotient(value, c / b, d / a, max(_least(one), _least(two)))


def by_round(record: Record) -> Samples:
    """Samples in s by invocation and round; without rounds, those of the record's own."""
    rounds = record.rounds or [(record.environment, k) for k in range(len(record.run_s))]
    return dict(zip(rounds, record.run_s, strict=True))


def _precise(samples: Sequence[float]) -> bool:
    """Whether there is more than one sample, or one that averages the noise itself."""
    return len(samples) > 1 or sum(samples) > TIMING_SECONDS


def _least(samples: Sequence[float]) -> float:
    return LEAST_QUOTIENT if len(samples) >= FEWEST else LEAST_OF_FEW
