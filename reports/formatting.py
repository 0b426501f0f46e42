"""Numbers, lists and names as a reader sees them in charts, tables and sentences."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping, Sequence

from bench.results.quantities import COSTS
from bench.results.table import NO_VALUE as NO_VALUE
from bench.results.table import number as number
from bench.results.timings import LEVEL


def order_text(order: float) -> str:
    """Two decimals; a zero has no sign."""
    return f"{round(order, 2) + 0.0:.2f}"


def milliseconds(seconds: float | None) -> str:
    """Seconds shown in ms."""
    return number(None if seconds is None else seconds * 1e3)


def cost_text(value: float | None, cost: str) -> str:
    """A cost with its unit, in three digits."""
    if cost == "seconds":
        long = value is not None and value >= 1
        return f"{number(value)} s" if long else f"{milliseconds(value)} ms"
    for size, word in ((1e9, "billion"), (1e6, "million")):
        if value is not None and value >= size:
            return f"{number(value / size)} {word}"
    return number(value)


def tie_text(cost: str) -> str:
    """The costs that cannot be told apart."""
    tie = COSTS[cost].tie
    if tie == 1.0:
        return "equal counts"
    if cost == "seconds":
        within = f"within a factor of {tie:g} of 1, or whose {100 * LEVEL:.3g} % interval holds 1"
        return f"times whose median quotient in rounds of samples is {within}"
    return f"counts that differ by at most {100 * (tie - 1):.3g} %"


def times(ratio: float | None) -> str:
    """A ratio with as many digits as tell it from 1."""
    if ratio is None:
        return ""
    said = number(ratio)
    return f"{format(ratio, '.6g') if said == '1' else said} times"


def symbols(text: str) -> str:
    """A text with λ for lam, also in lam1; inputs such as lam=... stay as they are."""
    return re.sub(r"\blam(\d*)\b(?![=:])", r"λ\1", text)


def file_name(text: str) -> str:
    """A name for a file or an anchor: the text itself if it is short and plain."""
    plain = re.sub(r"[^\w.,=+\[\]-]", "_", text, flags=re.ASCII).lstrip(".")[:80]
    return plain if plain == text else f"{plain}-{hashlib.sha256(text.encode()).hexdigest()[:8]}"


def paragraphs(text: str) -> list[str]:
    """The paragraphs of a docstring, each on one line."""
    return [" ".join(part.split()) for part in text.split("\n\n") if part.strip()]


def component_title(group: str, i: int, components: Mapping[str, Sequence[str]]) -> str:
    """A component with its unit, if it is known: q[X] in m, lam[1]; ``i`` counts from 0."""
    name, bracket, unit = component_text(group, i, components).partition(" [")
    return f"{group}[{name}]" + (f" in {unit.rstrip(']')}" if bracket else "")


def component_text(group: str, i: int, components: Mapping[str, Sequence[str]]) -> str:
    """Name and unit of a component, as a scene states them; its number if it has no name."""
    names = components.get(group, ())
    return names[i] if i < len(names) else str(i + 1)
