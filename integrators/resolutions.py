"""Resolutions of a run: constant steps, or tolerances."""

from __future__ import annotations

import math
from dataclasses import dataclass

from problems.base import spec

#: Limit of the steps of a run: it would not end, and floats count exactly only a little further.
MOST_STEPS = 1e12


@dataclass(frozen=True)
class Steps:
    """Constant steps, or a repeated pattern of steps.

    Parameters
    ----------
    h
        Size of a macro step in s.
    pattern
        Steps of a macro step as fractions of it, at most 16.

    Raises
    ------
    SpecError
        If h is not positive and finite, or the fractions are not positive or do not sum to 1.
    """

    h: float
    pattern: tuple[float, ...] = (1.0,)

    def __post_init__(self) -> None:
        if not (math.isfinite(self.h) and self.h > 0):
            raise spec.SpecError(f"The step {self.h:g} s is not allowed; give a positive number.")
        good = all(math.isfinite(f) and f > 0 for f in self.pattern)
        if not self.pattern or not good or abs(sum(self.pattern) - 1) > 1e-9:
            raise spec.SpecError(
                f"The step pattern {self.pattern} is not allowed; give positive fractions of the "
                f"macro step that sum to 1, such as 0.3,0.7."
            )
        if len(self.pattern) > 16:
            raise spec.SpecError(
                f"A step pattern has at most 16 fractions; {len(self.pattern)} came."
            )
        # Results are stored with them, and NumPy's floats are not those of Python.
        object.__setattr__(self, "h", float(self.h))
        object.__setattr__(self, "pattern", tuple(map(float, self.pattern)))

    def count(self, t0: float, t_end: float) -> int:
        """Return the least number of equal macro steps in [t0, t_end] (s) of at most h each.

        Raises
        ------
        SpecError
            If h is larger than the interval, or makes more than `MOST_STEPS` steps.
        """
        length = t_end - t0
        if self.h > length * (1 + 1e-9):
            raise spec.SpecError(
                f"The step {self.h:g} s is larger than the interval [{t0:g}, {t_end:g}] s; "
                f"give a step of at most {length:g}."
            )
        if length / self.h > MOST_STEPS:
            raise spec.SpecError(
                f"The step {self.h:g} s makes more than {MOST_STEPS:g} steps in "
                f"[{t0:g}, {t_end:g}] s; give a larger one."
            )
        return max(1, math.ceil(length / self.h * (1 - 1e-9)))


@dataclass(frozen=True, init=False)
class Tolerances:
    """Tolerances of an adaptive method.

    Parameters
    ----------
    rtol
        Relative tolerance.
    atol
        Absolute tolerance, in the unit of each variable; rtol/100 if None.

    Raises
    ------
    SpecError
        If one of them is not positive and finite.
    """

    rtol: float
    atol: float

    def __init__(self, rtol: float = 1e-6, atol: float | None = None) -> None:
        for name, value in (("rtol", rtol), ("atol", rtol / 100 if atol is None else atol)):
            if not (math.isfinite(value) and value > 0):
                raise spec.SpecError(f"{name}={value:g} is not allowed; give a positive number.")
            object.__setattr__(self, name, float(value))


def check_end(t0: float, t_end: float) -> float:
    """Return t_end as a float.

    Raises
    ------
    SpecError
        If it does not lie after the start t0.
    """
    if not t0 < t_end < math.inf:
        raise spec.SpecError(f"The end time {t_end:g} s does not lie after the start at {t0:g} s.")
    return float(t_end)
