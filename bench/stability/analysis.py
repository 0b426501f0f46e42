"""The complete analysis of one integrator, as plain values for a page or JSON."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import fields, replace
from typing import Any

import msgspec
import numpy as np

from bench.plugins.registry import explain
from bench.running.worker import Worker
from bench.stability.matrices import steppable
from bench.stability.patterns import ALTERNATING, Safe, fractions, largest_safe_ratio
from bench.stability.spectra import FIRST_STEPS, places_near, radii, roots_of, spectrum
from bench.stability.systems import Coupled, Joined, LinearSystem, Loop, Oscillator, Relaxation
from integrators.contract import Integrator
from integrators.native.step_method import NativeMethod
from problems.base.spec import SpecError, build

SYSTEMS = {cls.name: cls for cls in (Oscillator, Relaxation, Loop, Coupled, Joined)}
#: omega h at which numbers are reported if none are asked for.
REPORTED = (0.1, 0.5, 1.0, 10.0, 100.0)
#: What is reported there.
_COLUMNS = ("omega_h", "radius", "damping", "period_error", "overshoot_q", "overshoot_v")
#: Grids of the maps: omega h, values of an option, ratios of steps.
_ACROSS, _VALUES = np.geomspace(1e-2, 1e4, 43), 31
_RATIOS = np.geomspace(1.0, 5.0, 31)


def analyse(
    method: Integrator,
    system: LinearSystem,
    pattern: Sequence[float] = (1.0,),
    at: Sequence[float] = (),
    ratios: bool = True,
) -> dict[str, Any]:
    """Analyse the stability of a method with constant steps on a linear test system.

    It is reported ``at`` values of omega h, or at `REPORTED`; the largest safe ratio of two steps
    in turns is sought if ``ratios`` is true. Maps and safe ratios need a step function; they would
    take minutes by running other methods.

    Returns
    -------
    dict
        The fields of `Spectrum`; "at", columns over the reported omega h; "theory", multistep
        formulas; "maps", radii over omega h and an option or a ratio of steps; "safe", the
        `Safe` ratio. NaN and infinity are None.
    """
    method = steppable(method)
    reported = tuple(at) or REPORTED
    found = spectrum(method, system, pattern, reported)
    places = places_near(found, reported)
    maps, safe = [], None
    if isinstance(method, NativeMethod):
        maps = [*_maps(method, system, pattern)]
        if ratios and not (found.growing or found.unsolved):
            safe = largest_safe_ratio(method, system)
    return _plain(
        vars(found)
        | {
            "stability_limit": found.limit,
            "at": {name: getattr(found, name)[places] for name in _COLUMNS},
            "first_steps": FIRST_STEPS,
            "theory": _theory(method) if len(pattern) == 1 else None,
            "maps": maps,
            "safe": safe,
        }
    )


def _plain(value: Any) -> Any:
    """Return values of NumPy and complex numbers as those of JSON; None for what is not finite."""

    def known(value: Any) -> Any:
        if isinstance(value, complex):
            return {"re": value.real, "im": value.imag}
        return vars(value) if isinstance(value, Safe) else value.tolist()

    return msgspec.json.decode(msgspec.json.encode(value, enc_hook=known))


def _maps(
    method: NativeMethod, system: LinearSystem, pattern: Sequence[float]
) -> Iterator[dict[str, Any]]:
    """Radii over omega h and the option that a method shows first, if that is a bounded number; and
    over omega H and the ratio of two steps that take turns."""

    def row(value: float, method: NativeMethod, pattern: Sequence[float]) -> dict[str, Any]:
        return {"value": value, "radii": radii(roots_of(method, system, _ACROSS, pattern))}

    for field in fields(method):
        meta = field.metadata
        low, high = meta.get("low"), meta.get("high")
        if low is None or high is None or not meta.get("always") or meta["type"] is not float:
            continue
        rows = []
        for value in np.linspace(low, high, _VALUES):
            with suppress(SpecError):  # not every value goes with the other options
                rows.append(row(value, replace(method, **{field.name: float(value)}), pattern))
        if len(rows) > 1:
            yield {"over": field.name, "omega_h": _ACROSS, "rows": rows}
            break
    rows = [row(ratio, method, fractions(ALTERNATING, ratio)) for ratio in _RATIOS]
    yield {"over": "step ratio", "omega_h": _ACROSS, "rows": rows}


def _theory(method: Integrator) -> dict[str, Any] | None:
    """The multistep formulas of a method, where it has them."""
    form = method.multistep_form()
    if form is None:
        return None

    def counted(roots: list[tuple[complex, int]]) -> list[dict[str, Any]]:
        return [{"re": root.real, "im": root.imag, "times": count} for root, count in roots]

    formulas = {
        group: {
            **{name: getattr(formula, name) for name in ("rho", "sigma", "power", "order")},
            "zero_roots": counted(formula.zero_roots),
            "zero_stable": formula.zero_stable,
            "infinity_roots": counted(formula.infinity_roots),
            "infinity_stable": formula.infinity_stable,
        }
        for group, formula in (("q", form.q), ("v", form.v), ("x", form.x))
    }
    ratios = {name: getattr(form, name) for name in ("smallest_ratio", "smallest_ratio_x")}
    return {"formulas": formulas} | ratios


def analysis_job(
    worker: Worker,
    integrator: str,
    system: str,
    zeta: float | None,
    pattern: tuple[float, ...],
    at: tuple[float, ...],
    ratios: bool,
) -> dict[str, Any]:
    """Do a job of a worker: analyse an integrator on a system of `SYSTEMS`."""
    made = build(SYSTEMS[system], {} if zeta is None else {"zeta": zeta}, system)
    try:
        return analyse(worker.registry.integrator(integrator), made, pattern, at, ratios)
    except SpecError:
        raise
    except Exception as error:  # the method may be a plugin, which may do anything
        raise SpecError(f"{integrator} cannot be analysed: {explain(error)}") from error
