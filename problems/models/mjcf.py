"""Scenes from files of MuJoCo (MJCF) and URDF: a model that `mujoco` has compiled, as equations.

MuJoCo reads the file and fills arrays; q is its qpos, v its qvel. Its own C is the oracle: each
model is compared at random states when it is loaded. Todorov, Erez & Tassa (2012),
doi:10.1109/IROS.2012.6386109.
"""

from __future__ import annotations

import copy
import dataclasses
import hashlib
import json
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from functools import cached_property
from pathlib import Path
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np

from problems.initial_values import CONSISTENCY_TOLERANCE
from problems.models import trees
from problems.models.trees import Tree
from problems.plain_text import said
from problems.rotations import quaternion_rate, turned
from problems.runtime import CACHE, Array, Float, jax, jnp
from problems.spec import SpecError, is_name
from problems.system import MechatronicSystem, parameter
from problems.variables import State
from problems.whole_files import keep, kept

#: Largest difference from MuJoCo's numbers, relative to the largest of them, and the number of
#: random states at which they are compared.
SAME, STATES = 1e-11, 4
#: Most links: the matrices of ancestors grow with the square.
MOST_LINKS = 400
#: What a parameter says of a part that the equations do not have.
REFUSED, LEFT_OUT = "refused", "left_out"
_LETTERS = ("x", "y", "z")
#: Oblique view: y to the right, z up, x towards the lower left.
_VIEW = np.array([[-0.4, 1.0, 0.0], [-0.4, 0.0, 1.0]])


def load_mujoco() -> Any:
    """Return the module mujoco, which does not state its types.

    Raises
    ------
    SpecError
        If it is not installed.
    """
    try:
        import mujoco
    except ImportError:
        raise SpecError(
            'Models of MuJoCo and URDF need the package mujoco: pip install "stepbench[mujoco]".'
        ) from None
    return mujoco


class MujocoScene(MechatronicSystem):
    """Base of scenes from MuJoCo's models; see `from_mjcf`.

    M, bias, springs, dampers, armatures, gravity, actuators of constant control and equality
    constraints are MuJoCo's. A soft equality of MuJoCo is a rigid constraint here.
    """

    model: ClassVar[_Model]

    def __post_init__(self) -> None:
        lacking = self.model.lacking
        if left := [key for key in lacking if getattr(self, key) != LEFT_OUT]:
            parts = ", and ".join(lacking[key] for key in left)
            options = ",".join(f"{key}={LEFT_OUT}" for key in lacking)
            raise SpecError(
                f"{self.name}: the model has {parts}; a scene cannot state this. "
                f"{self.name}[{options}] leaves it out."
            )

    # ---- blocks
    def mass(self, q: Array) -> Array:
        return self.model.tree.mass_matrix(q) + np.diag(self.model.armature)

    def force(self, q: Array, v: Array, t: Array) -> Array:
        model = self.model
        control = jnp.array([getattr(self, name) for name in model.controls])
        return model.passive(q, v) + model.actuators(q, v, control) - model.tree.bias(q, v)

    def kinematics(self, q: Array, v: Array) -> Array:
        return self.model.moved(q, v, quaternion_rate)

    def move(self, q: Array, w: Array) -> Array:
        return self.model.moved(q, w, turned)

    def constraint(self, q: Array, t: Array) -> Array:
        return self.model.equalities(q)[self.model.rows]

    def energy(self, q: Array, v: Array) -> Array:
        potential = self.model.tree.weight_energy(q) + self.model.spring_energy(q)
        return 0.5 * v @ self.mass(q) @ v + potential

    def points(self, q: Array) -> dict[str, Array]:
        """Centres of mass of the bodies, by their names."""
        centres = self.model.tree.centres(q)
        return {name: centres[k] for name, k in self.model.named.items()}

    # ---- the same model in MuJoCo
    def in_mujoco(self) -> tuple[Any, Float[np.ndarray, " nu"]]:
        """Return a copy of MuJoCo's model without what is left out, and the controls."""
        return self.model.clean(), np.array([getattr(self, name) for name in self.model.controls])

    # ---- start and picture
    def initial_state(self) -> State:
        return State(*self.model.start)

    def draw(self, q: np.ndarray) -> list[np.ndarray]:
        """Lines between the origins of neighbouring bodies, and to the centres of the last."""
        tree = self.model.tree
        at = tree.poses(jnp.asarray(q))
        origins = np.asarray(at.origins)
        centres = origins + np.einsum("nij,nj->ni", np.asarray(at.axes), tree.centre)
        lines = []
        for k, parent in enumerate(tree.parent):
            start = origins[parent] if parent >= 0 else np.zeros(3)
            lines.append([start, origins[k]])
            if k not in tree.parent and tree.mass[k]:
                lines.append([origins[k], centres[k]])
        return [np.asarray(line) @ _VIEW.T for line in lines]


