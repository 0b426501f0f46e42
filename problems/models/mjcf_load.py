"""Loading of models from files: reading, a consistent start, and a comparison with MuJoCo's C."""

from __future__ import annotations

import hashlib
import json
import os
import re
import tempfile
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from problems.base.cache import cached
from problems.base.runtime import CACHE, FEW_CALLS, Array, Float, jax, jnp
from problems.base.spec import SpecError
from problems.base.text import said
from problems.mechanics.rotations import turned
from problems.models.mjcf_model import Model
from problems.models.mjcf_parts import load_mujoco
from problems.starts import CONSISTENCY_TOLERANCE, closed, shortest

#: Largest difference from MuJoCo's numbers, relative to the largest of them, and the number of
#: random states at which they are compared.
SAME, STATES = 1e-11, 4
#: Largest change of a coordinate, in m or rad, by which a start is moved onto the equalities.
FAR = 0.1


class Start(NamedTuple):
    """A consistent start: q ``(nq,)``, v ``(nv,)``, numbers of the equations that say something,
    how many of these depend on the others, and `Model.in_bodies`."""

    q: list[float]
    v: list[float]
    rows: list[int]
    redundant: int
    in_bodies: bool


def checked_start(model: Model, digest: str, keyframe: int | None) -> tuple[Start, bool]:
    """Return the start of a model whose numbers are those of MuJoCo, and whether it is new.

    What was compared is kept, by the ``digest`` of the model, the number of the keyframe, the
    versions and these sources.

    Raises
    ------
    SpecError
        If no start near that of the model satisfies the equalities, or MuJoCo computes other
        numbers.
    """
    sources = (f.read_text("utf-8") for f in sorted(Path(__file__).parent.glob("*.py")))
    parts = digest, str(keyframe), load_mujoco().__version__, *sources
    place = CACHE / "models" / hashlib.sha256("\n".join(parts).encode()).hexdigest()[:32]
    made: list[Start] = []

    def make() -> bytes:
        data = reset(model.m, keyframe)
        compare(model, data.qpos, data.ctrl)
        made.append(_start(model, data))
        if made[0].redundant:
            model.in_bodies = True
            made.append(_start(model, data))
        return json.dumps(min(made, key=lambda start: start.redundant)).encode()

    start = Start(*json.loads(cached(place, make)))
    model.in_bodies = start.in_bodies
    return start, bool(made)


def reset(m: Any, keyframe: int | None) -> Any:
    """Return MuJoCo's data of a model at a keyframe, else at qpos0 at rest."""
    data = load_mujoco().MjData(m)
    if keyframe is not None:
        load_mujoco().mj_resetDataKeyframe(m, data, keyframe)
    return data


