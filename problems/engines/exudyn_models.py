"""Scenes as models of the multibody code exudyn: bodies, joints and loads of its own.

Gerstmayr (2024), Multibody System Dynamics, doi:10.1007/s11044-023-09937-1.
"""

from __future__ import annotations

import contextlib
import io
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from problems.scenes.chain import Chain
from problems.scenes.heavy_top import HeavyTop
from problems.scenes.pendulum import Pendulum
from problems.scenes.slider_crank import SliderCrank
from problems.system import MechatronicSystem

#: Our multipliers ``(k, nl)`` from q, v ``(k, nq)`` and exudyn's algebraic coordinates.
Multipliers = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]


@dataclass(frozen=True)
class ExudynModel:
    """An assembled system of exudyn, whose coordinates are those of the scene in their order."""

    system: Any
    multipliers: Multipliers


@cache
def load_exudyn() -> tuple[Any, Any]:
    """The modules exudyn, in its build without range checks, and exudyn.itemInterface."""
    sys.exudynFast = True  # pyright: ignore[reportAttributeAccessIssue] - how exudyn is asked
    with contextlib.redirect_stdout(io.StringIO()):  # it tells of the build
        import exudyn
        import exudyn.itemInterface
    return exudyn, exudyn.itemInterface


class _Builder:
    """A system in work: it makes the items of exudyn that several scenes need."""

    def __init__(self) -> None:
        exudyn, self.items = load_exudyn()
        self.system = exudyn.SystemContainer().AddSystem()
        self.ground = self.system.AddObject(self.items.ObjectGround())

    def node(self, kind: str, q: np.ndarray, v: np.ndarray) -> int:
        make = getattr(self.items, kind)
        return self.system.AddNode(make(referenceCoordinates=list(q), initialVelocities=list(v)))

    def body(self, kind: str, node: int, **data: Any) -> int:
        return self.system.AddObject(getattr(self.items, kind)(nodeNumber=node, **data))

    def marker(self, body: int, at: Sequence[float] = (0, 0, 0), kind: str = "Position") -> int:
        make = getattr(self.items, f"MarkerBody{kind}")
        return self.system.AddMarker(make(bodyNumber=body, localPosition=list(at)))

    def load(self, body: int, force: Sequence[float]) -> None:
        marker = self.marker(body)
        self.system.AddLoad(self.items.Force(markerNumber=marker, loadVector=list(force)))

    def join(self, kind: str, one: int, other: int, **data: Any) -> None:
        make = getattr(self.items, kind)
        self.system.AddObject(make(markerNumbers=[one, other], **data))

    def model(self, multipliers: Multipliers) -> ExudynModel:
        self.system.Assemble()
        return ExudynModel(self.system, multipliers)


def _points(s: Pendulum | Chain, q: np.ndarray, v: np.ndarray) -> ExudynModel:
    """Point masses on links from the origin; the constraint of a link is |d| - length = 0.

    Ours is (d.d - length^2)/2, whose multiplier is the link's force divided by its length.
    """
    build = _Builder()
    before = build.marker(build.ground)
    for at in np.arange(len(q)).reshape(-1, 2):
        node = build.node("NodePoint2D", q[at], v[at])
        point = build.body("ObjectMassPoint2D", node, mass=s.m)
        build.load(point, (0, -s.m * s.g, 0))
        here = build.marker(point)
        build.join("ObjectConnectorDistance", before, here, distance=s.length)
        before = here
    return build.model(lambda q, v, forces: forces / s.length)


def _slider_crank(s: SliderCrank, q: np.ndarray, v: np.ndarray) -> ExudynModel:
    build = _Builder()

    def bar(at: slice, m: float, length: float) -> int:
        node = build.node("NodeRigidBody2D", q[at], v[at])
        body = build.body("ObjectRigidBody2D", node, mass=m, inertia=m * length**2 / 12)
        build.load(body, (0, -m * s.g, 0))
        return body

    crank, rod = bar(slice(0, 3), s.m1, s.l1), bar(slice(3, 6), s.m2, s.l2)
    slider = build.body("Mass1D", build.node("Node1D", q[6:], v[6:]), mass=s.m3)
    for one, other in (
        (build.marker(build.ground), build.marker(crank, (-s.l1 / 2, 0, 0))),
        (build.marker(crank, (s.l1 / 2, 0, 0)), build.marker(rod, (-s.l2 / 2, 0, 0))),
        (build.marker(rod, (s.l2 / 2, 0, 0)), build.marker(slider)),
    ):
        build.join("RevoluteJoint2D", one, other)
    # Ours are sums of the joints' gaps (x1, y1, x2, y2, x3, y3) along the mechanism: Phi = T gaps,
    # and the same forces T^T lam.
    sums = np.zeros((6, 6))
    sums[[0, 2, 2, 4, 4, 4], [0, 0, 2, 0, 2, 4]] = 1
    sums[[1, 3, 3], [1, 1, 3]] = 1
    sums[5, [1, 3, 5]] = -1
    to_ours = np.linalg.inv(sums)  # rows: lam = T^-T forces
    return build.model(lambda q, v, forces: forces @ to_ours)


def _heavy_top(s: HeavyTop, q: np.ndarray, v: np.ndarray) -> ExudynModel:
    build = _Builder()
    body = build.body(
        "ObjectRigidBody",
        build.node("NodeRigidBodyEP", q, v),
        mass=s.m,
        inertia=[s.j, s.j_axis, s.j, 0, 0, 0],
    )
    build.load(body, (0, 0, -s.m * s.g))
    foot = build.marker(body, (0, -s.length, 0), "Rigid")
    build.join("SphericalJoint", build.marker(build.ground, kind="Rigid"), foot)

    def multipliers(q: np.ndarray, v: np.ndarray, forces: np.ndarray) -> np.ndarray:
        # exudyn's equations of turning have nothing along the Euler parameters p. Ours have the
        # gyroscopic term there, and the joint's constraint, which is quadratic in p:
        # p.p lam4 = 2 w.J w + 2 length axis.(lam1, lam2, lam3).
        p0, p1, p2, p3 = q[:, 3:].T
        r0, r1, r2, r3 = v[:, 3:].T
        spin = [p0 * r1 - p1 * r0 + p3 * r2 - p2 * r3, p0 * r2 - p2 * r0 + p1 * r3 - p3 * r1,
                p0 * r3 - p3 * r0 + p2 * r1 - p1 * r2]  # fmt: skip
        turning = 4 * (s.j * (spin[0] ** 2 + spin[2] ** 2) + s.j_axis * spin[1] ** 2)
        joint = forces[:, 1:]
        along = (joint * q[:, :3]).sum(axis=1)  # x = length axis
        own = (2 * turning + 2 * along) / (q[:, 3:] ** 2).sum(axis=1)
        return np.column_stack([joint, own])

    return build.model(multipliers)


#: How a scene becomes a model, from its q and v at the start ``(nq,)``.
EXUDYN_MODELS: dict[type[MechatronicSystem], Callable[..., ExudynModel]] = {
    Pendulum: _points,
    SliderCrank: _slider_crank,
    Chain: _points,
    HeavyTop: _heavy_top,
}
