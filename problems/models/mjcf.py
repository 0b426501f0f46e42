"""Scenes from files of MuJoCo (MJCF) and URDF: a model that `mujoco` has compiled, as equations.

MuJoCo reads the file and fills arrays; q is its qpos, v its qvel. Its own C is the oracle: each
model is compared at random states when it is loaded. Todorov, Erez & Tassa (2012),
doi:10.1109/IROS.2012.6386109.
"""

from __future__ import annotations

import copy
import dataclasses
import hashlib
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from problems.base.runtime import Array, Float, jnp
from problems.base.spec import SpecError, convert, is_name, one_of, suggest
from problems.mechanics.drawing import OBLIQUE
from problems.mechanics.rotations import quaternion_rate, turned
from problems.models.mjcf_load import Start, checked_start, read, reset
from problems.models.mjcf_model import Model
from problems.models.mjcf_parts import called, lacking, load_mujoco, numbers
from problems.system import MechatronicSystem
from problems.variables import Component, State, parameter

#: What a parameter says of a part that the equations do not have.
CHOICES = REFUSED, LEFT_OUT = "refused", "left_out"


class MujocoScene(MechatronicSystem):
    """Base of scenes from MuJoCo's models; see `from_mjcf`.

    A soft equality of MuJoCo is a rigid constraint here.
    """

    dear_tangents = True
    offered = ("at_keyframe", "in_mujoco", "variant")
    model: ClassVar[Model]
    at_start: ClassVar[Start]
    #: Names of the parameters that are controls, and the parts that are refused, or left out.
    controls: ClassVar[tuple[str, ...]]
    lacking: ClassVar[dict[str, str]]
    #: Makes the class that starts at another keyframe, with its controls.
    at_keyframe: ClassVar[Callable[[str], type[MujocoScene]]]

    @classmethod
    def variant(cls, options: Mapping[str, object]) -> type[MujocoScene]:
        """Return the class of a scene with these options: that of the keyframe, if one is named."""
        own = getattr(cls, "keyframe", None)
        if own is None or str(options.get("keyframe", own)) == own:
            return cls
        other = cls.at_keyframe(str(options["keyframe"]))
        other.__module__ = cls.__module__
        return other

    def __post_init__(self) -> None:
        own = getattr(type(self), "keyframe", None)
        if (other := getattr(self, "keyframe", None)) != own:
            raise SpecError(
                f"{self.name} is made for the keyframe {own!r}; from_mjcf(..., keyframe={other!r}) "
                f"makes the other one."
            )
        if left := [key for key in self.lacking if getattr(self, key) != LEFT_OUT]:
            parts = ", and ".join(self.lacking[key] for key in left)
            options = [f"{key}={LEFT_OUT}" for key in self.lacking]
            raise SpecError(
                f"{self.name}: the model has {parts}; a scene cannot state this. "
                f"--set {' --set '.join(options)} leaves it out ({self.name}[{','.join(options)}])."
            )

    # ---- blocks
    def mass(self, q: Array) -> Array:
        return self.model.mass_matrix(q)

    def mass_product(self, q: Array, a: Array) -> Array:
        return self.model.mass_product(q, a)

    def force(self, q: Array, v: Array, t: Array) -> Array:
        return self.model.force(q, v, jnp.array([getattr(self, name) for name in self.controls]))

    def kinematics(self, q: Array, v: Array) -> Array:
        return self.model.moved(q, v, quaternion_rate)

    def move(self, q: Array, w: Array) -> Array:
        return self.model.moved(q, w, turned)

    def constraint(self, q: Array, t: Array) -> Array:
        return self.model.equalities(q)[np.array(self.at_start.rows)]

    def energy(self, q: Array, v: Array) -> Array:
        return 0.5 * v @ self.mass(q) @ v + self.model.potential(q)

    def points(self, q: Array) -> dict[str, Array]:
        """Centres of mass of the bodies, by their names."""
        centres, links = self.model.centres(q), self.model.link
        return {called(self.model.m, "BODY", k): centres[n] for k, n in enumerate(links) if k}

    # ---- the same model in MuJoCo
    def in_mujoco(self) -> tuple[Any, Float[np.ndarray, " nu"]]:
        """Return a copy of MuJoCo's model without what is left out, and the controls."""
        controls = np.array([getattr(self, name) for name in self.controls])
        return copy.copy(self.model.engine), controls

    # ---- start and picture
    def initial_state(self) -> State:
        return State(np.array(self.at_start.q), np.array(self.at_start.v))

    def draw(self, q: np.ndarray) -> list[np.ndarray]:
        """Lines between the origins of neighbouring bodies, and to the centres of the last."""
        tree = self.model
        origins = np.asarray(tree.poses(jnp.asarray(q)).origins)
        centres, lines = np.asarray(tree.centres(jnp.asarray(q))), []
        for k, parent in enumerate(tree.parent):
            lines.append([origins[parent] if parent >= 0 else np.zeros(3), origins[k]])
            if k not in tree.parent and tree.mass[k]:
                lines.append([origins[k], centres[k]])
        return [np.asarray(line) @ OBLIQUE for line in lines]


