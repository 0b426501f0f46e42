"""The checks of accuracy: the claimed order at constant steps, and errors under a tolerance."""

from __future__ import annotations

import math
from collections import defaultdict
from itertools import pairwise

from bench.check.trials import Trial, names_of, reference
from bench.check.verdicts import DoesNotApply, Failed
from bench.results.quantities import TRUST
from bench.running.errors import relative_errors
from integrators import checks
from integrators.resolutions import Steps, Tolerances

#: A measured order may be smaller than the claimed one by 0.2, or 6 % of it if that is more.
_SPREAD, _PART = 0.2, 0.06
#: An order is the mean slope of so many last errors above round-off, if slopes agree to this. Those
#: of orders above `_LOW` fall to round-off within three halvings of the step, so that it falls more
#: slowly; and they count over the whole run: in a part of it the first two terms of an error may
#: nearly cancel.
_LOW, _LAST_POINTS, _AGREEMENT = 4, 4, 0.75
#: Numbers of steps that are tried.
_FEWEST, _MOST = 8, 4096
#: Below this an error shows the asymptotic order, and no coarser step has to be asked.
_SMALL = 1e-4
#: Relative errors below the first are round-off and need no smaller steps; above the second they
#: still show a high order.
_ROUND_OFF, _ROUNDING = 1e-12, 2e-13
_RTOLS = (1e-4, 1e-5, 1e-6, 1e-7, 1e-8)
#: A method of low order may use up its own budget of steps, but not before this many of them.
_FEWEST_RTOLS = 3
#: An error falls at least like the tolerance to this power, by 100 from the first to the last:
#: that of a first-order method falls just so, but for a few percent.
_FALL, _ALMOST = 0.5, 0.9
#: So many false claims are told one by one.
_SHOWN = 3

#: Steps with their errors, coarse to fine.
Levels = list[tuple[float, float]]


def check_order(trials: list[Trial]) -> str:
    """The order in every group is at least the claimed one; up to 4 after the start transient.

    Raises
    ------
    Failed
        With groups and scenes whose order is smaller.
    DoesNotApply
        If nothing is claimed, or steps cannot be constant.
    """
    steady = trials[0].method.at_constant_steps()
    if steady is None:
        raise DoesNotApply("It cannot take constant steps, so that no order can be measured.")
    shown: defaultdict[str, list[str]] = defaultdict(list)
    faults: list[str] = []
    for scene in (trial.scene for trial in trials if not checks.refusal(steady, trial.scene)):
        claims = checks.checked_orders(steady.claims(scene), "claims()")
        claims = {g: p for g, p in claims.items() if scene.sizes.of(g)}
        levels, floors = _refine(Trial(steady, scene), claims) if claims else ({}, {})
        for group, claimed in claims.items():
            order = _order(levels[group], floors[group])
            if order is None and _at_round_off(levels[group], floors[group]):
                continue  # exact, or too accurate to show an order
            if order is None or order < claimed - _allowed(claimed):
                errors = ", ".join(f"{error:.1e} at {h:.2g} s" for h, error in levels[group][-4:])
                found = "shows none" if order is None else f"is {order:.2f}"
                told = f"claims order {claimed} in {group} on {scene.spec}, {found}"
                faults.append(f"{told} (errors {errors})")
            else:
                shown[scene.spec].append(f"{group} {order:.2f} ({claimed})")
    if faults:
        more = len(faults) - _SHOWN
        rest = [f"and {more} more like these"] if more > 0 else []
        raise Failed(f"It {'; '.join(faults[:_SHOWN] + rest)}; correct `orders` or the method.")
    if not shown:
        raise DoesNotApply("No order is claimed, or errors are round-off; see `orders`.")
    told = "; ".join(f"{', '.join(groups)} on {name}" for name, groups in shown.items())
    return f"Measured (claimed): {told}."


