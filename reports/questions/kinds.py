"""Kinds of systems among which a reader finds his own, and the scenes of each kind."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from bench.results.records import SceneRecord

#: A scene with more unknowns than this is large.
_LARGE = 100


@dataclass(frozen=True)
class Kind:
    """Systems that ask the same of an integrator.

    ``groups`` are the errors in question; without any, the energy is.
    """

    key: str
    name: str
    groups: tuple[str, ...]
    has: Callable[[SceneRecord], bool]


def _size(scene: SceneRecord, *names: str) -> int:
    return sum(scene.sizes.get(name, 0) for name in names)


def _stiff(scene: SceneRecord) -> bool:
    return any(tag.startswith("stiff") for tag in scene.tags)


def _free(scene: SceneRecord) -> bool:
    return not _size(scene, "nl")


KINDS = (
    Kind("smooth", "Smooth, no constraints", ("a",), lambda s: _free(s) and not _stiff(s)),
    Kind("stiff", "Stiff, no constraints", ("a",), lambda s: _free(s) and _stiff(s)),
    Kind(
        "constrained",
        "Mechanisms with constraints",
        ("a", "lam"),
        lambda s: not _free(s) and "redundant" not in s.tags,
    ),
    Kind(
        "singular",
        "Redundant constraints, singular mass matrix",
        ("a",),
        lambda s: bool({"redundant", "singular mass"} & {*s.tags}),
    ),
    Kind(
        "controlled",
        "Closed loops with controller states",
        ("a", "x"),
        lambda s: bool(_size(s, "nx")),
    ),
    Kind(
        "large",
        f"Large: more than {_LARGE} unknowns",
        ("a",),
        lambda s: _size(s, "nq", "nl", "nx", "ny") > _LARGE,
    ),
    Kind("conservative", "Motions that keep their energy", (), lambda s: "conservative" in s.tags),
)


def scenes_of_kind(kind: Kind, scenes: Mapping[str, SceneRecord]) -> list[str]:
    """The titles of the scenes of a kind."""
    return [title for title, scene in scenes.items() if kind.has(scene)]
