"""Reference solutions: a closed form where the scene has one, else a tight integration.

The integration is Gauss' method of order 24 (`problems.collocation`) on the ODE form at a tolerance
near round-off; no integrator of the bench is of this family, or of such an order. Its error is
estimated by another integration: by the Radau IIA method of order 23, with other steps. A reference
that is kept for later runs, with its error, is made by one process at a time.
"""

from __future__ import annotations

import io
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np

from problems import answers
from problems.collocation import Motion, TooSmallStep, gauss, integrate, radau
from problems.compiled import compiled
from problems.initial_values import consistent_start
from problems.layouts import state_layout
from problems.runtime import Float
from problems.system import MechatronicSystem
from problems.variables import GROUPS
from problems.whole_files import keep, kept

_TOLERANCE = 3e-14
#: Longest steps of the two integrations, in nominal steps: no event lasts so short that it falls
#: between two of the twelve nodes.
_LONGEST = 4, 3
#: Accelerations of a scene at rest, between these in size, are the rounding of forces in balance.
_BALANCED = 1e-16, 1e-9
#: A scene with more coordinates and multipliers has no reference: each of its many evaluations is
#: a dense solve.
_MOST_UNKNOWNS = 300
#: Time in s for which a process waits for another one that makes the same reference.
PATIENCE = 100.0


_file_of: Callable[[MechatronicSystem, float], Path | None] | None = None
_told: Callable[[str, MechatronicSystem], object] = lambda doing, scene: None  # noqa: E731


def keep_references(
    file_of: Callable[[MechatronicSystem, float], Path | None] | None,
    told: Callable[[str, MechatronicSystem], None],
) -> None:
    """Set how this process keeps references for later ones, and reads theirs, from now on.

    Parameters
    ----------
    file_of
        Returns the file of a scene up to a time in s, whose name tells all that decides the
        numbers, or None. Without this function nothing is kept.
    told
        Told "making" and the scene before an integration, "waiting for" before a wait for another
        process that makes the same one.
    """
    global _file_of, _told
    _file_of, _told = file_of, told


class ReferenceFailed(RuntimeError):
    """The reference could not be computed; the message says why."""