def _refine(trial: Trial, claims: dict[str, int]) -> tuple[dict[str, Levels], dict[str, float]]:
    """Return errors at ever smaller steps until every order shows, and their floors."""
    ratio = 2.0 if max(claims.values()) <= _LOW else 2.0**0.5
    length = trial.t_end - trial.scene.interval[0]
    known = reference(trial.scene, trial.t_end)
    levels: dict[str, Levels] = {group: [] for group in claims}
    floors, count, trouble = dict.fromkeys(claims, 0.0), float(_FEWEST), ""
    while count <= _MOST:
        h = length / round(count)
        count *= ratio
        run = trial.solved(Steps(h))
        trouble = run.status != "ok" and f"h={h:.2g} s it ends with {run.status}: {run.message}"
        if trouble:
            continue  # coarse steps may be too coarse
        errors, own, *_ = relative_errors(run, known)
        for group, claimed in claims.items():
            norm = "settled" if claimed <= _LOW else "max"
            error = errors[group][norm]
            floors[group] = max(floors[group], own[group][norm])
            levels[group].append((h, math.inf if error is None else error))
        if all(_shown(levels[group], floors[group], claimed) for group, claimed in claims.items()):
            break
    if trouble:
        raise Failed(f"On {trial.scene.spec} at {trouble}")
    return levels, floors


def _at_round_off(levels: Levels, floor: float) -> bool:
    return levels[-1][1] <= max(TRUST * floor, _ROUND_OFF)


def _shown(levels: Levels, floor: float, claimed: int) -> bool:
    """Whether the order shows, or errors are round-off."""
    if _at_round_off(levels, floor):
        return True
    order = _order(levels, floor)
    small = levels[-1][1] < _SMALL
    return small and order is not None and abs(order - claimed) <= _allowed(claimed)


def _allowed(claimed: int) -> float:
    return max(_SPREAD, _PART * claimed)


def _order(levels: Levels, floor: float) -> float | None:
    last = [(h, e) for h, e in levels if max(10 * floor, _ROUNDING) < e < math.inf][-_LAST_POINTS:]
    slopes = [math.log(e / f) / math.log(h / k) for (h, e), (k, f) in pairwise(last)]
    if len(last) < _LAST_POINTS or max(slopes) - min(slopes) > _AGREEMENT:
        return None
    return sum(slopes) / len(slopes)


def check_tolerance(trials: list[Trial]) -> str:
    """Errors in q and v fall with the tolerance, by a factor of 100 from 1e-4 to 1e-8.

    Where a method's own budget ends before 1e-8, they fall by as much less.

    Raises
    ------
    Failed
        With the first scene and group in which they do not.
    DoesNotApply
        If the method has fixed steps.
    """
    if trials[0].method.controls != "tolerance":
        raise DoesNotApply("It has fixed steps.")
    for trial in trials:
        scene, done = trial.scene, []
        errors: dict[str, list[float]] = {"q": [], "v": []}
        for rtol in _RTOLS:
            run = trial.solved(Tolerances(rtol))
            if run.status == "budget_exceeded" and len(done) >= _FEWEST_RTOLS:
                break
            if run.status != "ok":
                raise Failed(
                    f"On {scene.spec} at rtol={rtol:g} it ends with {run.status}: {run.message}"
                )
            measured, *_ = relative_errors(run, reference(scene, trial.t_end))
            done.append(rtol)
            for group, values in errors.items():
                # Samples shorten steps below what a tolerance asks for.
                values.append(max(measured[group]["max"] or 0.0, rtol if scene.is_hybrid else 0.0))
        wanted = (done[0] / done[-1]) ** _FALL
        for group, values in errors.items():
            rises = any(b > 2 * a for a, b in pairwise(values))
            if rises or values[0] < _ALMOST * wanted * values[-1]:
                raise Failed(
                    f"Errors in {group} on {scene.spec} are "
                    f"{', '.join(f'{e:.1e}' for e in values)} at rtol = {done[0]:g} to "
                    f"{done[-1]:g}; they have to fall steadily, by {wanted:.0f} at least: let "
                    f"rtol and atol control the error of q and v."
                )
    return f"Errors fall with the tolerance on {names_of(trials)}."
