"""Shapes of which pictures of scenes are made: polylines ``(points, 2)`` in m."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

#: Oblique view of points in space, from the right: y to the right, z up, x towards the lower left.
OBLIQUE = np.array([[-0.4, -0.4], [1.0, 0.0], [0.0, 1.0]])


def rectangle(left: float, right: float, low: float, high: float) -> np.ndarray:
    """A closed rectangle."""
    return np.array([[left, low], [right, low], [right, high], [left, high], [left, low]])


def box(x: float, half: float) -> np.ndarray:
    """A square around (x, 0) with sides of twice ``half``."""
    return rectangle(x - half, x + half, -half, half)


def placed(points: ArrayLike, angle: float, at: ArrayLike = (0.0, 0.0)) -> np.ndarray:
    """Points turned about the origin by an angle in rad, then moved by ``at``."""
    cos, sin = np.cos(angle), np.sin(angle)
    return np.asarray(points) @ np.array([[cos, sin], [-sin, cos]]) + at


def circle(centre: np.ndarray, radius: float, sides: int = 24) -> np.ndarray:
    """A circle, as a polygon."""
    angle = np.linspace(0, 2 * np.pi, sides + 1)
    return radius * np.column_stack([np.cos(angle), np.sin(angle)]) + centre


def spring(start: float, end: float, reach: float, points: int = 20) -> np.ndarray:
    """A zigzag along the x axis that goes ``reach`` to both sides."""
    across = np.where(np.arange(points) % 2, reach, -reach)
    across[[0, -1]] = 0.0
    return np.column_stack([np.linspace(start, end, points), across])
