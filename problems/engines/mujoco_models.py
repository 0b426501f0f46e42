"""Scenes as models of MuJoCo: trees of bodies in joint coordinates, closed by soft equalities.

Todorov, Erez & Tassa (2012), IROS, doi:10.1109/IROS.2012.6386109.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from problems.models.mjcf import MujocoScene
from problems.models.mjcf_objects import load_mujoco
from problems.runtime import Float, jnp
from problems.scenes.chain import Chain
from problems.scenes.heavy_top import HeavyTop
from problems.scenes.pendulum import Pendulum
from problems.scenes.slider_crank import SliderCrank
from problems.spec import SpecError
from problems.system import MechatronicSystem

#: An inertia that MuJoCo accepts for a point; the model then has zero there.
_POINT = 1e-14


@dataclass(frozen=True)
class MujocoModel:
    """A compiled model of MuJoCo, its start, and its coordinates as ours.

    Attributes
    ----------
    model
        MuJoCo's ``MjModel``.
    qpos, qvel
        Joint coordinates and velocities at the start.
    position
        Our q ``(k, nq)`` of rows of qpos, which may be complex.
    rate
        d/dt qpos of rows of qpos and qvel: qvel itself, but for quaternions.
    control
        Controls of the actuators.
    """

    model: Any
    qpos: np.ndarray
    qvel: np.ndarray
    position: Callable[[np.ndarray], np.ndarray]
    rate: Callable[[np.ndarray, np.ndarray], np.ndarray] = lambda qpos, qvel: qvel
    control: np.ndarray = field(default_factory=lambda: np.zeros(0))

    def motion(self, qpos: np.ndarray, qvel: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Our q and v ``(k, nq)`` of rows of qpos and qvel; v is exact, by a complex step."""
        step = 1e-30
        moved = self.position(qpos + 1j * step * self.rate(qpos, qvel))
        return self.position(qpos), np.imag(moved) / step

    def acceleration(self, qacc: np.ndarray) -> np.ndarray:
        """Our a ``(nq,)`` at the start."""
        qpos, qvel = self.qpos[None], self.qvel[None]
        rate = self.rate(qpos, qvel)
        return _slope(lambda t: self.motion(qpos + t * rate, qvel + t * qacc)[1][0], self.qvel)


