"""The laboratory's numbers in the terminal."""

from __future__ import annotations

from typing import Any

from rich.console import Group
from rich.markup import escape
from rich.table import Table

_COLUMNS = ("radius", "damping", "period error", "overshoot q", "overshoot v")


def tables(found: list[dict[str, Any]]) -> Group:
    """Of each integrator the numbers per omega h, and what was found in a few words."""
    parts: list[Any] = []
    for f in found:
        several = len(f["pattern"]) > 1
        name = "omega H" if several else "omega h"
        over = f"a pattern of {len(f['pattern'])} steps" if several else "a step"
        table = Table(
            title=escape(f"{f['integrator']}, {f['system']}: growth over {over}"),
            title_justify="left",
            title_style="bold",
            box=None,
            pad_edge=False,
            padding=(0, 2, 0, 0),
        )
        table.add_column(name, style="cyan", no_wrap=True, justify="right")
        for head in _COLUMNS:
            table.add_column(head, justify="right", no_wrap=True)
        for omega_h, radius, *others in zip(*f["at"].values(), strict=True):
            size = "inf" if radius is None else f"{radius:.12f}"
            table.add_row(f"{omega_h:.6g}", size, *(_number(value, ".5e") for value in others))
        facts = "\n".join(f"[bold]{title}[/bold]: {text}" for title, text in _facts(f, name))
        parts += [table, facts, ""]
    return Group(*parts[:-1])


def _facts(f: dict[str, Any], name: str) -> list[tuple[str, str]]:
    """What one integrator is known by: titles and texts."""
    facts = [
        ("radius at infinity", _number(f["radius_at_infinity"], ".6f", "infinite")),
        ("order", _number(f["order"], "d")),
        (f"grows for {name} in", _ranges(f["growing"])),
        ("bifurcation", _number(f["bifurcation"], ".6g", "none")),
    ]
    if f["overshoot_orders"]:
        q, v = f["overshoot_orders"]
        facts.append(("overshoot", f"of q like ({name})^{q}, of v like ({name})^{v}"))
    for kind, words in (("alternating", "two steps in turns"), ("any", "up to six steps")):
        if kind in f["safe"]:
            ratio = _number(f["safe"][kind]["ratio"], ".3f", "above 10")
            facts.append((f"largest safe ratio, {words}", ratio))
    return facts


def _ranges(ranges: list[tuple[float, float | None]]) -> str:
    """Where it grows."""
    return "; ".join(f"{a:.9g} to {_number(b, '.9g', 'infinity')}" for a, b in ranges) or "none"


def _number(value: float | None, form: str, nothing: str = "-") -> str:
    return nothing if value is None else format(value, form)
