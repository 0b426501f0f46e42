"""Whether two runs differ in time: by the median quotient of their samples and its interval.

Samples of one round are neighbours in time, so that a slow minute of the machine is in both and
leaves their quotient as it is. The interval of a median is that of order statistics (sign test).
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence
from typing import NamedTuple

from bench.results.quantities import COSTS
from bench.results.records import TIMING_SECONDS, Record

#: Probability with which an interval holds the median, and the fewest samples that give one.
LEVEL = 0.95
FEWEST = 6
#: Times are told apart from this quotient on. With fewer samples than `FEWEST` there is no
#: interval, and only a large quotient counts.
LEAST_QUOTIENT, LEAST_OF_FEW = COSTS["seconds"].tie, 2.0


class Quotient(NamedTuple):
    """A quotient of times with its interval; ``least`` is the quotient that counts."""

    value: float
    low: float
    high: float
    least: float

    @property
    def differs(self) -> bool:
        """Whether one of the two is faster: the interval is on one side of 1, far enough."""
        return max(self.value, 1 / self.value) > self.least and not self.low <= 1.0 <= self.high


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


def quotient(one: Record, two: Record) -> Quotient | None:
    """Time of ``two`` over that of ``one``, within rounds if all that one has are common to both.

    None if a short run has a single sample.
    """
    if not (_precise(one.run_s) and _precise(two.run_s)):
        return None
    a, b = _by_round(one), _by_round(two)
    quotients = [b[place] / a[place] for place in a if place in b]
    if len(quotients) < min(len(a), len(b)):
        return quotient_of_medians(one.run_s, two.run_s)
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


def _by_round(record: Record) -> dict[tuple[int, int], float]:
    """Samples by invocation and round; those of a record that no store kept have one of each."""
    rounds = record.rounds or [(record.environment, k) for k in range(len(record.run_s))]
    return dict(zip(rounds, record.run_s, strict=True))


def _precise(samples: Sequence[float]) -> bool:
    """Whether there is more than one sample, or one that averages the noise itself."""
    return len(samples) > 1 or sum(samples) > TIMING_SECONDS


def _least(samples: Sequence[float]) -> float:
    return LEAST_QUOTIENT if len(samples) >= FEWEST else LEAST_OF_FEW
