"""Named points along a motion, and published digits beside computed ones."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from problems.base import checks
from problems.base.runtime import Float
from problems.equations.compiled import compiled
from problems.system import MechatronicSystem
from problems.variables import GROUPS, Published

#: Rows belong to a published time if they differ from it by this part of the interval.
_SAME_TIME = 1e-9


def named_points(
    scene: MechatronicSystem, q: Float[np.ndarray, "k nq"]
) -> dict[str, Float[np.ndarray, "k n"]]:
    """Return the coordinates in m of each named point in k rows; nothing if the scene names none.

    Raises
    ------
    FalseAnswer
        If they are no points.
    """
    if not scene.has("points"):
        return {}
    return checks.points(compiled(scene).points(scene.parameters(), q), len(q))


def published_digits(
    scene: MechatronicSystem, t: Float[np.ndarray, " k"], values: Mapping[str, np.ndarray]
) -> list[tuple[Published, Float[np.ndarray, " n"]]]:
    """Return the published digits that have a row, with the values of that row.

    There are none for other parameters or another start than the scene's own.

    Parameters
    ----------
    t, values
        Times of k rows in s, and the values of each group in them, ``(k, n)``.

    Raises
    ------
    FalseAnswer
        If an entry of `published` is none, or names another quantity or number of values.
    """
    own = checks.published(scene.published)
    if scene.spec != scene.name or "interval" in vars(scene) or not own or not len(t):
        return []
    place = [int(np.abs(t - each.t).argmin()) for each in own]
    near = _SAME_TIME * (scene.interval[1] - scene.interval[0])
    known = {group: np.asarray(values[group]) for group in GROUPS if scene.sizes.of(group)}
    if not all(each.quantity in known for each in own):
        known |= named_points(scene, known["q"])
    found = []
    for each, k in zip(own, place, strict=True):
        checks.one_of(each.quantity, "a quantity of published", known)
        checks.array(each.values, f"published {each.quantity}", known[each.quantity].shape[1:])
        if abs(t[k] - each.t) <= near:
            found.append((each, known[each.quantity][k]))
    return found
