"""An outcome map in words."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import groupby
from operator import itemgetter
from typing import Any

from bench.results.table import Table

#: Words of each outcome; a page numbers the outcomes in this order.
OUTCOME_NAMES = {
    "ok": "ok",
    "inaccurate": "inaccurate",
    "newton_failed": "Newton failed",
    "step_too_small": "step too small",
    "budget_exceeded": "out of steps",
    "diverged": "diverged",
    "not_run": "not run",
    "no_reference": "no reference",
}
#: Rows of the table, and stretches of one outcome in each.
_LINES, _STRETCHES = 9, 8


def outcome_table(found: Mapping[str, Any]) -> Table:
    """The outcomes along the first axis, at some values of the second."""
    x, y = found["x"], found["y"]
    last = len(y["values"]) - 1
    lines = sorted({round(k * last / (_LINES - 1)) for k in range(_LINES)})
    rows = []
    for k in lines:
        stretches = []
        pairs = zip(found["outcome"][k], x["values"], strict=True)
        for outcome, stretch in groupby(pairs, key=itemgetter(0)):
            values = [value for _, value in stretch]
            ends = f"{values[0]:.4g}" + (f" to {values[-1]:.4g}" if len(values) > 1 else "")
            stretches.append(f"{OUTCOME_NAMES[outcome]} {ends}")
        more = ["..."] if len(stretches) > _STRETCHES else []
        rows.append([f"{y['values'][k]:.4g}", "; ".join(stretches[:_STRETCHES] + more)])
    return Table("In words", [y["name"], f"along {x['name']}"], rows)