def _start(model: Model, data: Any) -> Start:
    """The start of the model, moved to the nearest place that satisfies its equalities."""
    q, v, rows = data.qpos.copy(), data.qvel.copy(), np.arange(len(model.rows))
    for at_q, _ in model.balls:
        q[at_q : at_q + 4] /= np.linalg.norm(q[at_q : at_q + 4])
    if not len(rows):
        return Start(q.tolist(), v.tolist(), [], 0, model.in_bodies)

    def shifted(q: Array, w: Array) -> Array:
        return model.moved(jnp.asarray(q), jnp.asarray(w), turned)

    def along(q: Array) -> Array:
        return jax.jacfwd(lambda w: model.equalities(shifted(q, w)))(jnp.zeros(len(v)))

    once, rng = partial(jax.jit, compiler_options=FEW_CALLS), np.random.default_rng(1)
    residual, jacobian, near = once(model.equalities), once(along), once(shifted)

    def nearest(q: Any) -> np.ndarray:
        """The nearest place that satisfies the equalities."""
        return closed(
            lambda q: (np.asarray(residual(q))[rows], np.asarray(jacobian(q))[rows]), near, q
        )

    # A combination that moves with nothing, as a plane loop across its plane, says nothing.
    rows = _independent([jacobian(near(q, rng.normal(size=len(v)))) for _ in range(3)])
    first, q = q, nearest(q)
    worst, far = np.abs(residual(q)).max(), np.abs(q - first).max()
    if worst > CONSISTENCY_TOLERANCE or far > FAR:
        raise SpecError(
            f"The start violates the equalities; the nearest position found is {far:.2g} away in "
            f"qpos and violates them by {worst:.2g} (m or rad). Give a keyframe that does not."
        )
    by = np.asarray(jacobian(q))[rows]
    if np.linalg.matrix_rank(by, tol=1e-9) < len(rows):
        # Some combinations, as of two ties that are a hinge, say nothing where all are closed.
        free = np.eye(len(v)) - np.linalg.pinv(by, rcond=1e-9) @ by
        others = [nearest(near(q, 0.3 * free @ rng.normal(size=len(v)))) for _ in range(4)]
        others = [p for p in others if np.abs(residual(p)).max() < CONSISTENCY_TOLERANCE]
        rows = rows[_independent([np.asarray(jacobian(p))[rows] for p in [q, *others]])]
        by = np.asarray(jacobian(q))[rows]
    v = v - shortest(by, by @ v)
    redundant = len(rows) - int(np.linalg.matrix_rank(by, tol=1e-9))
    return Start(q.tolist(), v.tolist(), rows.tolist(), redundant, model.in_bodies)


def _independent(jacobians: list[Any]) -> np.ndarray:
    """Rows of which no combination vanishes in all Jacobians, which hold for the others, too."""
    left, sizes, _ = np.linalg.svd(np.hstack(jacobians))
    none = left[:, int(np.sum(sizes > 1e-9 * sizes[0])) :]
    # Of each combination a row goes that is large in it: the first such one, whatever rounding is.
    share, rows = none @ none.T, np.arange(len(left))
    for _ in range(none.shape[1]):
        large = share.diagonal()
        k = int(np.argmax(large > 0.9 * large.max()))
        share = share - np.outer(share[:, k], share[k]) / share[k, k]
        rows = rows[rows != k]
    return rows


def compare(model: Model, q: Float[np.ndarray, " nq"], control: Float[np.ndarray, " nu"]) -> None:
    """Compare with MuJoCo's own numbers at random states around q and a control.

    Raises
    ------
    SpecError
        If one of them is another: the model has something that was not read.
    """
    m, mujoco, rng = model.engine, load_mujoco(), np.random.default_rng(2)

    @partial(jax.jit, compiler_options=FEW_CALLS)
    def ours(q: Array, v: Array, control: Array) -> tuple[Array, ...]:
        own = model.mass_matrix(q), model.mass_product(q, v), model.force(q, v, control)
        return *own, model.equalities(q)

    for _ in range(STATES):
        data, mass = mujoco.MjData(m), np.zeros((m.nv, m.nv))
        data.qpos[:], data.qvel[:] = q, rng.normal(size=m.nv)
        mujoco.mj_integratePos(m, data.qpos, rng.normal(size=m.nv), 1.0)
        data.ctrl[:] = control + rng.normal(size=m.nu)
        mujoco.mj_forward(m, data)
        mujoco.mj_fullM(m, data, mass)
        parts = [data.qfrc_passive, data.qfrc_actuator, data.qfrc_bias]
        forces = data.qfrc_passive + data.qfrc_actuator - data.qfrc_bias
        # Where no force acts, as on a turntable, rounding is measured by that of M a.
        most = np.abs(mass).max()
        theirs = {
            "mass matrix": (mass, most),
            "products of it": (mass @ data.qvel, most),
            "forces": (forces, max(np.abs(parts).max(), most)),
            "equalities": (data.efc_pos, 1.0),
        }
        found = ours(data.qpos.copy(), data.qvel.copy(), data.ctrl.copy())
        for own, (name, (given, size)) in zip(map(np.asarray, found), theirs.items(), strict=True):
            same = own.shape == given.shape
            gap = np.abs(own - given).max(initial=0.0) / size if same else np.inf
            if not gap <= SAME:
                raise SpecError(
                    f"MuJoCo computes other {name}; the largest difference is {gap:.1e} of the "
                    f"largest entry. The model has something that is not read."
                )


