"""Tables of stability: numbers of each integrator, safe step ratios, multistep formulas."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from bench.results.table import NO_VALUE, Table, formatted, number

#: What `bench.stability.analysis.analyse` returns for each integrator.
_Found = Sequence[Mapping[str, Any]]


def step_name(found: _Found) -> str:
    """Return the name of the dimensionless step, of which a pattern is a macro step."""
    return "omega H" if len(found[0]["pattern"]) > 1 else "omega h"


def stability_tables(found: _Found) -> list[Table]:
    """Return tables of facts, numbers over the step, safe ratios and theory; not empty ones."""
    made = (table(found) for table in (_facts, _numbers, _ratios, _formulas))
    return [table for table in made if table]


def _facts(found: _Found) -> Table:
    """A row for each integrator: what it does at small and large steps."""
    name = step_name(found)
    lost = any(f["unsolved"] for f in found)
    rows = []
    for f in found:
        solved = not f["unsolved"] or f["unsolved"][-1][1] < f["omega_h"][-1]
        at_infinity = "infinite" if solved else "not solved"
        orders = f["overshoot_orders"] or NO_VALUE
        row = {
            "integrator": f["integrator"],
            "radius at infinity": formatted(f["radius_at_infinity"], ".6g", at_infinity),
            "roots there": _roots([root | {"times": n} for root, n in f["roots_at_infinity"]])
            or at_infinity,
            "order": formatted(f["order"], "d"),
            f"grows for {name} in": _ranges(f["growing"]),
            **({f"step not solved for {name} in": _ranges(f["unsolved"])} if lost else {}),
            "bifurcation": formatted(f["bifurcation"], ".6g"),
            "overshoot grows by the power (q, v)": ", ".join(map(str, orders)),
        }
        rows.append(row)
    return Table.from_dicts(
        "What was found",
        rows,
        note="Order: that of the principal root. Growth: a radius above 1 by more than 1e-9. "
        "Bifurcation: where the largest root turns real. A root with a times sign is multiple; "
        "on the unit circle it has to be simple."
        + " Not solved: Newton's method did not converge, and there are no numbers."
        * lost,
    )


def _numbers(found: _Found) -> Table:
    """A row for each integrator and dimensionless step that was asked for."""
    rows = []
    for f in found:
        for omega_h, radius, *others in zip(*f["at"].values(), strict=True):
            lost = any(low <= omega_h <= high for low, high in f["unsolved"])
            size = "not solved" if lost else formatted(radius, ".12f", "inf")
            rows.append([f["integrator"], f"{omega_h:.6g}", size, *map(number, others)])
    name = step_name(found)
    head = [name, "radius", "damping ratio", "period error", "overshoot q", "overshoot v"]
    return Table(f"Numbers over {name}", ["integrator", *head], rows)


def _ratios(found: _Found) -> Table | None:
    """The largest safe ratios of two steps in turns; None if none were sought."""
    rows = []
    for f in found:
        if safe := f["safe"]:
            ratio = "above 10" if safe["ratio"] is None else number(safe["ratio"])
            growth = "" if safe["radius"] is None else f"{safe['radius'] - 1:.1e}"
            rows.append([f["integrator"], ratio, number(safe["omega_h"]), growth])
    head = ["integrator", "largest safe ratio", "first to grow at omega H", "growth"]
    note = (
        "The largest ratio of two steps in turns, of growth and of cut alike, below which nothing "
        "grows. Growth is that over both steps just beyond the safe ratio."
    )
    return Table("Ratios of neighbouring steps", head, rows, note=note) if rows else None


def _formulas(found: _Found) -> Table | None:
    """The methods as linear multistep formulas; None if none of them is one."""
    known = [(f["integrator"], f["theory"]) for f in found if f["theory"]]
    rows = [
        {
            "integrator": name,
            "of": group,
            "rho": _coefficients(formula["rho"]),
            "sigma": _coefficients(formula["sigma"]),
            "order": str(formula["order"]),
            **{
                f"roots of {polynomial}": _roots(formula[f"{at}_roots"])
                + ("" if formula[f"{at}_stable"] else ": not stable")
                for polynomial, at in (("rho", "zero"), ("sigma", "infinity"))
            },
        }
        for name, theory in known
        for group, formula in theory["formulas"].items()
    ]
    if not rows:
        return None
    smallest = "; ".join(
        f"{name} {number(theory['smallest_ratio'])} and {number(theory['smallest_ratio_x'])}"
        for name, theory in known
    )
    return Table.from_dicts(
        "The same methods as linear multistep formulas",
        rows,
        note="rho(E) u = h^k sigma(E) d^k u/dt^k with k = 2 for q and 1 for v and x; "
        "coefficients from the highest power of E. Roots of rho govern small steps, those of "
        "sigma infinite frequency. Smallest ratio of a step to the one before it: "
        "|alpha_m/(1 - alpha_m)| for gamma and |delta_m/(1 - delta_m)| for theta "
        "(gamma=guarded restarts below it where alpha_m or delta_m is positive): "
        f"{smallest}.",
    )


def _coefficients(values: Sequence[float]) -> str:
    return ", ".join(f"{round(value, 12) + 0.0:.6g}" for value in values)


def _roots(roots: Sequence[Mapping[str, Any]]) -> str:
    texts = []
    for root in roots:
        text = f"{round(root['re'], 6) + 0.0:.4g}"
        text += f"{root['im']:+.4g}i" if abs(root["im"]) > 1e-6 else ""
        texts.append(text + (f" (×{root['times']})" if root["times"] > 1 else ""))  # noqa: RUF001
    return ", ".join(texts)


def _ranges(ranges: Sequence[Sequence[float | None]]) -> str:
    ends = (f"{a:.9g} to {formatted(b, '.9g', 'infinity')}" for a, b in ranges)
    return "; ".join(ends) or "none"
