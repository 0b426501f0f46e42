"""Scenes from files of MuJoCo (MJCF) and URDF: a model that `mujoco` has compiled, as equations.

MuJoCo reads the file and fills arrays; q is its qpos, v its qvel. Its own C is the oracle: each
model is compared at random states when it is loaded. Todorov, Erez & Tassa (2012),
doi:10.1109/IROS.2012.6386109.
"""

from __future__ import annotations

import dataclasses
import hashlib
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from problems.models.mjcf_check import Start, checked_start, reset
from problems.models.mjcf_model import Model
from problems.models.mjcf_objects import (
    called,
    control_names,
    coordinate_names,
    load_mujoco,
    velocity_names,
)
from problems.models.mjcf_parts import lacking, without
from problems.models.mjcf_read import read
from problems.rotations import quaternion_rate, turned
from problems.runtime import Array, Float, jnp
from problems.spec import SpecError, convert, is_name, one_of, suggest
from problems.system import MechatronicSystem
from problems.variables import Component, State, parameter

#: What a parameter says of a part that the equations do not have.
REFUSED, LEFT_OUT = "refused", "left_out"
#: Oblique view: y to the right, z up, x towards the lower left.
_VIEW = np.array([[-0.4, 1.0, 0.0], [-0.4, 0.0, 1.0]])