# ---- reading --------------------------------------------------------------------------


def read(path: Path, meshes: Path | None = None) -> tuple[Any, list[str]]:
    """Return the compiled model of a file, and the warnings of MuJoCo.

    Meshes that show and touch, and textures, move nothing: they are not read, and may be lost, as
    behind ``package://``. A mesh that gives a body its mass is.

    Raises
    ------
    SpecError
        If MuJoCo does not take the file.
    """
    notes: list[str] = []
    try:
        with _remarks(notes):
            spec = load_mujoco().MjSpec.from_file(str(path))
            _leave_looks_out(spec, path, meshes)
            return spec.compile(), notes
    except SpecError:
        raise
    except (ValueError, RuntimeError, OSError) as error:
        raise SpecError(f"MuJoCo cannot read {path}: {said(error)}") from None


@contextmanager
def _remarks(notes: list[str]) -> Iterator[None]:
    """Note the warnings of MuJoCo once: those to a callback, to Python, or on C's error stream."""
    mujoco, found, stream = load_mujoco(), [], os.dup(2)
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(found.append)
    told = warnings.catch_warnings(record=True, action="always")
    with told as others, tempfile.TemporaryFile() as written:
        os.dup2(written.fileno(), 2)
        try:
            yield
        finally:
            os.dup2(stream, 2)
            os.close(stream)
            mujoco.set_mju_user_warning(before)
            written.seek(0)
            found += [str(other.message) for other in others]
            found += filter(None, written.read().decode(errors="replace").splitlines())
            texts = (" ".join(text.split()).removeprefix("WARNING: ") for text in found)
            notes += dict.fromkeys(f"MuJoCo warns: {text.rstrip('.')}." for text in texts)


def _leave_looks_out(spec: Any, path: Path, root: Path | None) -> None:
    """Put a ball without mass, which may touch, in the place of a mesh that weighs nothing; look
    for the others in the root, too."""
    mujoco = load_mujoco()
    always = spec.compiler.inertiafromgeom == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE

    def weighs(geom: Any) -> bool:
        stated = geom.parent.explicitinertial and not always
        # The links of a URDF state their masses, or have none.
        return not (stated or path.suffix == ".urdf" or geom.parent == spec.worldbody)

    for mesh in [*spec.meshes]:
        geoms = [geom for geom in spec.geoms if geom.meshname == mesh.name]
        if any(map(weighs, geoms)):
            if mesh.file:
                mesh.file = _found(mesh.file, path.parent / spec.meshdir, root)
            continue
        for geom in geoms:
            geom.meshname, geom.mass = "", 0.0
            geom.type, geom.size = mujoco.mjtGeom.mjGEOM_SPHERE, [0.01, 0.0, 0.0]
        spec.delete(mesh)
    for texture in spec.textures:
        texture.file, texture.builtin = "", mujoco.mjtBuiltin.mjBUILTIN_FLAT
        texture.width = texture.height = 1


def _found(file: str, folder: Path, root: Path | None) -> str:
    """The name of a mesh that lies in its folder, or in the root: ``package://robot/arm.stl`` as
    robot/arm.stl or arm.stl."""
    parts = Path(re.sub(r"^\w+://", "", file)).parts
    places = [root.resolve().joinpath(*parts[k:]) for k in range(len(parts))] if root else []
    for place in (folder / file, *places):
        if place.is_file():
            return file if place == folder / file else str(place)
    raise SpecError(
        f"The mesh {file} is not there, which gives a body its mass; put it there, or name its "
        f"folder: stepbench new problem NAME --from FILE --meshes FOLDER."
    )
