"""Data of a page in little text: what many sentences refer to stands in it once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any


def packed(data: Mapping[str, Any]) -> dict[str, Any]:
    """Data of a page as its scripts read them.

    Parameters
    ----------
    data
        What `reports.pages.site_data` gives.

    Returns
    -------
    dict of str to Any
        The same; ``refs`` are the references of all sentences, which have their places instead.
        The states on a scene are a list in the order of the methods, None for those not tried.
    """
    places: dict[tuple[tuple[str, str], ...], int] = {}

    def sentence(parts: Sequence[Any]) -> list[str | int]:
        return [
            p if isinstance(p, str) else places.setdefault(tuple(p.items()), len(places))
            for p in parts
        ]

    def part(found: Mapping[str, Any]) -> dict[str, Any]:
        return {**found, "sentences": [sentence(said) for said in found["sentences"]]}

    def scene(own: Mapping[str, Any]) -> dict[str, Any]:
        states = own["states"]
        return {**own, "states": [states.get(k) for k in range(max(states, default=-1) + 1)]}

    answers = {
        question: {
            **answer,
            "scenes": [own and scene(own) for own in answer["scenes"]],
            "verdicts": [said and sentence(said) for said in answer.get("verdicts", ())],
            "filters": {name: part(found) for name, found in answer["filters"].items()},
        }
        for question, answer in data["answers"].items()
    }
    return {**data, "answers": answers, "refs": [dict(ref) for ref in places]}
