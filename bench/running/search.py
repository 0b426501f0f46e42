"""Search for the coarsest resolution of a method whose error is at most a limit."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from bench.results.demands import bracket
from bench.running.inventory import MethodFacts, SceneFacts
from integrators.resolutions import Steps, Tolerances

#: Quotient of the finest size that fails and the coarsest that is good, at which a search ends.
RESOLVED = 1.1
#: Most runs of a method on a scene for one limit.
MOST_RUNS = 24
#: Errors that are hardly smaller at so many times finer steps, or tolerances, which errors follow
#: less closely, will not fall any more.
_HOPELESS, _FINER, _FINER_RTOL = 0.7, 16.0, 256.0
#: Order that is assumed while there is one error alone, and the range of orders that are believed.
_ORDER, _ORDERS = 2.0, (0.5, 8.0)
#: Logarithm of the largest quotient that is believed.
_FARTHEST = 100.0


@dataclass(frozen=True)
class Sizes:
    """Sizes of steps or tolerances in which is searched.

    Parameters
    ----------
    length
        Length of the interval in s, for steps: it has a whole number of them. None: tolerances.
    start, finest, coarsest
        Sizes in s, or relative tolerances.
    """

    length: float | None
    start: float
    finest: float
    coarsest: float

    @classmethod
    def of(cls, scene: SceneFacts, method: MethodFacts, t_end: float) -> Sizes:
        """Return the sizes for a method on a scene."""
        if method.controls == "tolerance":
            return cls(None, 1e-4, 1e-13, 0.1)
        length, nominal = t_end - scene.interval[0], scene.nominal_step
        return cls(length, min(nominal, length), nominal / 2**16, length)

    def resolution(self, size: float) -> Steps | Tolerances:
        """Return the steps or tolerances of a size."""
        return Tolerances(size) if self.length is None else Steps(size)

    def allowed(self, size: float) -> float:
        """Return the nearest allowed size: a whole number of steps, or two digits of rtol."""
        size = min(max(size, self.finest), self.coarsest)
        if self.length is None:
            return float(f"{size:.1e}")
        return self.length / max(1, round(self.length / size))

    def next(self, tried: Mapping[float, float], limit: float) -> float | None:
        """Return the size to try next; None if the search is at its end.

        ``tried`` has errors by sizes, infinite where a run failed. Between a good and a bad size
        the next one is on the line through both errors in logarithmic scales, beyond them it
        follows the order that the nearest two errors show.
        """
        if not tried:
            return self.allowed(self.start)
        good, bad = bracket(tried, limit)
        if len(tried) >= MOST_RUNS:
            return None
        if good is None:
            assert bad is not None
            finer = _FINER_RTOL if self.length is None else _FINER
            if _hopeless(tried, finer) or bad <= self.finest:
                return None
            factor = _toward(tried, bad, limit, 0.8) if math.isfinite(tried[bad]) else 0.25
            size = bad * min(max(factor, 1 / 32), 0.5)
        elif bad is None:
            size = good * min(max(_toward(tried, good, limit, 0.9), 2.0), 16.0)
        elif bad <= good * RESOLVED:
            return None
        else:
            part = 0.5  # of the way from good to bad, in logarithms
            if math.isfinite(tried[bad]) and tried[good] > 0:
                low, wanted, high = map(math.log, (tried[good], limit, tried[bad]))
                part = min(max((wanted - low) / (high - low), 0.1), 0.9) if low < high else part
            size = self.allowed(good * (bad / good) ** part)
            if size in tried:  # few steps: the nearest number is one that was tried
                size = math.sqrt(good * bad)
        size = self.allowed(size)
        return None if size in tried else size


def _hopeless(tried: Mapping[float, float], finer: float) -> bool:
    """Whether errors do not fall any more at finer sizes: the finest three tell it."""
    sizes = sorted(tried)[:3]
    fell = tried[sizes[0]] < _HOPELESS * tried[sizes[-1]]
    return len(sizes) == 3 and sizes[-1] >= finer * sizes[0] and not fell


def _toward(tried: Mapping[float, float], size: float, limit: float, caution: float) -> float:
    """Factor of a size by which its error comes to the limit."""
    known = sorted((abs(math.log(s / size)), s) for s, e in tried.items() if 0 < e < math.inf)
    order = _ORDER
    if len(known) > 1:
        (_, near), (_, far) = known[:2]
        order = power_of(far / near, tried[far], tried[near])
    return caution / multiple(limit, tried[size] or limit / 1e16, order)


def power_of(quotient: float, far: float, near: float) -> float:
    """Return the power of a quotient of two sizes, or costs, that their errors show.

    It is one of `_ORDERS`, whatever the errors: they may be equal, or grow.
    """
    power = (math.log(far) - math.log(near)) / math.log(quotient)
    return min(max(power, _ORDERS[0]), _ORDERS[1])


def multiple(limit: float, error: float, power: float) -> float:
    """Return the quotient by which sizes, or costs, lead from an error to a limit."""
    far = (math.log(error) - math.log(limit)) / power
    return math.exp(min(max(far, -_FARTHEST), _FARTHEST))
