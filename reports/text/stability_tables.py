"""Tables of stability: numbers of each integrator, safe step ratios, multistep formulas."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from bench.results.table import Table
from reports.formatting import NO_VALUE, number


def stability_tables(found: Sequence[dict[str, Any]], omega_h: str) -> list[Table]:
    """All tables of the page; ``omega_h`` is the name of the dimensionless step."""
    return [_facts(found, omega_h), _numbers(found, omega_h), *_safe(found), *_theory(found)]


def _facts(found: Sequence[dict[str, Any]], name: str) -> Table:
    lost = any(f["unsolved"] for f in found)
    rows = [
        {
            "integrator": f["integrator"],
            "radius at infinity": number(f["radius_at_infinity"]),
            "roots there": _roots([root | {"times": n} for root, n in f["roots_at_infinity"]])
            or "infinite",
            "order": NO_VALUE if f["order"] is None else str(f["order"]),
            f"grows for {name} in": _ranges(f["growing"]),
            **({f"step not solved for {name} in": _ranges(f["unsolved"])} if lost else {}),
            "bifurcation": number(f["bifurcation"]),
            "overshoot grows by the power (q, v)": ", ".join(
                map(str, f["overshoot_orders"] or NO_VALUE)
            ),
        }
        for f in found
    ]
    return Table.from_dicts(
        "What was found",
        rows,
        note="Order: that of the principal root. Growth: a radius above 1 by more than 1e-9. "
        "Bifurcation: where the principal pair turns real. A root with a times sign is multiple; "
        "on the unit circle it has to be simple."
        + " Not solved: Newton's method did not converge, and there are no numbers."
        * lost,
    )


def _numbers(found: Sequence[dict[str, Any]], name: str) -> Table:
    rows = [
        [f["integrator"], f"{row[0]:.6g}", _radius(row[0], row[1], f["unsolved"])]
        + [number(value) for value in row[2:]]
        for f in found
        for row in zip(*f["at"].values(), strict=True)
    ]
    head = ["integrator", name, "radius", "damping ratio", "period error", "overshoot q",
            "overshoot v"]  # fmt: skip
    return Table(f"Numbers over {name}", head, rows)


def _radius(omega_h: float, radius: float | None, unsolved: Sequence[Sequence[float]]) -> str:
    if any(low <= omega_h <= high for low, high in unsolved):
        return "not solved"
    return "inf" if radius is None else f"{radius:.12f}"


def _safe(found: Sequence[dict[str, Any]]) -> list[Table]:
    rows = []
    for f in found:
        for kind, safe in f["safe"].items():
            word = safe["word"]
            steps = "".join("+" if k > 0 else "-" if k < 0 else "0" for k in word or ())
            ratio = "above 10" if safe["ratio"] is None else number(safe["ratio"])
            kinds = {"alternating": "two in turns", "any": "any of up to six steps"}
            cells = [kinds[kind], ratio, steps, number(safe["omega_h"])]
            growth = "" if safe["radius"] is None else f"{safe['radius'] - 1:.1e}"
            rows.append([f["integrator"], *cells, growth])
    if not rows:
        return []
    head = ["integrator", "steps", "largest safe ratio", "first to grow", "at omega H", "growth"]
    return [
        Table(
            "Ratios of neighbouring steps",
            head,
            rows,
            code=(0, 3),
            note="The largest ratio, of growth and of cut alike, below which no pattern grows. "
            "Patterns are made of one ratio: + is a step larger by it, - one smaller by it, 0 one "
            "of equal size. Growth is that over one period just beyond the safe ratio.",
        )
    ]


def _theory(found: Sequence[dict[str, Any]]) -> list[Table]:
    rows = [
        {
            "integrator": f["integrator"],
            "of": group,
            "rho": _coefficients(formula["rho"]),
            "sigma": _coefficients(formula["sigma"]),
            "order": str(formula["order"]),
            **{
                f"roots of {name}": _roots(formula[f"{at}_roots"])
                + ("" if formula[f"{at}_stable"] else ": not stable")
                for name, at in (("rho", "zero"), ("sigma", "infinity"))
            },
        }
        for f in found
        if f["theory"]
        for group, formula in f["theory"]["formulas"].items()
    ]
    if not rows:
        return []
    smallest = "; ".join(
        f"{f['integrator']} {number(f['theory']['smallest_ratio'])} and "
        f"{number(f['theory']['smallest_ratio_x'])}"
        for f in found
        if f["theory"]
    )
    return [
        Table.from_dicts(
            "The same methods as linear multistep formulas",
            rows,
            note="rho(E) u = h^k sigma(E) d^k u/dt^k with k = 2 for q and 1 for v and x; "
            "coefficients from the highest power of E. Roots of rho govern small steps, those of "
            "sigma infinite frequency. Smallest ratio of a step to the one before it: "
            "|alpha_m/(1 - alpha_m)| for gamma and |delta_m/(1 - delta_m)| for theta "
            "(gamma=guarded restarts below it where alpha_m or delta_m is positive): "
            f"{smallest}.",
        )
    ]


def _coefficients(values: Sequence[float]) -> str:
    return ", ".join(f"{round(value, 12) + 0.0:.6g}" for value in values)


def _roots(roots: Sequence[dict[str, Any]]) -> str:
    texts = []
    for root in roots:
        text = f"{round(root['re'], 6) + 0.0:.4g}"
        text += f"{root['im']:+.4g}i" if abs(root["im"]) > 1e-6 else ""
        texts.append(text + (f" (×{root['times']})" if root["times"] > 1 else ""))  # noqa: RUF001
    return ", ".join(texts)


def _ranges(ranges: Sequence[Sequence[float | None]]) -> str:
    ends = (f"{number(a)} to {'infinity' if b is None else number(b)}" for a, b in ranges)
    return "; ".join(ends) or "none"
