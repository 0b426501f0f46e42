"""Trees of links from models of MuJoCo: bodies, each below a chain of its joints."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from problems.models.mjcf_objects import called, is_off, matrix_of, numbers, passive_off
from problems.models.trees import Tree
from problems.spec import SpecError

#: Most links: the matrices of ancestors grow with the square.
MOST_LINKS = 400


class Branches(NamedTuple):
    """A tree of links, and its relation to a model of MuJoCo.

    ``balls``
        first coordinate and first velocity of each quaternion
    ``link_of``
        the link that is each body; -1: the ground
    ``named``
        the same by the names of bodies, without the ground
    """

    tree: Tree
    balls: list[tuple[int, int]]
    link_of: dict[int, int]
    named: dict[str, int]


def branches(m: Any) -> Branches:
    """Return the tree of a model; a free joint is three slides and a ball.

    Raises
    ------
    SpecError
        If nothing moves, or the model has more than `MOST_LINKS` links.
    """
    types = numbers("mjtJoint")
    rows: list[dict[str, Any]] = []
    last = {0: -1}
    balls, named = [], {}

    def link(parent: int, **more: Any) -> int:
        rows.append(
            dict(
                parent=parent, place=np.zeros(3), axes=np.eye(3), kind="fixed",
                axis=np.zeros(3), anchor=np.zeros(3), at_q=0, at_v=0, zero=0.0, mass=0.0,
                centre=np.zeros(3), inertia=np.zeros((3, 3)), weightless=0.0,
            )
            | more
        )  # fmt: skip
        return len(rows) - 1

    for body in range(1, m.nbody):
        above = last[m.body_parentid[body]]
        place: dict[str, Any] = {
            "place": np.array(m.body_pos[body]), "axes": matrix_of(m.body_quat[body])
        }  # fmt: skip
        joints = range(m.body_jntadr[body], m.body_jntadr[body] + m.body_jntnum[body])
        for j in joints:
            at_q, at_v = int(m.jnt_qposadr[j]), int(m.jnt_dofadr[j])
            own = {"at_q": at_q, "at_v": at_v, "anchor": np.array(m.jnt_pos[j])}
            if m.jnt_type[j] == types.mjJNT_FREE:
                for i in range(3):
                    above = link(
                        above, kind="slide", axis=np.eye(3)[i], at_q=at_q + i, at_v=at_v + i
                    )
                own = {"at_q": at_q + 3, "at_v": at_v + 3}
                place = {}
            if m.jnt_type[j] in (types.mjJNT_FREE, types.mjJNT_BALL):
                balls.append((own["at_q"], own["at_v"]))
                above = link(above, kind="ball", **own, **place)
            else:
                kind = "hinge" if m.jnt_type[j] == types.mjJNT_HINGE else "slide"
                axis, zero = np.array(m.jnt_axis[j]), float(m.qpos0[at_q])
                above = link(above, kind=kind, axis=axis, zero=zero, **own, **place)
            place = {}
        if not len(joints):
            above = link(above, **place)
        turn = matrix_of(m.body_iquat[body])
        rows[above] |= {
            "mass": float(m.body_mass[body]),
            "centre": np.array(m.body_ipos[body]),
            "inertia": turn @ np.diag(m.body_inertia[body]) @ turn.T,
            "weightless": float(m.body_gravcomp[body]) * (not passive_off(m)),
        }
        last[body] = above
        named[called(m, "BODY", body)] = above
    if len(rows) > MOST_LINKS:
        raise SpecError(f"The model has {len(rows)} links; a scene has at most {MOST_LINKS}.")
    if not m.nv:
        raise SpecError("The model has no joint: nothing moves.")
    columns = {key: [row[key] for row in rows] for key in rows[0]}
    kinds = tuple(columns.pop("kind"))
    arrays = {key: np.array(values) for key, values in columns.items()}
    gravity = np.array(m.opt.gravity) * (not is_off(m, "GRAVITY"))
    tree = Tree(kind=kinds, gravity=gravity, nq=m.nq, nv=m.nv, **arrays)
    return Branches(tree, balls, last, named)