def from_mjcf(
    file: str | Path,
    *,
    name: str | None = None,
    interval: tuple[float, float] = (0.0, 2.0),
    nominal_step: float | None = None,
    defaults: Mapping[str, Any] | None = None,
    keyframe: str | None = None,
    meshes: str | Path | None = None,
    start: Mapping[str, float | Sequence[float]] | None = None,
) -> type[MechatronicSystem]:
    """Return the scene class of a model of MuJoCo or a URDF.

    The start is a keyframe, else qpos0 at rest; controls are those of the keyframe, else zero, and
    parameters of the scene. Positions that violate an equality by little, as numbers of
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
    defaults
        Defaults of parameters of the scene, such as ``{"contacts": "left_out"}``.
    keyframe
        Name of the keyframe at which it starts, or its number if it has none; by default the first.
    meshes
        Folder in which meshes that give a body its mass are looked for, too.
    start
        Values at the start in place of those, in m, rad, m/s and rad/s: of a joint by its name, of
        its velocities by "name.v", of all by "qpos" and "qvel", such as ``{"hip": 0.3}``. The
        others follow from the equalities.

    Raises
    ------
    SpecError
        If MuJoCo does not take the file, the model has something that cannot be left out, its start
        violates the equalities, MuJoCo computes other numbers, or a default is none.
    """
    settings, path = {**locals()}, Path(file)
    if name is None:  # letters, digits and "_"
        name = re.sub(r"\W+", "_", path.stem, flags=re.ASCII).strip("_")
        name = name if name[:1].isalpha() else f"model_{name}".rstrip("_")
    cls = "".join(part[:1].upper() + part[1:] for part in name.split("_"))
    if not (is_name(name) and cls.isidentifier()):
        raise SpecError(f"{name!r} is no name of a scene, such as 'robot'; give another one.")
    m, notes = read(path, Path(meshes) if meshes else None)
    try:
        data = np.empty(load_mujoco().mj_sizeModel(m), dtype=np.uint8)
        load_mujoco().mj_saveModel(m, None, data)
        digest = hashlib.sha256(data.tobytes()).hexdigest()  # of all numbers
        keys = [called(m, "KEY", k).removeprefix("key ") for k in range(m.nkey)]
        if keyframe is not None:
            one_of(keyframe, keys, "keyframe")
        at_key = keys.index(keyframe or keys[0]) if keys else None
        for body in np.flatnonzero(m.body_mocapid >= 0) if keys else ():  # moved by hand
            k = m.body_mocapid[body]
            m.body_pos[body] = m.key_mpos[at_key].reshape(-1, 3)[k]
            m.body_quat[body] = m.key_mquat[at_key].reshape(-1, 4)[k]
        left_out, model = lacking(m), Model(m)
        at_start, is_new = checked_start(model, digest, at_key)
    except SpecError as error:
        raise SpecError(f"{name}: {error}") from None
    if following := [row for k, row in enumerate(model.rows) if k not in at_start.rows]:
        names = ", ".join(following)
        notes.append(f"Equations of equalities are left out that follow from others ({names}).")
    caller = sys._getframe(1).f_globals.get("__name__", __name__)
    if is_new and not caller.startswith("problems."):  # every process loads it; one tells
        for note in notes:
            print(f"{name}: {note}", file=sys.stderr)
    fields: dict[str, Any] = {
        key: parameter(REFUSED, "", f"{part}: {LEFT_OUT} leaves this out", choices=CHOICES)
        for key, part in left_out.items()
    }
    own = [called(m, "ACTUATOR", k).removeprefix("actuator ") for k in range(m.nactuator)]
    own = np.repeat(own, m.actuator_ctrlnum)
    controls = ["control_" + re.sub(r"\W", "_", name) for name in own]
    if len({*controls}) < len(controls):
        controls = [f"control_{k}" for k in range(m.nu)]
    for k, value in enumerate(reset(m, at_key).ctrl):
        fields[controls[k]] = parameter(float(value), "1", f"control of actuator {k}")
    for key, value in (defaults or {}).items():
        if key not in fields:
            raise SpecError(f"{name} has no parameter {key!r}; {suggest(key, fields)}.")
        fields[key].name = key
        fields[key].default = convert(name, fields[key], value)
    if keys:
        text = "keyframe at which it starts"
        fields["keyframe"] = parameter(
            keys[at_key or 0], "", text, choices=keys, always=keyframe is not None
        )
    coordinates = _names(m, "[rad]", "[m]", [f"p{i}" for i in range(4)])
    rates = _names(m, "[rad/s]", "[m/s]", [f"Omega {i} [rad/s]" for i in (1, 2, 3)])
    given = _given(start or {}, coordinates, rates)
    fields["given"] = dataclasses.field(default=given, kw_only=True, repr=False)
    absent = {
        "kinematics": not model.balls,
        "move": not model.balls,
        "constraint": not at_start.rows,
        "energy": model.dissipates,
    }
    made = dataclasses.make_dataclass(
        cls,
        [(key, field.metadata.get("type", tuple), field) for key, field in fields.items()],
        bases=(MujocoScene,),
        frozen=True,
        namespace={
            "__doc__": f"A model of MuJoCo: {m.nbody - 1} bodies, {m.njnt} joints, "
            f"{m.nactuator} actuators, {len(at_start.rows)} constraints."
            + "".join(f"\n\n{note}" for note in notes),
            "name": name,
            "model": model,
            "at_start": at_start,
            "at_keyframe": staticmethod(
                cache(lambda key: from_mjcf(**settings | {"name": name, "keyframe": key}))
            ),
            "controls": tuple(controls),
            "lacking": left_out,
            "interval": interval,
            "nominal_step": 5 * m.opt.timestep if nominal_step is None else nominal_step,
            "coordinates": coordinates,
            "velocities": rates if model.balls else (),
            "multipliers": tuple(model.rows[row] for row in at_start.rows),
            "redundant": at_start.redundant,
            "tags": ("multibody", *(["constrained", "index 3"] if at_start.rows else [])),
            "source": f"model of {path.name}",
            "source_text": digest,  # decides its fingerprint
            **{block: None for block, is_absent in absent.items() if is_absent},
        },
    )
    # As `collections.namedtuple`; newer Pythons have set that of the call above.
    made.__module__ = caller
    return made