def from_mjcf(
    file: str | Path,
    *,
    name: str | None = None,
    interval: tuple[float, float] = (0.0, 2.0),
    nominal_step: float | None = None,
) -> type[MechatronicSystem]:
    """Return the scene class of a model of MuJoCo or a URDF.

    The start is the first keyframe, else qpos0 at rest; controls are those of the keyframe, else
    zero, and parameters of the scene. Positions that violate an equality by little, as numbers of
    a file have few digits, are moved to the nearest that satisfy all.

    Parameters
    ----------
    file
        Path of a file that MuJoCo reads, with all files that it includes.
    name
        Name of the scene; by default that of the file.
    interval
        Start and end in s.
    nominal_step
        Largest step of a convergence study in s; by default five steps of the model's own.

    Raises
    ------
    SpecError
        If MuJoCo does not take the file, the model has something that cannot be left out, its start
        violates the equalities, or MuJoCo computes other numbers.
    """
    path = Path(file)
    name = path.stem.replace("-", "_").replace(".", "_") if name is None else name
    cls = "".join(part[:1].upper() + part[1:] for part in name.split("_"))
    if not (is_name(name) and cls.isidentifier()):
        raise SpecError(f"{name!r} is no name of a scene, such as 'robot'; give another one.")
    mujoco = load_mujoco()
    try:
        compiled = mujoco.MjModel.from_xml_path(str(path))
    except (ValueError, RuntimeError, OSError) as error:
        raise SpecError(f"MuJoCo cannot read {path}: {said(error)}") from None
    model = _Model(compiled, name)
    fields: list[Any] = [
        (key, str, _choice(f"{sentence}: {LEFT_OUT} leaves this out"))
        for key, sentence in model.lacking.items()
    ]
    for k, control in enumerate(model.controls):
        told = parameter(float(model.start_control[k]), "1", f"control of actuator {k}")
        fields.append((control, float, told))
    caller = sys._getframe(1).f_globals.get("__name__", __name__)  # as `collections.namedtuple`
    made = dataclasses.make_dataclass(
        cls,
        fields,
        bases=(MujocoScene,),
        frozen=True,
        namespace={
            "__doc__": model.summary,
            "name": name,
            "model": model,
            "interval": interval,
            "nominal_step": 5 * compiled.opt.timestep if nominal_step is None else nominal_step,
            "coordinates": model.coordinates,
            "velocities": model.velocities if model.balls else (),
            "multipliers": model.multipliers,
            "redundant": model.redundant,
            "tags": model.tags,
            "source": f"model of {path.name}",
            "source_text": model.text,
            **{block: None for block in model.without},
        },
    )
    made.__module__ = caller  # newer Pythons set that of this call
    if not model.is_checked:
        model.check()
        model.keep_start()
    return made


def _choice(words: str) -> Any:
    """A parameter that is `REFUSED` or `LEFT_OUT`."""
    meta = {"type": str, "unit": "", "doc": words, "choices": (REFUSED, LEFT_OUT)}
    return dataclasses.field(default=REFUSED, metadata=meta)


