"""Orders that were measured: as text, fitted in every norm, and short of what is claimed."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from types import MappingProxyType

from bench.results.orders import Fit
from bench.results.quantities import NORM, NORMS
from bench.results.records import IntegratorFacts, SceneRecord
from bench.results.table import Table
from reports.explanations import STUCK, explained
from reports.formatting import NO_VALUE, named, number, order_text, text_range
from reports.series import Series, groups_of, ok_runs, step_or_tolerance

#: An order is lost that falls short of the claimed one by this much.
_LOSS = 0.5


def orders_measured(series: Sequence[Series]) -> str:
    """The orders of one integrator at constant steps, per group, over the scenes of its series.

    Those after the start transient are told where they are much higher.
    """
    said = []
    for group in groups_of(ok_runs(series)):
        orders, stuck = _orders(series, group, NORM)
        settled, still_stuck = _orders(series, group, "settled")
        parts = [text_range(map(order_text, orders))] if orders else []
        parts += [f"none on {named(stuck)}"] if stuck else []
        gained = orders and settled and settled[0] - orders[0] >= _LOSS
        if settled and (gained or len(stuck) > len(still_stuck)):
            parts.append(f"after the start transient {text_range(map(order_text, settled))}")
        wrong = [s.records[0].problem for s in series if _stepped(s) and s.never_right(group)]
        if parts and wrong:
            parts.append(f"every run wrong{f' on {named(wrong)}' if len(series) > 1 else ''}")
        if parts:
            said.append(f"{group} {', '.join(parts)}")
    return "; ".join(said)


def claims_text(series: Sequence[Series], facts: IntegratorFacts | None) -> str:
    """The orders that one integrator claims, per group, over the scenes of its series.

    A claim is that for the scene, which its runs hold; where scenes differ, the less frequent ones
    name theirs. Without any it is the claim in general.
    """
    claims: dict[str, dict[str, list[str]]] = {}
    for s in series:
        here = s.finest.claims or {}
        for group in groups_of(s.ok) if here else ():
            order = str(here.get(group, "none"))
            claims.setdefault(group, {}).setdefault(order, []).append(s.records[0].problem)
    if all(s.finest.claims is None for s in series):
        return "; ".join(f"{g} {p}" for g, p in facts.orders.items()) if facts else ""
    said = []
    for group, own in claims.items():
        most, *others = sorted(own, key=lambda order: (-len(own[order]), order == "none"))
        said.append(", ".join([f"{group} {most}", *(f"{o} on {named(own[o])}" for o in others)]))
    return "; ".join(said)


def order_cell(fit: Fit) -> str:
    """An order in a table: a number, none if the error does not converge, or a dash."""
    if fit.verdict == STUCK:
        return "none"
    return NO_VALUE if fit.order is None else order_text(fit.order)


def _stepped(s: Series) -> bool:
    return s.controls == "step"


def _orders(series: Sequence[Series], group: str, norm: str) -> tuple[list[float], list[str]]:
    """Fitted orders over the scenes, and the scenes on which the error does not converge."""
    fits = [(s.records[0].problem, s.fit(group, norm)) for s in series if s.controls == "step"]
    orders = sorted(f.order for _, f in fits if f.verdict == "converges" and f.order is not None)
    return orders, [problem for problem, f in fits if f.verdict == STUCK]


def fitted_orders_table(series: Sequence[Series], first: str) -> Table | None:
    """Fitted orders with window and number of points, a row per integrator and norm.

    The norm ``first`` stands before the others.
    """
    fitted = [s for s in series if s.controls == "step" and len(s.ok) > 1]
    groups = groups_of(ok_runs(fitted))
    if not groups:
        return None
    rows = [
        [s.label, NORMS[norm], *(_fit(s.fit(group, norm)) for group in groups)]
        for s in fitted
        for norm in dict.fromkeys((first, *NORMS))
    ]
    note = "Order (window of step sizes in s, number of points)."
    return Table("Fitted orders", ["integrator", "error", *groups], rows, note=note)


def _fit(fit: Fit) -> str:
    if fit.order is None or fit.window is None:
        return fit.verdict
    largest, smallest = fit.window
    window = f"{number(largest)} to {number(smallest)}, {fit.points}"
    prefix = "" if fit.verdict == "converges" else f"{fit.verdict}: "
    return f"{prefix}{order_text(fit.order)} ({window})"


def lost_orders_table(
    scenes: Mapping[str, Sequence[Series]],
    known: Mapping[str, IntegratorFacts],
    experiments: Collection[str] = (),
    described: Mapping[str, SceneRecord] = MappingProxyType({}),
) -> Table | None:
    """Groups that do not converge, or at less than the claimed order; None if there are none.

    ``experiments`` are the names of those that the report shows, ``described`` its scenes.
    """
    rows, links = [], {}
    for scene, series in scenes.items():
        for s in series:
            alike: dict[tuple[str, str, str], list[str]] = {}
            claims = _claims(s, known)
            for group in groups_of(s.ok):
                fit, settled, claimed = (
                    s.fit(group, NORM),
                    s.fit(group, "settled"),
                    claims.get(group),
                )
                if not _is_lost(fit, claimed):
                    continue
                transient = settled.order is not None and not _is_lost(settled, claimed)
                found = _ends(s, group) if fit.verdict == STUCK else order_text(fit.order or 0.0)
                if transient:
                    found += f"; after the start transient {order_text(settled.order or 0.0)}"
                why = explained(s, group, described.get(scene), transient)
                alike.setdefault((str(claimed or "none"), found, why), []).append(group)
            for (claim, found, why), groups in alike.items():
                if why in experiments:
                    links[len(rows), 5] = [f"atlas-{why}"]
                command = f"stepbench atlas {why}" if why else "no experiment"
                rows.append([s.label, scene, ", ".join(groups), claim, found, command])
    if not rows:
        return None
    return Table(
        "Orders that were lost, and errors that never converge",
        ["integrator", "scene", "group", "order claimed", "measured", "explained by"],
        rows,
        code=(0, 1),
        note=f"Relative error, {NORMS[NORM]}: it does not converge, or its order at "
        f"constant steps is lower than the integrator claims by {_LOSS:g} or more. The commands "
        "show the experiment of the failure atlas.",
        links=links,
    )


def _claims(s: Series, known: Mapping[str, IntegratorFacts]) -> Mapping[str, int]:
    """The orders claimed on a scene: of constant steps; with tolerances errors have to fall."""
    if s.controls != "step":
        return {}
    facts = known.get(s.records[0].integrator)
    here = s.finest.claims
    return here if here is not None else facts.orders if facts else {}


def _is_lost(fit: Fit, claimed: int | None) -> bool:
    """Whether errors do not converge, or with less than the claimed order."""
    if fit.verdict == STUCK:
        return True
    return claimed is not None and fit.order is not None and claimed - fit.order >= _LOSS


def _ends(s: Series, group: str) -> str:
    """The errors of the coarsest and of the finest run."""
    name = "h" if s.controls == "step" else "rtol"
    ends = [
        f"{number(r.error(group, NORM))} at {name}={number(step_or_tolerance(r))}"
        for r in (s.ok[0], s.ok[-1])
    ]
    return f"none: error {', '.join(ends)}"
