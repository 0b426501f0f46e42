"""Forces of a fluid on the bodies of a model of MuJoCo: those of its inertia boxes.

MuJoCo's documentation, "Fluid forces", inertia model: a body is pushed like the box that has its
mass and inertia. Drag grows with the square of the speed (density), and Stokes' friction of a ball
of the same mean diameter with the speed itself (viscosity).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from problems.models.mjcf_objects import matrix_of, passive_off
from problems.models.trees import Tree
from problems.runtime import Array, jnp


def is_immersed(m: Any) -> bool:
    """Whether a fluid pushes the bodies."""
    return bool(m.opt.density or m.opt.viscosity) and not passive_off(m)


def ellipsoid(m: Any) -> int | None:
    """The number of the first geometry that MuJoCo's other model of a fluid pushes."""
    shaped = np.flatnonzero(m.geom_fluid[:, 0])
    return int(shaped[0]) if is_immersed(m) and len(shaped) else None


class Fluid:
    """The fluid of a compiled model ``m``, whose bodies are links of a tree."""

    def __init__(self, m: Any, tree: Tree, link_of: Mapping[int, int]) -> None:
        self._tree, self._wind = tree, np.array(m.opt.wind)
        n = len(tree.parent)
        self._turn, box = np.tile(np.eye(3), (n, 1, 1)), np.zeros((n, 3))
        for body in range(1, m.nbody):
            if (mass := m.body_mass[body]) > 0:
                inertia = m.body_inertia[body]
                box[link_of[body]] = np.sqrt(6 * np.maximum(inertia.sum() - 2 * inertia, 0) / mass)
                self._turn[link_of[body]] = matrix_of(m.body_iquat[body])
        # Along and about the axes of the boxes, linear and quadratic in the speed.
        diameter = box.mean(axis=1)[:, None]
        others = np.stack([np.roll(box, -1, axis=1), np.roll(box, -2, axis=1)])
        self._linear = 3 * np.pi * m.opt.viscosity * diameter
        self._turning = np.pi * m.opt.viscosity * diameter**3
        self._square = 0.5 * m.opt.density * others.prod(axis=0)
        self._turning_square = m.opt.density / 64 * box * (others**4).sum(axis=0)

    def force(self, q: Array, v: Array) -> Array:
        """Return the forces on the joints ``(nv,)``, in N (or N m)."""
        at = self._tree.poses(q)
        speed, angular = self._tree.speeds(at, v)
        axes = at.axes @ self._turn
        u = jnp.einsum("nij,ni->nj", axes, speed - self._wind)
        w = jnp.einsum("nij,ni->nj", axes, angular)
        push = u * (self._linear + self._square * jnp.abs(u))
        turn = w * (self._turning + self._turning_square * jnp.abs(w))
        of_space = (jnp.einsum("nij,nj->ni", axes, part) for part in (push, turn))
        return -self._tree.on_joints(at, *of_space)
