"""Relative errors of a trajectory against a reference, by component and by group."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from bench.results.quantities import GROUPS, NORMS, error_note, whole
from integrators.contract import Trajectory
from problems.reference import Reference
from problems.runtime import Float

#: "settled" is the last part of the interval, where the start transient has died out.
SETTLED_PART = 0.25
#: A component that stays below this part of its group's size is measured by the group's size.
_SMALL_PART = 1e-6


class ErrorTable(NamedTuple):
    """Relative errors of a run.

    Attributes
    ----------
    errors
        By group and norm, for a group ``"q"`` that of its worst component, for ``"|q|"`` that of
        the Euclidean norm of the group; None if not finite.
    reference_errors
        The reference's own estimated errors, relative like ``errors``.
    components
        By group and norm, the error of each component.
    histories
        By `error_note`, the error of the group's worst component at each of the k rows.
    """

    errors: dict[str, dict[str, float | None]]
    reference_errors: dict[str, dict[str, float]]
    components: dict[str, dict[str, list[float | None]]]
    histories: dict[str, Float[np.ndarray, " k"]]


class Scales(NamedTuple):
    """Sizes by which errors of a group are divided: of each component, and of the whole group."""

    components: Float[np.ndarray, " n"]
    group: float


def finite(value: float) -> float | None:
    """Return the value as a float, or None if it is not finite."""
    return float(value) if math.isfinite(value) else None


def norms(
    t: Float[np.ndarray, " k"],
) -> dict[str, Callable[[Float[np.ndarray, "*runs k"]], Float[np.ndarray, "*runs"]]]:
    """Return the norms over time, by name.

    Parameters
    ----------
    t
        The times of the k rows in s; they increase, but need not be equally spaced.

    Returns
    -------
    dict
        Functions of sizes of rows (not negative, the last axis is time): ``end`` takes the last
        row, ``max`` the largest, ``rms`` the root of the mean square over time (trapezoidal
        rule), ``settled`` the largest row of the last quarter of the interval.
    """
    last = t >= t[-1] - SETTLED_PART * (t[-1] - t[0])
    return {
        "end": lambda r: r[..., -1],
        "max": lambda r: r.max(axis=-1),
        "rms": lambda r: np.sqrt(np.trapezoid(r * r, t) / (t[-1] - t[0])),
        "settled": lambda r: r[..., last].max(axis=-1),
    }


def scales(reference: Reference, group: str) -> Scales:
    """Return the sizes that errors of a group are relative to: one for all norms and all runs.

    A component is measured by the natural size that the scene states, or else by its own largest
    absolute value over the reference. One that stays below a millionth of its group's largest
    Euclidean norm is measured by that norm: its own size may be rounding. A group that vanishes has
    size 1 in its unit: its errors are absolute.
    """
    sizes, norm = reference.largest[group]
    norm = norm or 1.0
    own = np.where(sizes >= _SMALL_PART * norm, sizes, norm)
    stated = (component.scale for component in reference.scene.components(group))
    return Scales(np.array([a or b for a, b in zip(stated, own, strict=True)]), norm)


def component_errors(
    difference: Float[np.ndarray, "*runs k n"], t: Float[np.ndarray, " k"], sizes: Scales, norm: str
) -> Float[np.ndarray, "*runs n"]:
    """Return the relative error of each component, from differences at k times t in s."""
    return norms(t)[norm](np.abs(np.moveaxis(difference, -1, -2))) / sizes.components


def whole_error(
    difference: Float[np.ndarray, "*runs k n"], t: Float[np.ndarray, " k"], sizes: Scales, norm: str
) -> Float[np.ndarray, "*runs"]:
    """Return the relative error of a group in the Euclidean norm of its components."""
    return norms(t)[norm](np.linalg.norm(difference, axis=-1)) / sizes.group


def relative_errors(trajectory: Trajectory, reference: Reference) -> ErrorTable:
    """Measure the relative errors of a run over its own rows.

    The error of a component is norm(value - reference) / scale, in every norm over time (see
    `norms`) with the same scale (see `scales`), so that "max" is never smaller than "end",
    "settled" or "rms".

    Parameters
    ----------
    trajectory
        The run, with the status "ok".
    reference
        The values that are taken as exact, with their own estimated error.
    """
    t, exact, table = trajectory.t, reference(trajectory.t), ErrorTable({}, {}, {}, {})
    for group in GROUPS:
        if not exact[group].shape[1]:
            continue
        difference = getattr(trajectory, group) - exact[group]
        sizes, unsure = scales(reference, group), reference.error[group]
        each = {name: component_errors(difference, t, sizes, name) for name in NORMS}
        table.components[group] = {name: [*map(finite, e)] for name, e in each.items()}
        table.histories[error_note(group)] = (np.abs(difference) / sizes.components).max(axis=1)
        table.errors[group] = {name: finite(e.max()) for name, e in each.items()}
        table.errors[whole(group)] = {
            name: finite(float(whole_error(difference, t, sizes, name))) for name in NORMS
        }
        own = float((unsure / sizes.components).max()), np.linalg.norm(unsure) / sizes.group
        for name, error in zip((group, whole(group)), own, strict=True):
            table.reference_errors[name] = dict.fromkeys(NORMS, float(error))
    return table


def relative_reference_error(reference: Reference) -> dict[str, float]:
    """Return the reference's own estimated error of each group, relative like errors of runs."""
    return {
        group: float((unsure / scales(reference, group).components).max())
        for group, unsure in reference.error.items()
        if len(unsure)
    }
