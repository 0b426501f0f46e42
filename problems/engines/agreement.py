"""Whether an engine has a model of a scene, and whether it is the same system."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from problems.runtime import Float
from problems.scenes.pendulum import Pendulum
from problems.system import MechatronicSystem
from problems.variables import Variables

#: Values of scene and model differ by less, relative to the largest one at the start, in systems of
#: up to so many coordinates; the rounding of larger ones grows at least with their number.
SAME, SMALL = 1e-9, 100
#: Largest values below it are compared as if they were it, in SI units: rest leaves rounding.
REST = 1e-3


class ModelDiffers(Exception):
    """The model of an engine is another system than the scene."""


def why_not(
    engine: str, scene: MechatronicSystem, stated: Collection[type[MechatronicSystem]]
) -> str | None:
    """Return why an engine cannot take a scene, in a sentence, or None.

    Parameters
    ----------
    engine
        Name of the engine, for the message.
    scene
        The scene in question.
    stated
        The scenes that have a model in the engine.
    """
    if type(scene) not in stated:
        known = ", ".join(sorted(one.name for one in stated))
        return f"{engine} takes scenes that have a model there: {known}."
    if isinstance(scene, Pendulum) and scene.copies > 1:
        return f"The model in {engine} has the rod once; take copies=1."
    return None


def check_agreement(
    engine: str, scene: MechatronicSystem, start: Variables, **theirs: Float[np.ndarray, " n"]
) -> None:
    """Compare what an engine computes at the start with the scene's own equations.

    Parameters
    ----------
    engine
        Name of the engine, for the message.
    scene, start
        The scene and its consistent values at the start.
    theirs
        The engine's values there by group: q, v, a and, if it has them, lam.

    Raises
    ------
    ModelDiffers
        If the largest difference is above `SAME` of the largest value (more for large systems).
    """
    limit = SAME * max(1.0, scene.sizes.nq / SMALL)
    for name, values in theirs.items():
        ours = np.asarray(getattr(start, name))
        gap, size = np.abs(values - ours).max(), max(np.abs(ours).max(), REST)
        if not gap <= limit * size:
            raise ModelDiffers(
                f"The model of {scene.spec} in {engine} is another system: at the start its "
                f"{name} differs by {gap / size:.1e} of the largest entry; "
                f"at most {limit:.0e} is rounding."
            )