# ---- reading -----------------------------------------------------------------------------
class _Model:
    """Numbers and functions of a model of MuJoCo, which is called ``m``, for equations of motion."""

    def __init__(self, m: Any, name: str) -> None:
        self.m, self.name, self.mujoco = m, name, load_mujoco()
        self.lacking = dict(self._lacking())
        self.tree, self.balls, self.named = self._tree()
        self.armature = np.array(m.dof_armature)
        self.controls = self._control_names()
        data = self.mujoco.MjData(m)
        if m.nkey:
            self.mujoco.mj_resetDataKeyframe(m, data, 0)
        self.start_control = data.ctrl.copy()
        self.rows = np.arange(self._count())
        sources = b"".join(Path(file).read_bytes() for file in (__file__, trees.__file__))
        digest = hashlib.sha256(sources + self.text.encode()).hexdigest()[:32]
        #: Where the start is kept once all numbers have been compared.
        self._place_of_start = CACHE / "models" / digest
        if (start := kept(self._place_of_start)) is not None:
            found = json.loads(start)
            self.start = np.array(found["q"]), np.array(found["v"])
            self.rows, self.redundant = np.array(found["rows"], dtype=int), found["redundant"]
        else:
            self._place(data)

    # ---- facts
    @property
    def summary(self) -> str:
        m = self.m
        return (
            f"A model of MuJoCo: {m.nbody - 1} bodies, {m.njnt} joints, {m.nu} actuators, "
            f"{len(self.rows)} constraints."
        )

    @property
    def tags(self) -> tuple[str, ...]:
        return ("multibody", *(("constrained", "index 3") if len(self.rows) else ()))

    @property
    def without(self) -> list[str]:
        """Blocks that the scene does not state."""
        m = self.m
        lost = [] if self.balls else ["kinematics", "move"]
        lost += [] if len(self.rows) else ["constraint"]
        dissipates = m.dof_damping.any() or m.dof_dampingpoly.any() or m.nu
        return [*lost, *(["energy"] if dissipates else [])]

    @cached_property
    def text(self) -> str:
        """All numbers of the model, for its fingerprint."""
        size = self.mujoco.mj_sizeModel(self.m)
        buffer = np.empty(size, dtype=np.uint8)
        self.mujoco.mj_saveModel(self.m, None, buffer)
        return hashlib.sha256(buffer.tobytes()).hexdigest()

    def _called(self, kind: str, k: int) -> str:
        """The name of an object in quotes, or its number."""
        own = self.mujoco.mj_id2name(self.m, getattr(self.mujoco.mjtObj, f"mjOBJ_{kind}"), k)
        return f"'{own}'" if own else f"number {k}"

    def _joint(self, k: int) -> str:
        return self._called("JOINT", k).strip("'").replace("number ", "joint ")

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of q, with units."""
        types, found = _numbers(self.mujoco.mjtJoint), []
        quaternion = [f"p{i}" for i in range(4)]
        for k, kind in enumerate(self.m.jnt_type):
            name = self._joint(k)
            parts = {
                types.mjJNT_FREE: [f"{c} [m]" for c in _LETTERS] + quaternion,
                types.mjJNT_BALL: quaternion,
            }.get(kind)
            unit = "m" if kind == types.mjJNT_SLIDE else "rad"
            found += [f"{name} {part}" for part in parts] if parts else [f"{name} [{unit}]"]
        return tuple(found)

    @property
    def velocities(self) -> tuple[str, ...]:
        """Names of v, with units."""
        types, found = _numbers(self.mujoco.mjtJoint), []
        spin = [f"Omega {i} [rad/s]" for i in (1, 2, 3)]
        for k, kind in enumerate(self.m.jnt_type):
            name = self._joint(k)
            parts = {
                types.mjJNT_FREE: [f"{c} [m/s]" for c in _LETTERS] + spin,
                types.mjJNT_BALL: spin,
            }.get(kind)
            unit = "m/s" if kind == types.mjJNT_SLIDE else "rad/s"
            found += [f"{name} {part}" for part in parts] if parts else [f"{name} [{unit}]"]
        return tuple(found)

    @property
    def multipliers(self) -> tuple[str, ...]:
        every = [
            f"{self._called('EQUALITY', k).strip(chr(39))} {row}"
            for k in self._active()
            for row in range(self._sizes()[self.m.eq_type[k]])
        ]
        return tuple(every[row] for row in self.rows)

    def _control_names(self) -> tuple[str, ...]:
        names = []
        for k in range(self.m.nu):
            own = self._called("ACTUATOR", k).strip("'").replace("number ", "")
            names.append("control_" + "".join(c if c.isalnum() else "_" for c in own))
        return (
            tuple(names)
            if len({*names}) == len(names)
            else tuple(f"control_{k}" for k in range(self.m.nu))
        )

    # ---- what cannot be stated
    def _lacking(self) -> Iterator[tuple[str, str]]:
        """Parts of the model that a scene cannot have, with what they are and where."""
        m, has = self.m, self._some
        if pair := self._contact():
            yield "contacts", f"contacts ({pair})"
        if where := has("JOINT", m.jnt_limited):
            yield "limits", f"limits of joints ({where})"
        if where := has("JOINT", m.dof_frictionloss, m.dof_jntid):
            yield "friction_loss", f"frictionloss (joint {where})"
        if m.ntendon:
            yield "tendons", f"tendons ({self._called('TENDON', 0)})"
        if m.nflex:
            yield "flexes", f"flexes ({self._called('FLEX', 0)})"
        if m.opt.density or m.opt.viscosity:
            yield "fluid", "forces of a fluid (density or viscosity)"
        if where := has("JOINT", m.jnt_springyield):
            yield "plasticity", f"springs that yield (joint {where})"
        if where := self._odd_spring():
            yield "ball_springs", f"springs of ball or free joints ({where})"
        if where := self._odd_actuator():
            yield (
                "actuators",
                f"an actuator that is no affine force of a joint ({where})",
            )
        if where := self._odd_equality():
            yield (
                "equalities",
                f"an equality other than connect, weld, joint ({where})",
            )
        if m.nplugin:
            yield "plugins", "plugins of MuJoCo"

    def _some(self, kind: str, values: np.ndarray, owner: np.ndarray | None = None) -> str:
        """The name of the first object with a value, or nothing."""
        found = np.flatnonzero([np.any(value) for value in values])
        if not len(found):
            return ""
        return self._called(kind, int(found[0] if owner is None else owner[found[0]]))

    def _contact(self) -> str:
        """The first pair of geometries that may touch."""
        m = self.m
        if m.opt.disableflags & int(self.mujoco.mjtDisableBit.mjDSBL_CONTACT):
            return ""
        if m.npair:
            return f"pair {self._called('PAIR', 0)}"
        excluded = {int(s) for s in m.exclude_signature}
        filtered = not m.opt.disableflags & int(self.mujoco.mjtDisableBit.mjDSBL_FILTERPARENT)
        for i in range(m.ngeom):
            for j in range(i + 1, m.ngeom):
                one, other = int(m.geom_bodyid[i]), int(m.geom_bodyid[j])
                weld, other_weld = m.body_weldid[one], m.body_weldid[other]
                up, other_up = m.body_weldid[m.body_parentid[[weld, other_weld]]]
                kin = filtered and weld and other_weld and (up == other_weld or other_up == weld)
                meet = (m.geom_contype[i] & m.geom_conaffinity[j]) or (
                    m.geom_contype[j] & m.geom_conaffinity[i]
                )
                if not meet or weld == other_weld or kin:
                    continue
                if ((one + 1) << 16) + other + 1 in excluded or ((one << 16) + other) in excluded:
                    continue
                bodies = [self._called("BODY", body) for body in (one, other)]
                geoms = [self._called("GEOM", geom) for geom in (i, j)]
                return f"geom {geoms[0]} of body {bodies[0]} and {geoms[1]} of {bodies[1]}"
        return ""

    def _odd_spring(self) -> str:
        types = _numbers(self.mujoco.mjtJoint)
        wide = np.isin(self.m.jnt_type, [types.mjJNT_FREE, types.mjJNT_BALL])
        stiff = (self.m.jnt_stiffness != 0) | self.m.jnt_stiffnesspoly.any(1)
        return self._some("JOINT", wide & stiff)

    def _odd_actuator(self) -> str:
        m, mj = self.m, self.mujoco
        ways, joints, own = map(_numbers, (mj.mjtTrn, mj.mjtJoint, mj.mjtDyn))
        gains, biases = map(_numbers, (mj.mjtGain, mj.mjtBias))
        for k in range(m.nu):
            joint = m.actuator_trnid[k, 0]
            usual = (
                m.actuator_trntype[k] in (ways.mjTRN_JOINT, ways.mjTRN_JOINTINPARENT)
                and m.jnt_type[joint] in (joints.mjJNT_HINGE, joints.mjJNT_SLIDE)
                and m.actuator_dyntype[k] == own.mjDYN_NONE
                and m.actuator_gaintype[k] in (gains.mjGAIN_FIXED, gains.mjGAIN_AFFINE)
                and m.actuator_biastype[k] in (biases.mjBIAS_NONE, biases.mjBIAS_AFFINE)
                and not m.jnt_actfrclimited[joint]
            )
            if not usual:
                return self._called("ACTUATOR", k)
        return ""

    def _odd_equality(self) -> str:
        known = self._sizes()
        odd = [k for k in range(self.m.neq) if self.m.eq_type[k] not in known]
        return self._called("EQUALITY", odd[0]) if odd else ""

    # ---- tree
    def _tree(self) -> tuple[Tree, list[tuple[int, int]], dict[str, int]]:
        """The links, (first coordinate, first velocity) of each quaternion, and the link of each
        named body."""
        m, types = self.m, _numbers(self.mujoco.mjtJoint)
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
                "place": np.array(m.body_pos[body]), "axes": _matrix(m.body_quat[body])
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
            turn = _matrix(m.body_iquat[body])
            rows[above] |= {
                "mass": float(m.body_mass[body]),
                "centre": np.array(m.body_ipos[body]),
                "inertia": turn @ np.diag(m.body_inertia[body]) @ turn.T,
                "weightless": float(m.body_gravcomp[body]),
            }
            last[body] = above
            named[self._called("BODY", body).strip("'").replace("number", "body")] = above
        if len(rows) > MOST_LINKS:
            raise SpecError(
                f"{self.name} has {len(rows)} links; a scene from a file has at most {MOST_LINKS}."
            )
        if not m.nv:
            raise SpecError(f"{self.name} has no joint: nothing moves.")
        self.link_of = last
        columns = {key: [row[key] for row in rows] for key in rows[0]}
        kinds = tuple(columns.pop("kind"))
        arrays = {key: np.array(values) for key, values in columns.items()}
        falls = not m.opt.disableflags & int(self.mujoco.mjtDisableBit.mjDSBL_GRAVITY)
        gravity = np.array(m.opt.gravity) * falls
        return Tree(kind=kinds, gravity=gravity, nq=m.nq, nv=m.nv, **arrays), balls, named

    def moved(
        self, q: Array, w: Array, turn: Callable[[Array, Array], Array]
    ) -> Float[Array, " nq"]:
        """Coordinates moved by w, or their rate: quaternions by ``turn``, others by sums."""
        start, at_q, at_v, parts = q * (turn is not quaternion_rate), 0, 0, []
        for first_q, first_v in [*self.balls, (self.m.nq, self.m.nv)]:
            parts.append(start[at_q:first_q] + w[at_v:first_v])
            at_q, at_v = first_q + 4, first_v + 3
            if at_q <= self.m.nq:
                parts.append(turn(q[first_q:at_q], w[first_v:at_v]))
        return jnp.concatenate(parts)

    # ---- forces
    @cached_property
    def _springs(self) -> tuple[np.ndarray, ...]:
        """Coordinates, velocities, rests and stiffnesses ``(k, 3)`` of hinges and slides."""
        m, types = self.m, _numbers(self.mujoco.mjtJoint)
        own = np.flatnonzero(np.isin(m.jnt_type, [types.mjJNT_HINGE, types.mjJNT_SLIDE]))
        stiff = np.column_stack([m.jnt_stiffness, m.jnt_stiffnesspoly])[own]
        own, stiff = own[stiff.any(1)], stiff[stiff.any(1)]
        at = m.jnt_qposadr[own]
        off = m.opt.disableflags & int(self.mujoco.mjtDisableBit.mjDSBL_SPRING)
        return at, m.jnt_dofadr[own], m.qpos_spring[at], stiff * (not off)

    def passive(self, q: Array, v: Array) -> Array:
        """Forces of springs and dampers."""
        at_q, at_v, rest, stiff = self._springs
        off = self.m.opt.disableflags & int(self.mujoco.mjtDisableBit.mjDSBL_DAMPER)
        damping = np.column_stack([self.m.dof_damping, self.m.dof_dampingpoly]) * (not off)
        force: Any = jnp.zeros(self.m.nv)
        if damping.any():
            force -= v * _polynomial(damping, jnp.abs(v))
        if len(at_q):
            way = q[at_q] - rest
            force = force.at[at_v].add(-way * _polynomial(stiff, way))
        return force

    def spring_energy(self, q: Array) -> Any:
        """Energy of the springs in J."""
        at_q, _, rest, stiff = self._springs
        way = q[at_q] - rest
        parts = stiff / np.arange(2, 2 + stiff.shape[1])
        return jnp.sum(way**2 * _polynomial(parts, way)) if len(at_q) else jnp.zeros(())

    def actuators(self, q: Array, v: Array, control: Array) -> Array:
        """Forces of the actuators at a control."""
        m, mj = self.m, self.mujoco
        force = jnp.zeros(m.nv)
        if not m.nu or "actuators" in self.lacking:
            return force
        if m.opt.disableflags & int(mj.mjtDisableBit.mjDSBL_ACTUATION):
            return force
        joint, gear = m.actuator_trnid[:, 0], np.array(m.actuator_gear[:, 0])
        length, speed = gear * q[m.jnt_qposadr[joint]], gear * v[m.jnt_dofadr[joint]]
        limited = m.actuator_ctrllimited.astype(bool)
        low, high = np.where(limited[:, None], m.actuator_ctrlrange, [-np.inf, np.inf]).T
        control = jnp.clip(control, low, high)

        def affine(given: np.ndarray, used: np.ndarray) -> Any:
            first, second, third = (np.where(used, given[:, i], 0.0) for i in range(3))
            return first + second * length + third * speed

        varies = m.actuator_gaintype == int(mj.mjtGain.mjGAIN_AFFINE)
        gain = np.where(varies, 0.0, m.actuator_gainprm[:, 0])
        given = gain * control + affine(m.actuator_gainprm, varies) * control
        given += affine(m.actuator_biasprm, m.actuator_biastype == int(mj.mjtBias.mjBIAS_AFFINE))
        limited = m.actuator_forcelimited.astype(bool)
        low, high = np.where(limited[:, None], m.actuator_forcerange, [-np.inf, np.inf]).T
        if limited.any():
            given = jnp.clip(given, low, high)
        return force.at[m.jnt_dofadr[joint]].add(gear * given)

    # ---- equalities
    def _sizes(self) -> Mapping[int, int]:
        types = _numbers(self.mujoco.mjtEq)
        return {types.mjEQ_CONNECT: 3, types.mjEQ_WELD: 6, types.mjEQ_JOINT: 1}

    def _active(self) -> list[int]:
        off = self.m.opt.disableflags & int(self.mujoco.mjtDisableBit.mjDSBL_EQUALITY)
        own = [k for k in range(self.m.neq) if self.m.eq_type[k] in self._sizes()]
        return [] if off else [k for k in own if self.m.eq_active0[k]]

    def _count(self) -> int:
        return sum(self._sizes()[self.m.eq_type[k]] for k in self._active())

    def equalities(self, q: Array) -> Array:
        """Residuals of all equalities, in m and rad (as MuJoCo's ``efc_pos``)."""
        m, types = self.m, _numbers(self.mujoco.mjtEq)
        at = self.tree.poses(q)
        parts = []
        for k in self._active():
            data = np.array(m.eq_data[k])
            if m.eq_type[k] == types.mjEQ_JOINT:
                parts.append(self._coupling(k, q, data))
                continue
            (axes, origin), (others, other) = (self._frame(at, k, second) for second in (0, 1))
            site = m.eq_objtype[k] == int(self.mujoco.mjtObj.mjOBJ_SITE)
            if m.eq_type[k] == types.mjEQ_CONNECT:
                first, second = (np.zeros(3), np.zeros(3)) if site else (data[:3], data[3:6])
                parts.append(origin + axes @ first - other - others @ second)
                continue
            anchor, relative = (np.zeros(3), np.zeros(3)) if site else (data[:3], data[3:6])
            turn = np.eye(3) if site else _matrix(data[6:10])
            parts.append(origin + axes @ relative - other - others @ anchor)
            parts.append(data[10] * _vector_part(others.T @ axes @ turn))
        return jnp.concatenate(parts) if parts else jnp.zeros(0)

    def _frame(self, at: Any, equality: int, second: int) -> tuple[Any, Any]:
        """Axes and origin of the first or second body, or site, of an equality."""
        m = self.m
        k = int((m.eq_obj2id if second else m.eq_obj1id)[equality])
        site = m.eq_objtype[equality] == int(self.mujoco.mjtObj.mjOBJ_SITE)
        body = int(m.site_bodyid[k]) if site else k
        link = self.link_of[body]
        axes, origin = (at.axes[link], at.origins[link]) if link >= 0 else (np.eye(3), np.zeros(3))
        if not site:
            return axes, origin
        return axes @ _matrix(m.site_quat[k]), origin + axes @ np.array(m.site_pos[k])

    def _coupling(self, k: int, q: Array, data: np.ndarray) -> Array:
        """A joint that is a polynomial of another one, both from their places in qpos0."""
        m = self.m
        one, other = int(m.eq_obj1id[k]), int(m.eq_obj2id[k])
        at = m.jnt_qposadr[one]
        way = q[at] - m.qpos0[at]
        if other < 0:
            return (way - data[0])[None]
        at = m.jnt_qposadr[other]
        return (way - _polynomial(data[:5], q[at] - m.qpos0[at]))[None]

    # ---- start
    def _place(self, data: Any) -> None:
        """Find the start, rows that say something, and the number of redundant ones."""
        rng = np.random.default_rng(1)
        q, v = data.qpos.copy(), data.qvel.copy()
        for at_q, _ in self.balls:
            q[at_q : at_q + 4] /= np.linalg.norm(q[at_q : at_q + 4])
        self.redundant = 0
        if len(self.rows):
            residual, jacobian = self._linear
            shaken = [self._shaken(rng, q) for _ in range(3)]
            sizes = np.max([np.abs(jacobian(one)).max(1) for one in shaken], axis=0)
            self.rows = np.flatnonzero(sizes > 1e-10 * sizes.max())
            asked = q
            for _ in range(30):
                gap, by = np.asarray(residual(q))[self.rows], np.asarray(jacobian(q))[self.rows]
                step = -np.linalg.lstsq(by, gap, rcond=1e-10)[0]
                q = np.asarray(self.moved(jnp.asarray(q), jnp.asarray(step), turned))
                if np.abs(step).max() < 1e-15:
                    break
            every = np.asarray(residual(q))
            worst = np.abs(every).max()
            if worst > CONSISTENCY_TOLERANCE:
                raise SpecError(
                    f"{self.name}: the equalities cannot be satisfied near the start; the nearest "
                    f"position violates them by {worst:.2g}."
                )
            if (far := np.abs(q - asked).max()) > 0.1:
                raise SpecError(
                    f"{self.name}: the start violates the equalities; the nearest position that "
                    f"satisfies them is {far:.2g} away in qpos. Give a keyframe that does."
                )
            by = np.asarray(jacobian(q))[self.rows]
            v = v - np.linalg.lstsq(by, by @ v, rcond=1e-10)[0]
            self.redundant = len(self.rows) - np.linalg.matrix_rank(by, tol=1e-9)
        self.start = q, v

    @cached_property
    def _linear(self) -> tuple[Callable, Callable]:
        """Compiled equalities and their derivatives along velocities ``(nl, nv)``."""

        def along(q: Array) -> Array:
            def moved(w: Array) -> Array:
                return self.equalities(self.moved(q, w, turned))

            return jax.jacfwd(moved)(jnp.zeros(self.m.nv))

        return jax.jit(self.equalities), jax.jit(along)

    def _shaken(self, rng: np.random.Generator, q: np.ndarray) -> np.ndarray:
        w = rng.normal(size=self.m.nv)
        return np.asarray(self.moved(jnp.asarray(q), jnp.asarray(w), turned))

    @property
    def is_checked(self) -> bool:
        """Whether the numbers of this model were compared before."""
        return kept(self._place_of_start) is not None

    def keep_start(self) -> None:
        """Keep the start of a model whose numbers were compared, if the disk takes it."""
        q, v = (part.tolist() for part in self.start)
        found = {"q": q, "v": v, "rows": self.rows.tolist(), "redundant": int(self.redundant)}
        with suppress(OSError):
            keep(self._place_of_start, json.dumps(found).encode())

    # ---- oracle
    def check(self) -> None:
        """Compare with MuJoCo's own numbers at random states.

        Raises
        ------
        SpecError
            If one of them is another: the model has something that was not read.
        """
        m, mujoco, rng = self.m, self.mujoco, np.random.default_rng(2)
        ours = jax.jit(
            lambda q, v, u: (
                self.tree.mass_matrix(q) + np.diag(self.armature),
                self.passive(q, v) - self.tree.bias(q, v),
                self.actuators(q, v, u),
            )
        )
        names = "mass matrix", "forces", "forces of actuators"
        clean = self.clean()
        for _ in range(STATES):
            data = mujoco.MjData(clean)
            data.qpos[:] = self._shaken(rng, self.start[0])
            data.qvel[:] = rng.normal(size=m.nv)
            data.ctrl[:] = self.start_control
            mujoco.mj_forward(clean, data)
            theirs = np.zeros((m.nv, m.nv))
            mujoco.mj_fullM(clean, data, theirs)
            forces = data.qfrc_passive - data.qfrc_bias
            every = theirs, forces, data.qfrc_actuator
            found = ours(data.qpos.copy(), data.qvel.copy(), self.start_control)
            for name, own, given in zip(names, found, every, strict=True):
                whole = theirs if name == names[0] else np.array([forces, given])
                self._compare(name, np.asarray(own), given, max(np.abs(whole).max(), 1e-300))
            if len(self.rows):
                residual = np.asarray(self._linear[0](data.qpos.copy()))
                self._compare("equalities", residual, data.efc_pos[: len(residual)], 1.0)

    def _compare(self, name: str, ours: np.ndarray, theirs: np.ndarray, size: float) -> None:
        gap = np.abs(ours - theirs).max(initial=0.0)
        if not gap <= SAME * size:
            raise SpecError(
                f"{self.name}: MuJoCo computes other {name}; the largest difference is "
                f"{gap / size:.1e} of the largest entry. The model has something that is not read."
            )

    def clean(self) -> Any:
        """Return a copy of the model without the parts that the equations do not have."""
        m, off = copy.copy(self.m), self.mujoco.mjtDisableBit
        m.opt.disableflags |= int(off.mjDSBL_CONTACT) | int(off.mjDSBL_LIMIT)
        m.opt.disableflags |= int(off.mjDSBL_FRICTIONLOSS)
        m.opt.density = m.opt.viscosity = 0.0
        for values in (m.jnt_springyield, m.tendon_stiffness, m.tendon_damping):
            values[:] = 0.0
        if "ball_springs" in self.lacking:
            wide = np.isin(m.jnt_type, [0, 1])
            m.jnt_stiffness[wide] = 0.0
            m.jnt_stiffnesspoly[wide] = 0.0
        if "actuators" in self.lacking:
            m.opt.disableflags |= int(off.mjDSBL_ACTUATION)
        with suppress(AttributeError):
            m.opt.jacobian = int(self.mujoco.mjtJacobian.mjJAC_DENSE)
        return m


def _numbers(enumeration: Any) -> Any:
    """The members of an enumeration of MuJoCo as integers, which arrays have."""
    members = enumeration.__members__.items()
    return SimpleNamespace(**{name: int(member) for name, member in members})


def _matrix(quaternion: np.ndarray) -> np.ndarray:
    """The rotation matrix of a quaternion."""
    p = np.array(quaternion) / np.linalg.norm(quaternion)
    across = np.array([[0.0, -p[3], p[2]], [p[3], 0.0, -p[1]], [-p[2], p[1], 0.0]])
    return np.eye(3) + 2 * across @ (p[0] * np.eye(3) + across)


def _polynomial(coefficients: np.ndarray, x: Array) -> Any:
    """c0 + c1 x + c2 x^2 ... of coefficients in the last axis."""
    value = coefficients[..., -1]
    for k in range(coefficients.shape[-1] - 2, -1, -1):
        value = value * x + coefficients[..., k]
    return value


def _vector_part(turn: Array) -> Array:
    """The vector part of the quaternion of a rotation matrix of less than half a turn."""
    scalar = jnp.sqrt(jnp.maximum(1.0 + jnp.trace(turn), 1e-30)) / 2
    skew = jnp.stack([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    return skew / (4 * scalar)
