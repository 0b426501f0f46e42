"""Records of scenes: descriptions, pictures, and numbers that tell how stiff and how sensitive."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from bench.plugins.fingerprint import fingerprint
from bench.plugins.registry import why
from bench.results.records import Digits, Rows, SceneRecord
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
    """Make the record of a scene; one without a reference has the reason, and no pictures.

    A part of which the scene gives a false answer is left out, and the record says so.

    Parameters
    ----------
    scene, t_end
        The scene, up to t_end in s.
    reference
        Gives its reference; not called if ``lacking`` says why there is none.
    """
    faults: list[str] = []

    def part(name: str, make: Callable[[], Any], otherwise: Any) -> Any:
        try:
            return make()
        except BaseException as error:  # the scene may be a plugin
            faults.append(f"Its {name} is left out: {why(error)}")
            return otherwise

    known: dict[str, Any] = {"reference_method": lacking or "No reference is known."}
    if not lacking:
        known |= part("reference", lambda: _motion(scene, reference()), {})
    if known.get("reference", Rows(t=[])).t:
        known |= {
            "drawings": part("picture", lambda: frames(scene, reference()), []),
            "rates": part("spectrum", lambda: rates(scene, reference()), None),
            "growth": part("sensitivity", lambda: growth(scene, reference()), None),
        }
    nameless = {"title": scene.name, "description": "", "parameters": []}
    known |= part("description", lambda: checks.description(scene), nameless)
    if scene.has("energy"):
        part("energy", lambda: first_energy(scene), None)
    tags = part("list of tags", lambda: checks.texts(scene.tags, "tags"), ())
    if part("rank of the constraints", lambda: _missing_rank(scene), 0):
        tags = dict.fromkeys((*tags, "redundant"))
    hard = part(
        "list of difficulties", lambda: checks.texts(scene.difficulties, "difficulties"), ()
    )
    return SceneRecord(
        problem=scene.spec,
        t_end=t_end,
        source=part("source", lambda: checks.text(scene.source, "source"), ""),
        components=part("list of components", lambda: _components(scene), {}),
        sizes=recorded_sizes(scene),
        t0=scene.interval[0],
        fingerprint=fingerprint(type(scene)),
        tags=list(tags),
        difficulties=list(hard),
        equations=equations(scene),
        faults=faults,
        **known,
    )


def _motion(scene: MechatronicSystem, reference: Reference) -> dict[str, Any]:
    """Fields of the record on the reference."""
    if reference.missing:
        return {"reference_method": reference.missing}
    t = np.linspace(scene.interval[0], reference.t_end, 301)
    return {
        "reference_method": reference.method,
        "reference_error": relative_reference_error(reference),
        "reference": measure.stored_rows({"t": t} | reference(t)),
        "published": _published(reference),
    }


def _published(reference: Reference) -> list[Digits]:
    """Return the published digits up to the end of the reference, beside its values."""
    scene, t_end = reference.scene, reference.t_end
    t = np.array([p.t for p in checks.published(scene.published) if p.t <= t_end])
    return measure.digits(scene, t, reference(t)) if len(t) else []


def _missing_rank(scene: MechatronicSystem) -> int:
    return missing_rank(scene, np.asarray(scene.start().q), scene.interval[0])


def first_energy(scene: MechatronicSystem) -> float:
    """Return the energy of a scene at its start, in J."""
    q, v, _ = map(jnp.asarray, scene.start())
    return checks.number(scene.energy(q, v), "energy()")


def recorded_sizes(scene: MechatronicSystem) -> dict[str, int]:
    """Return the numbers of unknowns; of velocities only where it is one of its own, and of held
    values only where there are any."""
    left_out = {"nh"} if scene.has("kinematics") else {"nh", "nv"}
    left_out |= set() if scene.sizes.nd else {"nd"}
    return {name: n for name, n in scene.sizes._asdict().items() if name not in left_out}


def _components(scene: MechatronicSystem) -> dict[str, list[str]]:
    return {g: [c.text for c in scene.components(g)[: measure.MOST_COMPONENTS]] for g in GROUPS}


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