@dataclass(frozen=True)
class Reference:
    """Solution of a scene that is more accurate than any run compared with it.

    Parameters
    ----------
    scene
        The scene; the solution begins at ``scene.interval[0]``.
    t_end
        Last time in s.
    """

    scene: MechatronicSystem
    t_end: float

    @property
    def method(self) -> str:
        """Method of its computation, in words for a report."""
        if self.scene.has("exact"):
            return "closed form"
        return f"Gauss collocation of order 24, tolerance {_TOLERANCE:g}, on the explicit ODE"

    @property
    def missing(self) -> str:
        """Reason why the scene has no reference; empty if it has one."""
        sizes = self.scene.sizes
        if self.scene.has("exact") or sizes.nq + sizes.nl <= _MOST_UNKNOWNS:
            return ""
        return (
            f"No reference is made of {self.scene.spec}: it has {sizes.nq + sizes.nl} unknowns, "
            f"more than {_MOST_UNKNOWNS}."
        )

    def __call__(self, t: Float[np.ndarray, " k"]) -> dict[str, Float[np.ndarray, "k n"]]:
        """Compute the solution at times t in s.

        Returns
        -------
        dict
            q, v, a, lam, x, xdot and y, in the units of the scene.

        Raises
        ------
        ReferenceFailed
            If the scene is too large or the integration stops.
        FalseAnswer
            If the closed form lacks groups, or is not finite.
        """
        t = np.asarray(t, dtype=float)
        if self.scene.has("exact"):
            return self._closed_form(t)
        return self._evaluate(self._known.motion, t)

    @property
    def times(self) -> Float[np.ndarray, " k"]:
        """500 to 4000 equally spaced times in s."""
        t0 = self.scene.interval[0]
        count = np.clip(4 * (self.t_end - t0) / self.scene.nominal_step, 500, 4000)
        return np.linspace(t0, self.t_end, int(count))

    @property
    def error(self) -> dict[str, Float[np.ndarray, " n"]]:
        """Estimated absolute error of each component by group: the largest over time, in its unit.

        For a closed form it is the change under one unit of rounding of the time and of every
        value, for an integration the difference between the two integrations. It is taken at 500
        or more equally spaced times, and at the ends of the integration's own steps.
        """
        return self._known.error

    @property
    def largest(self) -> dict[str, tuple[Float[np.ndarray, " n"], float]]:
        """By group, the largest absolute value of each component, and the largest Euclidean norm.

        They are taken at the same times, in the units of the scene.
        """
        return {g: (self._known.sizes[g], float(self._known.norms[g])) for g in GROUPS}

    @cached_property
    def _known(self) -> _Known:
        if self.scene.has("exact"):
            t = self.times
            return _known(self._closed_form(t), self._closed_form(np.nextafter(t, np.inf)))
        path = _file_of(self.scene, self.t_end) if _file_of else None
        return self._integrated() if path is None else _read(path) or self._made_by_one(path)

    def _made_by_one(self, path: Path) -> _Known:
        """Make and keep it, unless another process has done so meanwhile."""
        from filelock import FileLock, Timeout  # slow to import

        lock = FileLock(path.with_name(f".{path.name}.lock"))
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            try:
                lock.acquire(timeout=0)
            except Timeout:
                _told("waiting for", self.scene)
                lock.acquire(timeout=PATIENCE)
        except (OSError, Timeout):  # there is no folder for it, or the other one takes too long
            return self._integrated()
        try:
            if (found := _read(path)) is None:
                found = self._integrated()
                with suppress(OSError):  # a full disk
                    keep(path, _written(found))
            return found
        finally:
            lock.release()

    def _integrated(self) -> _Known:
        """The integration, compared with the other one."""
        _told("making", self.scene)
        ours = self._integrate(0)
        t = np.union1d(self.times, ours.ends)
        other = self._evaluate(self._integrate(1), t)
        return _known(self._evaluate(ours, t), other)._replace(motion=ours)

    def _closed_form(self, t: np.ndarray) -> dict[str, np.ndarray]:
        sizes = {g: self.scene.sizes.of(g) for g in (*GROUPS, "xdot")}
        values = {g: np.zeros((len(t), 0)) for g in ("x", "xdot", "y", "lam")}
        return values | answers.closed_form(self.scene.exact(t), len(t), sizes)

    def _evaluate(self, motion: Motion, t: np.ndarray) -> dict[str, np.ndarray]:
        q, v, x = state_layout(self.scene.sizes).split(motion(t))
        z, xdot = compiled(self.scene).complete(self.scene.parameters(), q, v, x, t)
        values = {g: np.asarray(getattr(z, g)) for g in GROUPS}
        return values | {"xdot": np.asarray(xdot)}

    def _integrate(self, which: int) -> Motion:
        if self.missing:
            raise ReferenceFailed(self.missing)
        scene, at = self.scene, state_layout(self.scene.sizes)
        start = consistent_start(scene).z
        rates, p = compiled(scene).rates, np.array(list(scene.parameters().values()))
        first = np.concatenate([start.q, start.v, start.x])
        # In equilibrium v is rounding, which is no size: no step would be small enough for it.
        low, high = _BALANCED
        still = not start.v.any() and low < np.abs(start.a).max(initial=0.0) < high
        least = np.zeros(len(first))
        least[at.v] = float(still)
        try:
            return integrate(
                lambda t, s: np.asarray(rates(p, t, s)),
                first,
                (scene.interval[0], self.t_end),
                groups=(at.q, at.v, at.x),
                method=(gauss, radau)[which](),
                tolerance=_TOLERANCE * (1 + which),
                longest=_LONGEST[which] * scene.nominal_step,
                least=least,
            )
        except TooSmallStep as error:
            raise ReferenceFailed(f"No reference for {scene.spec}: {error}.") from None


class _Known(NamedTuple):
    """An integration, its errors, sizes of components and norms by group, as it is kept."""

    motion: Motion
    error: dict[str, Float[np.ndarray, " n"]]
    sizes: dict[str, Float[np.ndarray, " n"]]
    norms: dict[str, np.ndarray]


def _known(ours: dict[str, np.ndarray], other: dict[str, np.ndarray]) -> _Known:
    eps = np.finfo(float).eps
    return _Known(
        Motion(np.zeros(0), np.zeros((0, 0, 0))),
        {g: np.max(abs(ours[g] - other[g]) + eps * abs(ours[g]), axis=0) for g in GROUPS},
        {g: np.abs(ours[g]).max(axis=0) for g in GROUPS},
        {g: np.linalg.norm(ours[g], axis=1).max() for g in GROUPS},
    )


def _written(known: _Known) -> bytes:
    named = {f"{part} {g}": getattr(known, part)[g] for part in _Known._fields[1:] for g in GROUPS}
    np.savez(content := io.BytesIO(), **known.motion._asdict(), **named)
    return content.getvalue()


def _read(path: Path) -> _Known | None:
    """The integration that a file keeps, if there is one."""
    if (content := kept(path)) is None:
        return None
    with np.load(io.BytesIO(content), allow_pickle=False) as file:
        motion = Motion(file["ends"], file["series"])
        parts = ({g: file[f"{part} {g}"] for g in GROUPS} for part in _Known._fields[1:])
        return _Known(motion, *parts)
