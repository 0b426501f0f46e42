"""Records of scenes: descriptions, pictures, and numbers that tell how stiff and how sensitive.

These numbers are of the equations linearised along the motion.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from bench.plugins.fingerprint import fingerprint
from bench.plugins.registry import why
from bench.results.records import SceneRecord
from bench.running import measure
from bench.running.errors import relative_reference_error, scales
from integrators.contract import Trajectory
from problems.base import checks
from problems.base.runtime import Float, jax, jnp
from problems.equations.compiled import MOST_STATES, compiled
from problems.equations.initial_values import missing_rank
from problems.equations.kinematics import constraint_velocity, q_rate
from problems.system import MechatronicSystem
from problems.truth.reference import Reference
from problems.variables import GROUPS, state_layout

#: Times at which a still picture shows a scene, and at which a page plays it.
GHOSTS, FRAMES = 7, 61
#: Most points of all drawings that are played; a scene with more is drawn at the still times only.
MOST_POINTS = 20_000

_BLOCKS = {
    "kinematics": "dq/dt = T(q) v",
    "constraint": "0 = Phi(q, t)",
    "velocity_constraint": "0 = A(q) v - b(t)",
    "state_rate": "xdot = f(q, v, a, lam, x, y, t)",
    "output": "y = h(q, v, a, lam, x, y, t)",
    "sample": "xd^+ = D(q, v, a, lam, x, y, t, xd)",
    "events": "e(q, v, x, t) = 0 ⇒ z^+ = J(z)",
    "gaps": "0 <= gap(q, t)",
}


def scene_record(
    scene: MechatronicSystem, t_end: float, reference: Callable[[], Reference], lacking: str = ""
) -> SceneRecord:
    """Make the record of a scene up to t_end in s; one without a reference has the reason, and no
    pictures.

    A part of which the scene gives a false answer is left out, and the record says so. The
    ``reference`` is not asked for if ``lacking`` says why there is none.
    """
    t0, sizes = scene.interval[0], scene.sizes._asdict()
    # A number of velocities or of held values is told where it is one of its own.
    told = {"nh": False, "nv": scene.has("kinematics"), "nd": sizes["nd"] > 0}
    record = SceneRecord(
        problem=scene.spec,
        t_end=t_end,
        sizes={name: n for name, n in sizes.items() if told.get(name, True)},
        t0=t0,
        title=scene.name,
        fingerprint=fingerprint(type(scene)),
        equations=equations(scene),
        reference_method=lacking or "No reference is known.",
    )

    def motion() -> dict[str, Any]:
        exact = reference()
        if exact.missing:
            return {"reference_method": exact.missing}
        t = np.linspace(t0, exact.t_end, 301)
        at = np.array([p.t for p in checks.published(scene.published) if p.t <= exact.t_end])
        return {
            "reference_method": exact.method,
            "reference_error": relative_reference_error(exact),
            "reference": measure.stored_rows({"t": t} | exact(t)),
            "published": measure.digits(scene, at, exact(at)) if len(at) else [],
        }

    def names() -> dict[str, list[str]]:
        most = measure.MOST_COMPONENTS
        return {g: [c.text for c in scene.components(g)[:most]] for g in GROUPS}

    def energy() -> dict[str, Any]:
        q, v, _ = map(jnp.asarray, scene.start())
        checks.number(scene.energy(q, v) if scene.has("energy") else 0.0, "energy()")
        return {}

    def rank() -> dict[str, Any]:
        missing = missing_rank(scene, np.asarray(scene.start().q), t0)
        return {"tags": [*dict.fromkeys([*record.tags, *["redundant"] * bool(missing)])]}

    def part(name: str, make: Callable[[], dict[str, Any]]) -> None:
        try:
            for field, value in make().items():
                setattr(record, field, value)
        except BaseException as error:  # the scene may be a plugin
            record.faults.append(f"Its {name} is left out: {why(error)}")

    def texts(field: str) -> dict[str, list[str]]:
        return {field: list(checks.texts(getattr(scene, field), field))}

    if not lacking:
        part("reference", motion)
    if record.reference.t:
        part("picture", lambda: {"drawings": frames(scene, reference())})
        part("spectrum", lambda: {"rates": rates(scene, reference())})
        part("sensitivity", lambda: {"growth": growth(scene, reference())})
    part("description", lambda: checks.description(scene))
    part("energy", energy)
    part("list of tags", lambda: texts("tags"))
    part("rank of the constraints", rank)
    part("list of difficulties", lambda: texts("difficulties"))
    part("source", lambda: {"source": checks.text(scene.source, "source")})
    part("list of components", lambda: {"components": names()})
    return record


def equations(scene: MechatronicSystem) -> list[str]:
    """Return the equations that a scene has, in the symbols of the contract."""
    motion = "M(q) a = g(q, v, t)"
    of_q = "(Phi_q T)^T" if scene.has("kinematics") else "Phi_q^T"
    motion += f" - {of_q} lam" if scene.has("constraint") else ""
    motion += " - A^T lam" if scene.has("velocity_constraint") else ""
    motion += " + L y" if scene.has("output") else ""
    motion += " + g_c(q, v, lam, x, y, t)" if scene.has("coupled_force") else ""
    found = [motion, *(text for block, text in _BLOCKS.items() if scene.has(block))]
    return [text.replace("lam, ", "lam, " * (scene.sizes.nl > 0)) for text in found]


def frames(scene: MechatronicSystem, reference: Reference) -> list[dict[str, Any]]:
    """Draw a scene often enough to play it, or, if its drawings are large, as a still picture."""
    still = drawings(scene, reference, GHOSTS)
    points = sum(len(line) for drawing in still for line in drawing["lines"])
    if not points or points / GHOSTS * FRAMES > MOST_POINTS:
        return still
    return drawings(scene, reference, FRAMES)


def drawings(scene: MechatronicSystem, reference: Reference, count: int) -> list[dict[str, Any]]:
    """Draw a scene at ``count`` equally spaced times of its reference.

    Each is ``{"t": s, "lines": [[[x, y], ...], ...]}`` in m; there is none if the scene has
    no drawing.
    """
    if not scene.has("draw"):
        return []
    t = np.linspace(scene.interval[0], reference.t_end, count)
    return [
        {"t": float(now), "lines": checks.drawing(scene.draw(q))}
        for now, q in zip(t, reference(t)["q"], strict=True)
    ]


# ---- linearised equations ----------------------------------------------------------------
#: Times at which eigenvalues are taken, and nodes of a block of linearised steps.
_SPECTRA = 60
#: Times at which a run is asked for its fastest vibration, if the scene has no more states than
#: this: every run pays for it.
_TIMES, _MOST_OF_RUNS = 5, 100
#: A vibration that weighs less than so many times as much in a as in v is a part of the motion.
_WEIGHT = 20.0
#: The part of a that is left to a vibration, from which on a is not controlled.
_LEFT = 0.05
#: The fewest linearised steps, a multiple of a block's, and the most times the cube of the states.
_FEWEST, _MOST_WORK = 480, 4e8
#: Two numbers of steps tell the growth if they agree up to this part.
_AGREE = 0.1
#: Gauss' method of order four: nodes, and weights up to them.
_NODES = 0.5 + np.array([-1.0, 1.0]) / np.sqrt(12)
_UP_TO = np.array([[0.25, _NODES[0] - 0.25], [_NODES[1] - 0.25, 0.25]])


def rates(scene: MechatronicSystem, reference: Reference) -> dict[str, float] | None:
    """Compute rates in 1/s from the eigenvalues of the ODE form along the motion.

    ``fastest`` and ``slowest`` are the largest modulus and the smallest one that is not rounding;
    ``decay`` and ``oscillation`` the fastest of both. A large ratio of the fastest and the slowest
    rate, or of the fastest and one over the interval, is stiffness. None if the scene is too large
    or the Jacobian is not finite.
    """
    sizes = scene.sizes
    if state_layout(sizes).size > MOST_STATES:
        return None
    t = np.linspace(scene.interval[0], reference.t_end, _SPECTRA)
    jacobians = _jacobians(scene, t, _states(reference, t))
    if not np.isfinite(jacobians).all():
        return None
    values = np.linalg.eigvals(jacobians).ravel()
    size = np.abs(values)
    # A constrained ODE form has zeros of multiplicity two; rounding makes roots of them.
    real = size[size > 1e-5 * max(1.0, size.max())]
    return {
        "fastest": float(size.max()),
        "slowest": float(real.min(initial=size.max())),
        "decay": float(max(0.0, -values.real.min())),
        "oscillation": float(np.abs(values.imag).max()),
    }


def uncontrolled(scene: MechatronicSystem, run: Trajectory, rtol: float | None) -> str:
    """Say that a run does not control its accelerations; nothing where it does or nobody knows.

    A vibration at omega is omega times as large in a as in v; relative to the largest values, ::

        weight = omega max|v| / max|dv/dt|

    which is near 1 if the motion itself vibrates at omega; sizes of a that the scene states bound
    the denominator. Errors of ``rtol`` in v in each of its N periods, until it has died out, are
    weight N rtol in a. Constant steps (``rtol`` None) of more than half a period leave any part.
    """
    t, v = run.t, run.v
    if state_layout(scene.sizes).size > _MOST_OF_RUNS or len(t) < 2:
        return ""
    places = np.searchsorted(t, np.linspace(t[0], t[-1], 2 * _TIMES + 1)[1::2])
    states = np.concatenate([run.q, run.v, run.x], axis=1)
    jacobians = _jacobians(scene, t[places], states[places])
    if not np.isfinite(jacobians).all():
        return ""
    fastest = [max(e, key=lambda e: e.imag) for e in np.linalg.eigvals(jacobians)]
    decay, omega = -np.median(np.real(fastest)), float(np.median(np.imag(fastest)))
    stated = [component.scale for component in scene.components("a") if component.scale]
    change = np.linalg.norm(np.diff(v, axis=0), axis=1) / np.diff(t)
    weight = omega * np.linalg.norm(v, axis=1).max() / min([change.max() or np.inf, *stated])
    length = t[-1] - t[0]
    h = float(np.median(np.diff(t)[places - 1])) * (len(t) - 1) / (run.work.steps or len(t) - 1)
    periods = omega / (2 * np.pi) * np.array([length / max(1.0, decay * length), h])
    left = float(2 * periods[1] > 1) if rtol is None else rtol * periods[0]
    if weight < _WEIGHT or weight * left < _LEFT:
        return ""
    helps = (
        "q and v are usable; take a smaller rtol" if rtol else "and so is v if the start excites it"
    )
    helps += "" if rtol else "; q is usable; take smaller steps"
    return (
        f"Accelerations are not controlled: a step spans {periods[1]:.2g} periods of the fastest "
        f"vibration, {omega:.3g} rad/s. a is unreliable, {helps} for a."
    )


def growth(scene: MechatronicSystem, reference: Reference) -> float | None:
    """Compute by how much a small change of the start can grow: the condition of the scene.

    The change of s = (q, v, x) that the constraints admit is followed by the equations linearised
    along the motion, each component relative to the size that divides its errors (`errors.scales`).
    Returned is its largest Euclidean norm over the interval, of all changes whose norm at the start
    is 1. None if the scene is too large, its motion too fast for linearised steps, its Jacobian not
    finite, or values jump.
    """
    at = state_layout(scene.sizes)
    if at.size > MOST_STATES or scene.is_hybrid:
        return None
    size = np.concatenate([scales(reference, group).components for group in ("q", "v", "x")])
    start = _admitted(scene, _states(reference, np.array([scene.interval[0]]))[0], size)
    steps, last = _FEWEST, np.inf
    while steps * at.size**3 <= _MOST_WORK:
        found = _largest(scene, reference, start, size, steps)
        if not np.isfinite(found):
            break
        if abs(found - last) <= _AGREE * found:
            return found
        steps, last = 2 * steps, found
    return None


def _jacobians(
    scene: MechatronicSystem, t: Float[np.ndarray, " k"], states: Float[np.ndarray, "k n"]
) -> Float[np.ndarray, "k n n"]:
    """Jacobians of the ODE form, by the program that consistent starts have compiled."""
    p, split = scene.parameters(), state_layout(scene.sizes).split
    rows = zip(t.tolist(), states, strict=True)  # times of one type, for one program
    found = (compiled(scene).linearised(p, *split(s), t) for t, s in rows)
    return np.array([jacobian for _, jacobian in found])


def _states(reference: Reference, t: Float[np.ndarray, " k"]) -> Float[np.ndarray, "k n"]:
    at = reference(t)
    return np.concatenate([at["q"], at["v"], at["x"]], axis=1)


def _admitted(
    scene: MechatronicSystem, s: Float[np.ndarray, " n"], size: Float[np.ndarray, " n"]
) -> Float[np.ndarray, "n m"]:
    """An orthonormal basis of the relative changes that constraints and kinematics admit at the
    start."""
    at, admitted = state_layout(scene.sizes), np.eye(len(s))
    if scene.has("kinematics"):  # coordinates change along velocities, as quaternions of unit norm
        from scipy.linalg import block_diag, orth  # slow to import

        q, still = jnp.asarray(s[at.q]), jnp.zeros(scene.sizes.nv)
        along = np.asarray(jax.jacfwd(lambda v: q_rate(scene, q, v))(still)) / size[at.q, None]
        admitted = np.asarray(block_diag(orth(along), np.eye(len(s) - at.q.stop)))
    if not scene.sizes.nl:
        return admitted

    def levels(s: Any) -> Any:
        q, v, _ = at.split(s)
        t = jnp.asarray(scene.interval[0])
        rows = [scene.constraint(q, t)] if scene.sizes.nh else []
        return jnp.concatenate([*rows, constraint_velocity(scene, q, v, t)])

    rows = np.asarray(jax.jacfwd(levels)(jnp.asarray(s))) * size @ admitted
    _, parts, basis = np.linalg.svd(rows / np.linalg.norm(rows, axis=1, keepdims=True))
    return np.asarray(admitted @ basis[np.count_nonzero(parts > 1e-9) :].T)


def _largest(
    scene: MechatronicSystem,
    reference: Reference,
    change: Float[np.ndarray, "n m"],
    size: Float[np.ndarray, " n"],
    steps: int,
) -> float:
    """The largest norm of changes that equal steps of Gauss' method follow."""
    t, h = np.linspace(scene.interval[0], reference.t_end, steps, endpoint=False, retstep=True)
    unit, largest = np.eye(len(size)), 1.0
    for block in np.split(t, steps // (_SPECTRA // 2)):
        nodes = (block[:, None] + h * _NODES).ravel()
        jacobians = _jacobians(scene, nodes, _states(reference, nodes)) * size / size[:, None]
        if not np.isfinite(jacobians).all():
            return np.nan
        first, second = jacobians[::2], jacobians[1::2]
        (aa, ab), (ba, bb) = h * _UP_TO
        stages = np.block([[unit - aa * first, -ab * first], [-ba * second, unit - bb * second]])
        slopes = np.linalg.solve(stages, np.concatenate([first, second], axis=1))
        for slope in h / 2 * slopes.reshape(-1, 2, *unit.shape).sum(axis=1):
            change = change + slope @ change
            largest = max(largest, float(np.linalg.norm(change, 2)))
    return largest
