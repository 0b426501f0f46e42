"""Facts, parameters and sizes of a scene, and its equations, typeset as MathML."""

from __future__ import annotations

import re
from collections.abc import Mapping

from markupsafe import Markup

from bench.results.quantities import TRUST
from bench.results.records import SceneRecord
from bench.results.table import Table
from reports.formatting import number
from reports.questions import TABLE_GROUPS

#: Words of the contract that have a symbol; a dot or an arrow above is an accent.
_SYMBOLS = {"Phi": "Φ", "lam": "λ", "gamma": "γ", "omega": "ω"}
_TOKEN = re.compile(r"[A-Za-z]+|\d+(?:\.\d+)?|\S")
#: Sizes of a scene: what there is one of, and of several.
_SIZES = {
    "nq": ("coordinate q", "coordinates q"),
    "nv": ("velocity v", "velocities v"),
    "nl": ("multiplier λ", "multipliers λ"),
    "nx": ("controller state x", "controller states x"),
    "ny": ("output y", "outputs y"),
    "nd": ("held value xd", "held values xd"),
}


def unknowns(scene: SceneRecord) -> str:
    """The numbers of unknowns: 7 coordinates q, 6 multipliers λ."""
    sizes = ((scene.sizes.get(k), names) for k, names in _SIZES.items())
    return ", ".join(f"{n} {names[n > 1]}" for n, names in sizes if n)


def scene_facts(scene: SceneRecord) -> dict[str, str]:
    """Texts by name: interval, size, reference, sensitivity, source, faults."""
    growth = f"a small change of the start grows up to {number(scene.growth)} times"
    own = (f"{g} {number(e)}" for g, e in scene.reference_error.items())
    found = {
        "Interval": f"{number(scene.t0)} s to {number(scene.t_end)} s" * (scene.t_end > scene.t0),
        "Size": unknowns(scene),
        "Reference": scene.reference_method,
        "Its own relative error": ", ".join(own),
        "Sensitivity": f"{growth} (2-norm, relative to sizes)" if scene.growth else "",
        "Source": scene.source,
        "Faults": " ".join(scene.faults),
    }
    return {name: text for name, text in found.items() if text}


def references_table(scenes: Mapping[str, SceneRecord]) -> Table | None:
    """How the reference of each scene is made, and its own errors; None without scenes."""
    rows = [
        [name, s.reference_method, *(number(s.reference_error.get(g)) for g in TABLE_GROUPS)]
        for name, s in scenes.items()
        if s.reference_method
    ]
    note = f"Own errors are relative; an accuracy within {TRUST:g} times them is not judged. That "
    note += "of a closed form is made by one rounding of time and values; collocation takes steps "
    note += "as short as round-off allows, and is compared with Radau IIA at others."
    head = ["scene", "reference", *(f"own error in {g}" for g in TABLE_GROUPS)]
    return Table("References", head, rows, note=note) if rows else None


def parameters_table(scene: SceneRecord) -> Table | None:
    """The parameters with units and meaning; None if there are none."""
    if not scene.parameters:
        return None
    head = list(dict.fromkeys(key for row in scene.parameters for key in row))
    rows = [[_cell(row.get(key)) for key in head] for row in scene.parameters]
    return Table("Parameters", ["meaning" if h == "doc" else h for h in head], rows)


def _cell(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.6g}"
    return "" if value is None else str(value)


# ---- equations --------------------------------------------------------------------------
def mathml(text: str) -> Markup:
    """A line such as ``M(q) a = g(q, v, t) - Phi_q^T lam`` as MathML.

    ``_`` and ``^`` set the next word below and above; ``xdot`` is x with a dot.
    """
    row: list[Markup] = []
    tokens = _TOKEN.findall(text)
    k = 0
    while k < len(tokens):
        base = _token(tokens[k])
        below = above = Markup()
        while k + 2 < len(tokens) and tokens[k + 1] in "_^":
            index = _token(tokens[k + 2])
            below, above = (index, above) if tokens[k + 1] == "_" else (below, index)
            k += 2
        if below and above:
            base = Markup("<msubsup>{}{}{}</msubsup>").format(base, below, above)
        elif below or above:
            kind = "msub" if below else "msup"
            base = Markup(f"<{kind}>{{}}{{}}</{kind}>").format(base, below or above)
        row.append(base)
        k += 1
    joined = Markup("").join(row)
    return Markup('<math display="block"><mrow>{}</mrow></math>').format(joined)


def _token(word: str) -> Markup:
    if word.endswith("dot") and word != "dot":
        return Markup("<mover>{}<mo>˙</mo></mover>").format(_token(word[:-3]))
    if word[0].isdigit():
        return Markup("<mn>{}</mn>").format(word)
    if word == "T":  # of a transpose, upright
        return Markup('<mi mathvariant="normal">T</mi>')
    if word[0].isalpha():
        return Markup("<mi>{}</mi>").format(_SYMBOLS.get(word, word))
    return Markup("<mo>{}</mo>").format({"-": "−", "*": "·"}.get(word, word))  # noqa: RUF001
