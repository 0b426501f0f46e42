"""Equations of a scene, typeset as MathML from the plain text in which its record states them."""

from __future__ import annotations

import re

from markupsafe import Markup

#: Words of the contract that have a symbol; a dot or an arrow above is an accent.
_SYMBOLS = {"Phi": "Φ", "lam": "λ", "gamma": "γ", "omega": "ω"}
_TOKEN = re.compile(r"[A-Za-z]+|\d+(?:\.\d+)?|\S")


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
        return Markup('<mover accent="true">{}<mo>˙</mo></mover>').format(_token(word[:-3]))
    if word[0].isdigit():
        return Markup("<mn>{}</mn>").format(word)
    if word == "T":  # of a transpose, upright
        return Markup('<mi mathvariant="normal">T</mi>')
    if word[0].isalpha():
        return Markup("<mi>{}</mi>").format(_SYMBOLS.get(word, word))
    return Markup("<mo>{}</mo>").format({"-": "−", "*": "·"}.get(word, word))  # noqa: RUF001