class _FromFile(MujocoModel):
    """The model of a scene that was made from it: coordinates and velocities are ours."""

    def motion(self, qpos: np.ndarray, qvel: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return qpos.copy(), qvel.copy()

    def acceleration(self, qacc: np.ndarray) -> np.ndarray:
        return qacc


def _slope(function: Callable[[float], np.ndarray], speed: np.ndarray) -> np.ndarray:
    """Its derivative at 0: central differences, extrapolated to an increment of zero."""
    size = 1e-3 / (np.abs(speed).max() or 1.0)
    coarse, fine = ((function(h) - function(-h)) / (2 * h) for h in (size, size / 2))
    return (4 * fine - coarse) / 3


def _compiled(g: tuple[float, float, float], bodies: str, rest: str = "") -> Any:
    """A model of MuJoCo under gravity; inertias of points are set to zero."""
    text = f"""<mujoco>
      <option gravity="{_text(g)}" jacobian="dense"><flag contact="disable" autoreset="disable"/>
      </option>
      <compiler angle="radian"/>
      <worldbody>{bodies}</worldbody>{rest}
    </mujoco>"""
    try:
        model = load_mujoco().MjModel.from_xml_string(text)
    except ValueError as error:
        raise SpecError(f"MuJoCo does not take these parameters: {error}") from error
    model.body_inertia[model.body_inertia == _POINT] = 0.0
    return model


def _text(numbers: Any) -> str:
    return " ".join(repr(float(number)) for number in numbers)


def _body(joint: str, at: Any, centre: Any, m: float, inertia: Any, inner: str = "") -> str:
    """A body at a place of its parent, with a joint there; centre of mass and inertia."""
    return (
        f'<body pos="{_text(at)}">{joint}<inertial pos="{_text(centre)}" mass="{float(m)!r}" '
        f'diaginertia="{_text(inertia)}"/>{inner}</body>'
    )


_HINGE = '<joint type="hinge" axis="0 0 1"/>'


def _links(s: Pendulum | Chain, q: np.ndarray, v: np.ndarray) -> MujocoModel:
    """Point masses on links, each with a hinge at the end of the one before."""
    points, length = len(q) // 2, s.length
    bodies = ""
    for k in reversed(range(points)):
        at = (0.0, -length if k else 0.0, 0.0)
        bodies = _body(_HINGE, at, (0.0, -length, 0.0), s.m, 3 * [_POINT], bodies)
    link = np.diff(q.reshape(-1, 2), axis=0, prepend=0.0)
    rate = np.diff(v.reshape(-1, 2), axis=0, prepend=0.0)
    angle = np.arctan2(link[:, 0], -link[:, 1])
    turning = (np.cos(angle) * rate[:, 0] + np.sin(angle) * rate[:, 1]) / length

    def position(qpos: np.ndarray) -> np.ndarray:
        angles = np.cumsum(qpos, axis=1)
        links = length * np.stack([np.sin(angles), -np.cos(angles)], axis=2)
        return np.cumsum(links, axis=1).reshape(len(qpos), -1)

    model = _compiled((0.0, -s.g, 0.0), bodies)
    return MujocoModel(model, np.diff(angle, prepend=0.0), np.diff(turning, prepend=0.0), position)


def _slider_crank(s: SliderCrank, q: np.ndarray, v: np.ndarray) -> MujocoModel:
    """Crank and rod in a row, the slider apart; the rod's end is tied to it by an equality."""

    def bar(at: float, m: float, length: float, name: str, inner: str = "") -> str:
        across = m * length**2 / 12
        body = _body(_HINGE, (at, 0, 0), (length / 2, 0, 0), m, (_POINT, across, across), inner)
        return body.replace("<body ", f'<body name="{name}" ', 1)

    rod = bar(s.l1, s.m2, s.l2, "rod")
    guide = '<joint type="slide" axis="1 0 0"/>'
    slider = _body(guide, (0, 0, 0), (0, 0, 0), s.m3, 3 * [_POINT])
    slider = slider.replace("<body ", '<body name="slider" ', 1)
    tie = (
        f'<equality><connect body1="rod" body2="slider" anchor="{_text((s.l2, 0, 0))}"/></equality>'
    )
    model = _compiled((0.0, -s.g, 0.0), bar(0.0, s.m1, s.l1, "crank", rod) + slider, tie)
    model.eq_data[0, 3:6] = 0.0  # the anchor in the slider: MuJoCo takes it from qpos = 0

    def position(qpos: np.ndarray) -> np.ndarray:
        th, rod, x3 = qpos.T
        ph = th + rod
        x, y = s.l1 * np.cos(th), s.l1 * np.sin(th)
        u, w = s.l2 * np.cos(ph), s.l2 * np.sin(ph)
        return np.column_stack([x / 2, y / 2, th, x + u / 2, y + w / 2, ph, x3])

    qpos, qvel = (np.array([z[2], z[5] - z[2], z[6]]) for z in (q, v))
    return MujocoModel(model, qpos, qvel, position)


def _heavy_top(s: HeavyTop, q: np.ndarray, v: np.ndarray) -> MujocoModel:
    """One body on a ball joint: a quaternion, and the angular velocity in the body's axes."""
    centre = (0.0, s.length, 0.0)
    ball = '<joint type="ball"/>'
    model = _compiled((0.0, 0.0, -s.g), _body(ball, (0, 0, 0), centre, s.m, (s.j, s.j_axis, s.j)))

    def position(p: np.ndarray) -> np.ndarray:
        p0, p1, p2, p3 = p.T
        axis = [2 * (p1 * p2 - p0 * p3), p0**2 - p1**2 + p2**2 - p3**2, 2 * (p2 * p3 + p0 * p1)]
        return np.column_stack([s.length * np.stack(axis, axis=1), p])

    def rate(p: np.ndarray, turning: np.ndarray) -> np.ndarray:
        (p0, p1, p2, p3), (w1, w2, w3) = p.T, turning.T
        whole = [-p1 * w1 - p2 * w2 - p3 * w3, p0 * w1 + p2 * w3 - p3 * w2,
                 p0 * w2 + p3 * w1 - p1 * w3, p0 * w3 + p1 * w2 - p2 * w1]  # fmt: skip
        return np.stack(whole, axis=1) / 2

    turning = np.asarray(s.turning(jnp.asarray(q[3:])) @ v[3:])
    return MujocoModel(model, q[3:], turning, position, rate)


def _from_file(s: MujocoScene, q: np.ndarray, v: np.ndarray) -> MujocoModel:
    model, control = s.in_mujoco()
    return _FromFile(model, q, v, lambda qpos: qpos, control=control)


#: Scenes whose model has a soft loop, or may have one.
LOOPS = (SliderCrank, MujocoScene)
#: How a scene becomes a model, from its q and v at the start ``(nq,)``; a SpecError says that
#: MuJoCo does not take the parameters, as it has no body without mass.
MUJOCO_MODELS: dict[type[MechatronicSystem], Callable[..., MujocoModel]] = {
    Pendulum: _links,
    Chain: _links,
    SliderCrank: _slider_crank,
    HeavyTop: _heavy_top,
}


def mujoco_model(scene: MechatronicSystem, q: np.ndarray, v: np.ndarray) -> MujocoModel:
    """Return the model of a scene that starts at q and v."""
    if isinstance(scene, MujocoScene):
        return _from_file(scene, q, v)
    return MUJOCO_MODELS[type(scene)](scene, q, v)


def hard_acceleration(model: Any, data: Any) -> Float[np.ndarray, " nv"]:
    """Accelerations of MuJoCo's model with its equalities rigid, from its own M, J and forces.

    It solves M a + J^T f = forces, J a = -J' v. J' v is a central difference of MuJoCo's J along
    the motion, extrapolated to an increment of zero.

    Parameters
    ----------
    model, data
        ``MjModel`` and ``MjData`` with the state.
    """
    mujoco = load_mujoco()
    mujoco.mj_forward(model, data)
    if not data.nefc:
        return data.qacc.copy()
    jacobian, forces = data.efc_J.reshape(data.nefc, -1).copy(), data.qfrc_smooth.copy()
    mass = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, mass)
    moved = mujoco.MjData(model)

    def speed(time: float) -> np.ndarray:
        moved.qpos[:] = data.qpos
        mujoco.mj_integratePos(model, moved.qpos, data.qvel, time)
        mujoco.mj_forward(model, moved)
        return moved.efc_J.reshape(jacobian.shape) @ data.qvel

    rows = len(jacobian)
    whole = np.block([[mass, jacobian.T], [jacobian, np.zeros((rows, rows))]])
    right = np.concatenate([forces, -_slope(speed, data.qvel)])
    return np.linalg.lstsq(whole, right)[0][: model.nv]  # a plane tie has a row of zeros
