"""Records of scenes: descriptions, pictures, and numbers that tell how stiff and how sensitive."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from bench.plugins.fingerprint import fingerprint
from bench.plugins.registry import why
from bench.results.records import SceneRecord
from bench.running import measure
from bench.running.errors import relative_reference_error
from bench.running.linearisation import growth, rates
from problems.base import checks
from problems.base.runtime import jnp
from problems.equations.initial_values import missing_rank
from problems.system import MechatronicSystem
from problems.truth.reference import Reference
from problems.variables import GROUPS

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
    left_out = {
        "nh",
        *([] if scene.has("kinematics") else ["nv"]),
        *([] if sizes["nd"] else ["nd"]),
    }
    record = SceneRecord(
        problem=scene.spec,
        t_end=t_end,
        sizes={name: n for name, n in sizes.items() if name not in left_out},
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
    return [motion, *(text for block, text in _BLOCKS.items() if scene.has(block))]


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