class MujocoScene(MechatronicSystem):
    """Base of scenes from MuJoCo's models; see `from_mjcf`.

    M, bias, springs, dampers, armatures, gravity, actuators of constant control and equality
    constraints are MuJoCo's. A soft equality of MuJoCo is a rigid constraint here.
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
        if (asked := getattr(self, "keyframe", None)) != own:
            raise SpecError(
                f"{self.name} is made for the keyframe {own!r}; from_mjcf(..., keyframe={asked!r}) "
                f"makes the other one."
            )
        if left := [key for key in self.lacking if getattr(self, key) != LEFT_OUT]:
            parts = ", and ".join(self.lacking[key] for key in left)
            options = ",".join(f"{key}={LEFT_OUT}" for key in self.lacking)
            raise SpecError(
                f"{self.name}: the model has {parts}; a scene cannot state this. "
                f"{self.name}[{options}] leaves it out."
            )

    # ---- blocks
    def mass(self, q: Array) -> Array:
        return self.model.mass(q)

    def mass_product(self, q: Array, a: Array) -> Array:
        return self.model.mass_product(q, a)

    def force(self, q: Array, v: Array, t: Array) -> Array:
        model = self.model
        control = jnp.array([getattr(self, name) for name in self.controls])
        return model.passive(q, v) + model.actuators(q, v, control) - model.tree.bias(q, v)

    def kinematics(self, q: Array, v: Array) -> Array:
        return self.model.moved(q, v, quaternion_rate)

    def move(self, q: Array, w: Array) -> Array:
        return self.model.moved(q, w, turned)

    def constraint(self, q: Array, t: Array) -> Array:
        return self.model.equalities(q)[np.array(self.at_start.rows)]

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
        return without(self.model.m), np.array([getattr(self, name) for name in self.controls])

    # ---- start and picture
    def initial_state(self) -> State:
        return State(np.array(self.at_start.q), np.array(self.at_start.v))

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
    meshes: str | Path | None = None,
    defaults: Mapping[str, Any] | None = None,
    keyframe: str | None = None,
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
    meshes
        Folder in which meshes are looked for, too. One that is not there is left out, unless it
        gives a body its mass.
    defaults
        Defaults of parameters of the scene, such as ``{"contacts": "left_out"}``.
    keyframe
        Name of the keyframe at which it starts, or its number if it has none; by default the first.
    start
        Values at the start in place of those, in m, rad, m/s and rad/s: of the qpos of a joint by
        its name, of its qvel by "name.v", of all by "qpos" and "qvel". The others follow from the
        equalities.

    Raises
    ------
    SpecError
        If MuJoCo does not take the file, the model has something that cannot be left out, its start
        violates the equalities, MuJoCo computes other numbers, or a default is none.
    """
    path = Path(file)
    name = scene_name(path) if name is None else name
    cls = "".join(part[:1].upper() + part[1:] for part in name.split("_"))
    if not (is_name(name) and cls.isidentifier()):
        raise SpecError(f"{name!r} is no name of a scene, such as 'robot'; give another one.")
    compiled, notes = read(path, None if meshes is None else Path(meshes))
    try:
        left_out, model = lacking(compiled), Model(compiled)
        digest = _digest(compiled)
        keys = [called(compiled, "KEY", k).removeprefix("key ") for k in range(compiled.nkey)]
        if keyframe is not None:
            one_of(keyframe, keys, "keyframe")
        at_key = (keys.index(keyframe) if keyframe else 0) if keys else None
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
    controls, values = control_names(compiled), reset(compiled, at_key).ctrl
    fields: list[Any] = [(key, str, _choice(part)) for key, part in left_out.items()]
    for k, control in enumerate(controls):
        told = parameter(float(values[k]), "1", f"control of actuator {k}")
        fields.append((control, float, told))
    named = {key: field for key, _, field in fields}
    for key, value in (defaults or {}).items():
        if key not in named:
            raise SpecError(f"{name} has no parameter {key!r}; {suggest(key, named)}.")
        named[key].name = key
        named[key].default = convert(name, named[key], value)
    if keys:
        meta = {"type": str, "doc": "keyframe at which it starts", "choices": tuple(keys)}
        meta |= {"unit": "", "always": keyframe is not None}
        fields.append(
            ("keyframe", str, dataclasses.field(default=keys[at_key or 0], metadata=meta))
        )
    names = coordinate_names(compiled), velocity_names(compiled) if model.balls else ()
    given = dataclasses.field(default=_given(start or {}, *names), kw_only=True, repr=False)
    fields.append(("given", tuple, given))
    absent = {
        "kinematics": not model.balls,
        "move": not model.balls,
        "constraint": not at_start.rows,
        "energy": model.dissipates,
    }
    made = dataclasses.make_dataclass(
        cls,
        fields,
        bases=(MujocoScene,),
        frozen=True,
        namespace={
            "__doc__": f"A model of MuJoCo: {compiled.nbody - 1} bodies, {compiled.njnt} joints, "
            f"{compiled.nactuator} actuators, {len(at_start.rows)} constraints."
            + "".join(f"\n\n{note}" for note in notes),
            "name": name,
            "model": model,
            "at_start": at_start,
            "at_keyframe": staticmethod(
                cache(
                    lambda key: from_mjcf(
                        path,
                        name=name,
                        interval=interval,
                        nominal_step=nominal_step,
                        meshes=meshes,
                        defaults=defaults,
                        keyframe=key,
                        start=start,
                    )
                )
            ),
            "controls": controls,
            "lacking": left_out,
            "interval": interval,
            "nominal_step": 5 * compiled.opt.timestep if nominal_step is None else nominal_step,
            "coordinates": names[0],
            "velocities": names[1],
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


def scene_name(path: Path) -> str:
    """Return the name of a scene that is made of a file: letters, digits and '_'."""
    word = re.sub(r"\W+", "_", path.stem, flags=re.ASCII).strip("_")
    return word if word[:1].isalpha() else f"model_{word}".rstrip("_")


def _given(
    start: Mapping[str, float | Sequence[float]], coordinates: Sequence[str], own: Sequence[str]
) -> tuple[tuple[str, float], ...]:
    """Values at the start by names of single coordinates and velocities."""
    found: dict[str, float] = {}
    for key, value in start.items():
        joint, end = key.removesuffix(".v"), ".v" if key.endswith(".v") or key == "qvel" else ""
        texts = (own or coordinates) if end else coordinates
        names = [Component.read(text).name for text in texts]
        if key not in ("qpos", "qvel"):
            names = [n for n in names if n == joint or n.startswith(f"{joint} ")] or [joint]
        values = np.atleast_1d(np.asarray(value, dtype=float))
        if values.shape != (len(names),):
            raise SpecError(f"start[{key!r}] has {values.size} values; give {len(names)}.")
        found |= {f"{n}{end}": float(v) for n, v in zip(names, values, strict=True)}
    return tuple(sorted(found.items()))


def _digest(m: Any) -> str:
    """A digest of all numbers of a model."""
    numbers = np.empty(load_mujoco().mj_sizeModel(m), dtype=np.uint8)
    load_mujoco().mj_saveModel(m, None, numbers)
    return hashlib.sha256(numbers.tobytes()).hexdigest()


def _choice(part: str) -> Any:
    """A parameter that is `REFUSED` or `LEFT_OUT`."""
    doc = f"{part}: {LEFT_OUT} leaves this out"
    meta = {"type": str, "unit": "", "doc": doc, "choices": (REFUSED, LEFT_OUT)}
    return dataclasses.field(default=REFUSED, metadata=meta)