def _given(
    start: Mapping[str, float | Sequence[float]], coordinates: Sequence[str], rates: Sequence[str]
) -> tuple[tuple[str, float], ...]:
    """Values at the start by names of single coordinates and velocities."""
    found: dict[str, float] = {}
    for key, value in start.items():
        joint, end = key.removesuffix(".v"), ".v" if key.endswith(".v") or key == "qvel" else ""
        names = [Component.read(text).name for text in (rates if end else coordinates)]
        if key not in ("qpos", "qvel"):
            names = [n for n in names if n == joint or n.startswith(f"{joint} ")] or [joint]
        values = np.atleast_1d(np.asarray(value, dtype=float))
        if values.shape != (len(names),):
            raise SpecError(f"start[{key!r}] has {values.size} values; give {len(names)}.")
        found |= {f"{n}{end}": float(v) for n, v in zip(names, values, strict=True)}
    return tuple(sorted(found.items()))


def _names(m: Any, angle: str, way: str, turning: list[str]) -> tuple[str, ...]:
    """Names of the coordinates or velocities of joints: units of angles and ways, and the names of
    the entries of a rotation."""
    parts = {
        "HINGE": [angle],
        "SLIDE": [way],
        "BALL": turning,
        "FREE": [*(f"{letter} {way}" for letter in "xyz"), *turning],
    }
    kinds = {number: parts[kind] for kind, number in vars(numbers("mjtJoint")).items()}
    each = enumerate(m.jnt_type)
    return tuple(f"{called(m, 'JOINT', k)} {part}" for k, kind in each for part in kinds[kind])
