"""Table of claimed orders that runs do not show, of errors that never fall, and of reasons."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

from bench.results.orders import Fit
from bench.results.quantities import NORM, NORMS
from bench.results.records import IntegratorFacts
from bench.results.table import Table
from reports.formatting import number, order_text
from reports.series import Series, error_of, groups_of, step_or_tolerance

#: An order is lost that falls short of the claimed one by this much.
LOSS = 0.5
#: Experiments of the failure atlas that explain a loss.
PATTERN, TRANSIENT, UNDAMPED = "variable_steps", "start_transient", "undamped_index3"


def lost_orders_table(
    scenes: Mapping[str, Sequence[Series]],
    known: Mapping[str, IntegratorFacts],
    experiments: Collection[str] = (),
) -> Table | None:
    """Groups that do not converge, or at less than the claimed order; None if there are none.

    ``experiments`` are the names of those that the report shows.
    """
    rows, links = [], {}
    for scene, series in scenes.items():
        for s in series:
            facts = known.get(s.records[0].integrator)
            # An order belongs to constant steps; of tolerances the error has to fall at all.
            claimed_here = s.finest.claims
            if claimed_here is None:
                claimed_here = facts.orders if facts else {}
            claims = claimed_here if s.controls == "step" else {}
            alike: dict[tuple[str, str, str], list[str]] = {}
            for group in groups_of(s.ok):
                claimed = claims.get(group)
                fit, settled = s.fit(group, NORM), s.fit(group, "settled")
                if not is_lost(fit, claimed):
                    continue
                found = _found(s, group, fit)
                transient = settled.order is not None and not is_lost(settled, claimed)
                if transient:
                    found += f"; after the start transient {order_text(settled.order or 0.0)}"
                why = _explained(s, group, fit, transient)
                claim = "none" if claimed is None else str(claimed)
                alike.setdefault((claim, found, why), []).append(group)
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
        f"constant steps is lower than the integrator claims by {LOSS:g} or more. The commands "
        "show the experiment of the failure atlas.",
        links=links,
    )


def is_lost(fit: Fit, claimed: int | None) -> bool:
    """Whether errors do not converge, or with less than the claimed order."""
    if fit.verdict == "does not converge":
        return True
    return claimed is not None and fit.order is not None and claimed - fit.order >= LOSS


def _found(s: Series, group: str, fit: Fit) -> str:
    if fit.verdict != "does not converge":
        return order_text(fit.order or 0.0)
    name = "h" if s.controls == "step" else "rtol"
    ends = [
        f"{number(error_of(r, group, NORM))} at {name}={number(step_or_tolerance(r))}"
        for r in (s.ok[0], s.ok[-1])
    ]
    return f"none: error {', '.join(ends)}"


def _explained(s: Series, group: str, fit: Fit, transient: bool) -> str:
    """The experiment with the same setting and the same symptom; none if there is none."""
    if len(s.records[0].pattern) > 1:
        return PATTERN
    if transient:
        return TRANSIENT
    stuck = fit.verdict == "does not converge" and group in ("a", "lam")
    steady = s.controls == "step" and s.formulations == "index3"
    return UNDAMPED if stuck and steady else ""
