"""Start of a model of MuJoCo, and a comparison of its equations with MuJoCo's own numbers."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from problems.initial_values import CONSISTENCY_TOLERANCE
from problems.models.mjcf_model import Model
from problems.models.mjcf_objects import load_mujoco
from problems.models.mjcf_parts import without
from problems.rotations import turned
from problems.runtime import CACHE, FEW_CALLS, Array, Float, jax, jnp
from problems.spec import SpecError
from problems.whole_files import keep, kept

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
    sources = sorted(Path(__file__).parent.glob("*.py"))
    parts = [
        digest,
        str(keyframe),
        load_mujoco().__version__,
        *(file.read_text("utf-8") for file in sources),
    ]
    place = CACHE / "models" / hashlib.sha256("\n".join(parts).encode()).hexdigest()[:32]
    if (known := kept(place)) is not None:
        start = Start(*json.loads(known))
        model.in_bodies = start.in_bodies
        return start, False
    start = _start(model, keyframe)
    if start.redundant:
        model.in_bodies = True
        start = min(start, _start(model, keyframe), key=lambda start: start.redundant)
        model.in_bodies = start.in_bodies
    compare(model, np.array(start.q))
    with suppress(OSError):
        keep(place, json.dumps(start).encode())
    return start, True


def reset(m: Any, keyframe: int | None) -> Any:
    """Return MuJoCo's data of a model at a keyframe, else at qpos0 at rest."""
    mujoco = load_mujoco()
    data = mujoco.MjData(m)
    if keyframe is not None:
        mujoco.mj_resetDataKeyframe(m, data, keyframe)
    return data


def _start(model: Model, keyframe: int | None) -> Start:
    """The start of the model, moved to the nearest place that satisfies its equalities."""
    data, rng = reset(model.m, keyframe), np.random.default_rng(1)
    q, v, rows, redundant = data.qpos.copy(), data.qvel.copy(), np.arange(len(model.rows)), 0
    for at_q, _ in model.balls:
        q[at_q : at_q + 4] /= np.linalg.norm(q[at_q : at_q + 4])
    if len(rows):
        residual, jacobian = _linear(model)

        def moved(q: np.ndarray, w: np.ndarray) -> np.ndarray:
            return np.asarray(model.moved(jnp.asarray(q), jnp.asarray(w), turned))

        def closed(q: np.ndarray) -> np.ndarray:
            """The nearest place that satisfies the equalities, by Newton's method."""
            for _ in range(30):
                gap, by = np.asarray(residual(q))[rows], np.asarray(jacobian(q))[rows]
                step = -np.linalg.lstsq(by, gap, rcond=1e-10)[0]
                q = moved(q, step)
                if np.abs(step).max() < 1e-15:
                    break
            return q

        # A combination that moves with nothing, as a plane loop across its plane, says nothing.
        rows = _independent([jacobian(moved(q, rng.normal(size=len(v)))) for _ in range(3)])
        asked, q = q, closed(q)
        worst, far = np.abs(residual(q)).max(), np.abs(q - asked).max()
        if worst > CONSISTENCY_TOLERANCE:
            raise SpecError(
                f"The equalities cannot be satisfied near the start; the nearest position violates "
                f"them by {worst:.2g} (m or rad)."
            )
        if far > FAR:
            raise SpecError(
                f"The start violates the equalities; the nearest position that satisfies them is "
                f"{far:.2g} away in qpos (m or rad). Give a keyframe that does."
            )
        by = np.asarray(jacobian(q))[rows]
        if np.linalg.matrix_rank(by, tol=1e-9) < len(rows):
            # Some combinations, as of two ties that are a hinge, say nothing where all are closed.
            free = np.eye(len(v)) - np.linalg.pinv(by, rcond=1e-9) @ by
            near = [closed(moved(q, 0.3 * free @ rng.normal(size=len(v)))) for _ in range(4)]
            near = [p for p in near if np.abs(residual(p)).max() < CONSISTENCY_TOLERANCE]
            rows = rows[_independent([np.asarray(jacobian(p))[rows] for p in [q, *near]])]
            by = np.asarray(jacobian(q))[rows]
        v = v - np.linalg.lstsq(by, by @ v, rcond=1e-10)[0]
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


def _linear(model: Model) -> tuple[Callable, Callable]:
    """Compiled equalities, and their derivatives along velocities ``(nl, nv)``."""

    def along(q: Array) -> Array:
        def moved(w: Array) -> Array:
            return model.equalities(model.moved(q, w, turned))

        return jax.jacfwd(moved)(jnp.zeros(model.m.nv))

    once = partial(jax.jit, compiler_options=FEW_CALLS)
    return once(model.equalities), once(along)


def compare(model: Model, q: Float[np.ndarray, " nq"]) -> None:
    """Compare with MuJoCo's own numbers at random states around q.

    Raises
    ------
    SpecError
        If one of them is another: the model has something that was not read.
    """
    m, mujoco, rng = without(model.m), load_mujoco(), np.random.default_rng(2)
    stated = reset(m, 0 if m.nkey else None).ctrl.copy()

    @partial(jax.jit, compiler_options=FEW_CALLS)
    def ours(q: Array, v: Array, control: Array) -> dict[str, Array]:
        return {
            "mass matrix": model.mass(q),
            "products of it": model.mass_product(q, v),
            "forces": model.passive(q, v) + model.actuators(q, v, control) - model.tree.bias(q, v),
            "equalities": model.equalities(q, in_space=True),
        }

    for _ in range(STATES):
        data, mass = mujoco.MjData(m), np.zeros((m.nv, m.nv))
        data.qpos[:], data.qvel[:] = q, rng.normal(size=m.nv)
        mujoco.mj_integratePos(m, data.qpos, rng.normal(size=m.nv), 1.0)
        data.ctrl[:] = stated + rng.normal(size=m.nu)
        mujoco.mj_forward(m, data)
        mujoco.mj_fullM(m, data, mass)
        forces = data.qfrc_passive + data.qfrc_actuator - data.qfrc_bias
        parts = [data.qfrc_passive, data.qfrc_actuator, data.qfrc_bias]
        theirs = {
            "mass matrix": (mass, np.abs(mass).max()),
            "products of it": (mass @ data.qvel, np.abs(mass).max()),
            "forces": (forces, max(np.abs(parts).max(), 1e-300)),
            "equalities": (data.efc_pos, 1.0),
        }
        found = ours(data.qpos.copy(), data.qvel.copy(), data.ctrl.copy())
        for name, (given, size) in theirs.items():
            own = np.asarray(found[name])
            if own.shape != given.shape:
                raise SpecError(
                    f"MuJoCo has {len(given)} equations of constraints where {len(own)} were read. "
                    f"The model has something that is not read."
                )
            gap = np.abs(own - given).max(initial=0.0)
            if not gap <= SAME * size:
                raise SpecError(
                    f"MuJoCo computes other {name}; the largest difference is {gap / size:.1e} of "
                    f"the largest entry. The model has something that is not read."
                )
