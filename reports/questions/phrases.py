"""Sentences as parts: plain text, and references that a page makes links of."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class Ref:
    """Text that stands for something a page can lead to.

    ``key`` is the label of a method, the name of a scene, the key of a run, the term of the
    glossary, or the name of an experiment of the failure atlas.
    """

    kind: Literal["method", "scene", "run", "term", "atlas"]
    key: str
    text: str


Piece = str | Ref
Sentence = list[Piece]


def plain(sentence: Sequence[Piece]) -> str:
    """The sentence without its references."""
    return rendered(sentence, str, lambda ref: ref.text)


def rendered(
    sentence: Sequence[Piece], text_of: Callable[[str], str], link_of: Callable[[Ref], str]
) -> str:
    """The sentence in a page's language: plain parts by ``text_of``, references by ``link_of``."""
    return "".join(text_of(p) if isinstance(p, str) else link_of(p) for p in sentence)


def listed(items: Iterable[Sequence[Piece]], most: int = 3) -> Sentence:
    """'a', 'a and b', 'a, b and c'; of more than ``most`` the first ones and a count."""
    shown = [list(item) for item in items]
    if len(shown) > most:
        shown = [*shown[:most], [f"{len(shown) - most} more"]]
    joined: Sentence = []
    for k, item in enumerate(shown):
        if k:
            joined.append(" and " if k == len(shown) - 1 else ", ")
        joined += item
    return joined
