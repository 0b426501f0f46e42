"""Whether the model of an engine is the scene: both must give the same accelerations."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from problems.system import MechatronicSystem, Variables

if TYPE_CHECKING:
    from jaxtyping import Float

#: Values of scene and model differ by less, relative to the largest one at the start, in systems of
#: up to so many coordinates; the rounding of larger ones grows at least with their number.
SAME, SMALL = 1e-9, 100


class ModelDiffers(Exception):
    """The model of an engine is another system than the scene."""


def check_start(
    engine: str,
    scene: MechatronicSystem,
    start: Variables,
    a: Float[np.ndarray, " nq"],
    lam: Float[np.ndarray, " nl"] | None = None,
) -> None:
    """Compare what an engine computes at the start with the scene's own equations.

    Parameters
    ----------
    engine
        Name of the engine, for the message.
    scene, start
        The scene and its consistent values at the start.
    a, lam
        The engine's accelerations and, if it has them, its multipliers there.

    Raises
    ------
    ModelDiffers
        If the largest difference is above `SAME`, or more beyond `SMALL` coordinates, of the largest value.
    """
    limit = SAME * max(1.0, len(a) / SMALL)
    for name, theirs in (("a", a), ("lam", lam)):
        ours = np.asarray(getattr(start, name))
        if theirs is None or not ours.size:
            continue
        gap, size = np.abs(theirs - ours).max(), np.abs(ours).max()
        if not gap <= limit * size:
            raise ModelDiffers(
                f"The model of {scene.spec} in {engine} is another system: at the start its "
                f"{name} differs by {gap / size if size else gap:.1e} of the largest entry; "
                f"at most {limit:.0e} is rounding."
            )
