"""The checks of accuracy: the claimed order at constant steps, and what a tolerance promises."""

from __future__ import annotations

from itertools import pairwise

from bench.conformance.trials import reference
from bench.conformance.verdicts import DoesNotApply, Failed
from bench.measure import relative_errors
from bench.orders import Fit, fit_order
from integrators.contract import Integrator, Steps, Tolerances
from problems.system import MechatronicSystem

#: A measured order may differ from the claimed one by this.
ORDER_SPREAD = 0.2
_NORM = "settled"
_FEWEST, _MOST = 8, 4096
#: Below this an error shows the asymptotic order, and no coarser step has to be asked.
_SMALL = 1e-4
#: Relative errors below this are round-off and say nothing about an order.
_ROUND_OFF = 1e-12
_RTOLS = (1e-4, 1e-5, 1e-6, 1e-7, 1e-8)
#: From the first to the last of these tolerances an error has to fall by this at least.
_FALL = 100.0

Trial = tuple[MechatronicSystem, float]


def check_order(method: Integrator, trials: list[Trial]) -> str:
    """The order in every group is what ``claims`` says, after the start transient.

    Raises
    ------
    Failed
        With every group and scene whose order is another.
    DoesNotApply
        If nothing is claimed, or steps cannot be constant.
    """
    steady = method.at_constant_steps()
    if steady is None:
        raise DoesNotApply("It cannot take constant steps, so that no order can be measured.")
    found, faults = [], []
    for scene, t_end in trials:
        if steady.supports(scene):
            continue
        claims = {g: p for g, p in steady.claims(scene).items() if _has(scene, g)}
        if not claims:
            continue
        fits, levels = _refine(steady, scene, t_end, claims)
        for group, claimed in claims.items():
            fault = _fault(fits[group], levels[group], claimed)
            if fault:
                faults.append(f"claims order {claimed} in {group} on {scene.spec}, {fault}")
        found.append(f"{_words(claims)} on {scene.spec}")
    if faults:
        raise Failed(f"It {'; '.join(faults)}; correct `orders` or the method.")
    if not found:
        raise DoesNotApply("It claims no order; state `orders` if it has one.")
    return f"Measured as claimed: order {'; '.join(found)}."


def _has(scene: MechatronicSystem, group: str) -> bool:
    sizes = scene.sizes._asdict() | {"nv": scene.sizes.nq, "na": scene.sizes.nq, "nlam": 0}
    return bool(scene.sizes.nl if group == "lam" else sizes[f"n{group}"])


def _words(claims: dict[str, int]) -> str:
    groups: dict[int, list[str]] = {}
    for group, order in claims.items():
        groups.setdefault(order, []).append(group)
    return ", ".join(f"{order} in {' '.join(names)}" for order, names in groups.items())


def _refine(
    method: Integrator, scene: MechatronicSystem, t_end: float, claims: dict[str, int]
) -> tuple[dict[str, Fit], dict[str, list[tuple[float, float]]]]:
    """Take ever smaller steps until every order shows or errors are round-off.

    High orders get more, closer steps: theirs fall to round-off within a few halvings.
    """
    ratio = 2.0 if max(claims.values()) <= 4 else 2.0**0.5
    length, known = t_end - scene.interval[0], reference(scene, t_end)
    levels: dict[str, list[tuple[float, float]]] = {group: [] for group in claims}
    fits = dict.fromkeys(claims, Fit(None, None, 0, "not determined"))
    floors, count, trouble = dict.fromkeys(claims, 0.0), float(_FEWEST), ""
    while count <= _MOST:
        steps = round(count)
        count *= ratio
        run = method.prepare(scene, t_end, Steps(length / steps)).measure()
        if run.status != "ok":  # coarse steps may be too coarse
            trouble = f"{run.status}: {run.message}"
            continue
        errors, own = relative_errors(run, known)
        trouble = ""
        for group in claims:
            error = errors[group][_NORM]
            floors[group] = max(floors[group], own[group][_NORM])
            levels[group].append((length / steps, float("inf") if error is None else error))
            fits[group] = fit_order(*zip(*levels[group], strict=True), floors[group])
        if all(_shown(fits[g], levels[g], floors[g], claims[g]) for g in claims):
            break
    if trouble:
        raise Failed(f"On {scene.spec} at h={length / steps:.2g} s it ends with {trouble}")
    return fits, levels


def _shown(fit: Fit, levels: list[tuple[float, float]], floor: float, claimed: int) -> bool:
    """Whether smaller steps would tell nothing new."""
    error = levels[-1][1]
    if error <= max(100 * floor, _ROUND_OFF):
        return True
    return error < _SMALL and fit.order is not None and abs(fit.order - claimed) <= ORDER_SPREAD


def _fault(fit: Fit, levels: list[tuple[float, float]], claimed: int) -> str:
    if fit.order is not None and fit.window:
        if abs(fit.order - claimed) <= ORDER_SPREAD:
            return ""
        coarse, fine = fit.window
        return f"is {fit.order:.2f} (h = {coarse:.2g} to {fine:.2g} s)"
    if max(error for _, error in levels) <= _ROUND_OFF:
        return ""  # exact, whatever the step
    shown = ", ".join(f"{error:.1e} at {h:.2g} s" for h, error in levels[-4:])
    return f"shows none (errors {shown})"


def check_tolerance(method: Integrator, trials: list[Trial]) -> str:
    """Errors in q and v fall with the tolerance, by a factor of 100 from 1e-4 to 1e-8.

    Raises
    ------
    Failed
        With the first scene and group in which they do not.
    DoesNotApply
        If the method has fixed steps.
    """
    if method.controls != "tolerance":
        raise DoesNotApply("It has fixed steps.")
    for scene, t_end in trials:
        errors: dict[str, list[float]] = {"q": [], "v": []}
        for rtol in _RTOLS:
            run = method.prepare(scene, t_end, Tolerances(rtol)).measure()
            if run.status != "ok":
                raise Failed(
                    f"On {scene.spec} at rtol={rtol:g} it ends with {run.status}: {run.message}"
                )
            measured, _ = relative_errors(run, reference(scene, t_end))
            for group, values in errors.items():
                values.append(measured[group]["max"] or 0.0)
        for group, values in errors.items():
            shown = ", ".join(f"{e:.1e}" for e in values)
            if values[0] < _FALL * values[-1] or any(b > 2 * a for a, b in pairwise(values)):
                raise Failed(
                    f"Errors in {group} on {scene.spec} are {shown} at rtol = {_RTOLS[0]:g} to "
                    f"{_RTOLS[-1]:g}; they have to fall steadily, by {_FALL:g} at least: let "
                    f"rtol and atol control the error of q and v."
                )
    return f"Errors fall with the tolerance on {', '.join(scene.spec for scene, _ in trials)}."
