"""Equations of models of MuJoCo: ours, compiled by XLA, and MuJoCo's own C.

``make bench`` prints a table and writes it as JSON. Both compute M(q) a and all forces but those of
constraints, from q, v and a: ours as the residual of a time loop, one evaluation after the other in
one program; MuJoCo by ``mj_inverse`` and ``mj_fwdActuation``, of which the time of a call from
Python is taken off. Collisions and constraints are switched off there. That the forces agree is
checked, times are not; a ratio is that of the least times.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from opponents import options, written

from bench.plugins.registry import Registry
from problems import formulations
from problems.runtime import jax, jnp, use_threads
from problems.variables import Variables

SCENES = ("mjcf_four_bar", "mjcf_arm", "mjcf_quadruped")
#: Evaluations in a sample.
EVALUATIONS = 5_000
_SAME = 1e-10


def measured(name: str, rounds: int) -> dict[str, Any]:
    """Least times of an evaluation in us."""
    import mujoco

    scene: Any = Registry().problem(name)
    m, control = scene.in_mujoco()
    m.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    data, random = mujoco.MjData(m), np.random.default_rng(3)
    q, v, _ = scene.initial_state()
    v, a = random.normal(size=(2, len(v)))
    lam = jnp.zeros(scene.sizes.nl)

    def residual(q: Any, v: Any, a: Any) -> Any:
        z = Variables(q, v, a, lam, jnp.zeros(0), jnp.zeros(0), jnp.zeros(()))
        return formulations.dynamics_residual(scene, z)

    @jax.jit
    def many(*state: Any) -> Any:
        def one(_: Any, state: Any) -> Any:
            # Each evaluation waits for the one before, and nothing of it is known beforehand.
            change = 1e-12 * jnp.sum(residual(*state))
            return jax.tree.map(lambda x: x + change, state)

        return jax.lax.fori_loop(0, EVALUATIONS, one, jax.tree.map(jnp.asarray, state))

    def theirs() -> None:
        mujoco.mj_inverse(m, data)
        mujoco.mj_fwdActuation(m, data)

    data.qpos[:], data.qvel[:], data.qacc[:], data.ctrl[:] = q, v, a, control
    theirs()
    found, wanted = np.asarray(residual(q, v, a)), data.qfrc_inverse - data.qfrc_actuator
    gap = np.abs(found - wanted).max() / np.abs(wanted).max()
    if not gap <= _SAME:
        raise SystemExit(f"{name}: forces differ by {gap:.1e} of the largest.")
    jax.block_until_ready(many(q, v, a))
    times: dict[str, list[float]] = {"ours": [], "MuJoCo": [], "calls": []}
    for _ in range(rounds):
        for who, count, call in (
            ("ours", 1, lambda: jax.block_until_ready(many(q, v, a))),
            ("MuJoCo", EVALUATIONS, theirs),
            ("calls", 2 * EVALUATIONS, lambda: mujoco.mj_getTotalmass(m)),
        ):
            started = time.process_time()
            for _ in range(count):
                call()
            times[who].append((time.process_time() - started) / EVALUATIONS * 1e6)
    least = {who: min(own) for who, own in times.items()}
    own_c = least["MuJoCo"] - least["calls"]
    sizes = f"{scene.sizes.nq}, {scene.sizes.nv}"
    return {"scene": name, "nq, nv": sizes, "ours": least["ours"], "MuJoCo": own_c}


if __name__ == "__main__":
    arguments = options(__doc__, rounds=9, out="stepbench-models.json")
    use_threads(1)
    rows = [measured(name, arguments.rounds) for name in SCENES]
    table = ["Forces of a model from q, v and a; processor time in us, the least of all samples"]
    for row in rows:
        table.append(
            f"{row['scene']:16} ours {row['ours']:6.2f}   MuJoCo's C {row['MuJoCo']:6.2f}   "
            f"ratio {row['ours'] / row['MuJoCo']:5.2f}"
        )
    written(rows, "\n".join(table), arguments.out)
