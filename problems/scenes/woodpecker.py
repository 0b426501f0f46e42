"""The woodpecker toy: impacts, jamming by friction, and release, over and over."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from problems import MechatronicSystem, State, Variables, held, jax, jnp, parameter
from problems.hybrid.contact import impact
from problems.mechanics import drawing

#: Distance in m by which a gap has to close again once it has opened, and velocity in m/s by which
#: sliding has to turn round: more than rounding.
_OPENED, _TURNED = 1e-15, 1e-13
#: Part of the largest friction that is less than it, in spite of rounding.
_HELD = 1 - 1e-9
#: Numbers of the events at which the sleeve's contact ends, and at which it no longer sticks; the
#: first three are those of the gaps.
_RELEASE, _LOOSE = 3, 5


@dataclass(frozen=True)
class Woodpecker(MechatronicSystem):
    """A woodpecker on a sleeve with play, which slides down a pole by its weight.

    The sleeve jams by friction when it tilts, below (gap 2) and above (gap 3). Between it falls,
    and the beak strikes the pole (gap 1) before the sleeve jams above. The mass matrix is constant
    and the equations are linear between events. Tests impacts and contact that lasts, slides and
    sticks; contacts that are closed in an impact, as of sleeve and beak, take part in it together.
    Forces of the sleeve's contact are in ``force`` where held values say so; `moreau_jean` finds
    them by ``gaps`` and ``sliding``. Left out: angles that are not small, and tangential
    restitution.
    """

    interval = (0.0, 0.3)
    nominal_step = 1e-3
    tags = ("events", "impact", "friction")
    difficulties = (
        "contact begins, slides, sticks and ends at times that the motion decides",
        "in free flight the angles vibrate at 73 Hz, and phases of some 1 ms lie between events",
    )
    coordinates = ("height [m]", "angle of the sleeve [rad]", "angle of the woodpecker [rad]")
    source = "Glocker (1995); Leine, van Campen & Glocker (2003), doi:10.1177/1077546303009001741"

    m_sleeve: float = parameter(3e-4, "kg", "mass of the sleeve", low=0.0)
    j_sleeve: float = parameter(5e-9, "kg m^2", "moment of inertia of the sleeve", low=1e-15)
    m_bird: float = parameter(4.5e-3, "kg", "mass of the woodpecker", low=1e-9)
    j_bird: float = parameter(7e-7, "kg m^2", "moment of inertia of the woodpecker", low=1e-15)
    c: float = parameter(5.6e-3, "N m/rad", "stiffness of the spring between them", low=0.0)
    g: float = parameter(9.81, "m/s^2", "gravity")
    r_pole: float = parameter(2.5e-3, "m", "radius of the pole", low=0.0)
    r_sleeve: float = parameter(3.1e-3, "m", "inner radius of the sleeve", low=0.0)
    h_sleeve: float = parameter(5.8e-3, "m", "half the height of the sleeve", low=1e-9)
    l_sleeve: float = parameter(0.010, "m", "distance of the spring from the sleeve's centre")
    l_bird: float = parameter(0.015, "m", "distance of the woodpecker's centre from the spring")
    h_beak: float = parameter(0.020, "m", "height of the beak above the woodpecker's centre")
    l_beak: float = parameter(0.0201, "m", "distance of the beak from the woodpecker's centre")
    e_beak: float = parameter(0.5, "1", "restitution of the beak", low=0.0, high=1.0)
    friction: float = parameter(0.3, "1", "Coulomb's coefficient", low=0.0)
    side: float = held(0.0, "1", "1 or 2: the sleeve touches below or above; 0: it is free")
    slides: float = held(
        0.0, "1", "1 or -1: the sleeve's contact slides up or down; 0: it sticks; 2: it has ended"
    )

    @property
    def restitution(self) -> Any:  # pyright: ignore[reportIncompatibleVariableOverride]
        return self.e_beak * np.array([1.0, 0.0, 0.0])

    def mass(self, q: jax.Array) -> jax.Array:
        m, at, far = self.m_bird, self.l_sleeve, self.l_bird
        return jnp.array(
            [
                [m + self.m_sleeve, m * at, m * far],
                [m * at, self.j_sleeve + m * at**2, m * at * far],
                [m * far, m * at * far, self.j_bird + m * far**2],
            ]
        )

    def gaps(self, q: jax.Array, t: jax.Array) -> jax.Array:
        play, tilt = self._play(), self.h_sleeve * q[1]
        beak = self.l_sleeve + self.l_bird - self.l_beak - self.r_pole - self.h_beak * q[2]
        return jnp.stack([beak, play + tilt, play - tilt])

    def sliding(self, q: jax.Array, v: jax.Array, t: jax.Array) -> jax.Array:
        beak = v[0] + self.l_sleeve * v[1] + (self.l_bird - self.l_beak) * v[2]
        sleeve = v[0] + self.r_sleeve * v[1]
        return jnp.stack([beak, sleeve, sleeve])

    def force(self, q: jax.Array, v: jax.Array, t: jax.Array) -> jax.Array:
        n, r = self._contact(q)
        return self._weight_and_spring(q) + n * r[0] + self._tangent() * r[1]

    def _weight_and_spring(self, q: jax.Array) -> jax.Array:
        m, twist = self.m_bird * self.g, self.c * (q[1] - q[2])
        down = m + self.m_sleeve * self.g
        return jnp.stack([-down, -twist - m * self.l_sleeve, twist - m * self.l_bird])

    def _play(self) -> float:
        return self.r_sleeve - self.r_pole

    def _tangent(self) -> jax.Array:
        return jnp.stack([1.0, self.r_sleeve, 0.0])

    def _contact(self, q: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Direction of the normal of the sleeve's contact, and its normal and tangential force."""
        n = jnp.stack([0.0, jnp.where(self.side == 2, -1.0, 1.0) * self.h_sleeve, 0.0])
        r0, r1, r2 = self.mass(q)  # LAPACK would take longer than all the rest
        inverse = jnp.stack([jnp.cross(r1, r2), jnp.cross(r2, r0), jnp.cross(r0, r1)])
        both = jnp.stack([n, self._tangent()])
        moved = both @ inverse / (r0 @ inverse[0])
        a, (u, w) = moved @ both.T, moved @ self._weight_and_spring(q)
        sticking = jnp.stack([a[0, 1] * w - a[1, 1] * u, a[0, 1] * u - a[0, 0] * w])
        sticking = sticking / (a[0, 0] * a[1, 1] - a[0, 1] ** 2)
        normal = -u / (a[0, 0] - self.slides * self.friction * a[0, 1])
        sliding = jnp.stack([normal, -self.slides * self.friction * normal])
        return n, jnp.where(self.side == 0, 0.0, jnp.where(self.slides == 0, sticking, sliding))

    def events(self, z: Variables) -> jax.Array:
        beak, *sleeve = self.gaps(z.q, z.t)
        opened = jnp.where(self.slides == 2, _OPENED, 0.0)
        gaps = [jnp.where(self.side == k, 1.0, g + opened) for k, g in enumerate(sleeve, 1)]
        touches, slides = self.side > 0, self.slides != 0
        normal, tangential = self._contact(z.q)[1]
        slip = self.slides * self.sliding(z.q, z.v, z.t)[1]
        return jnp.stack(
            [
                beak,
                *gaps,
                jnp.where(touches, normal, 1.0),
                jnp.where(touches & slides, slip + _TURNED, 1.0),
                jnp.where(touches & ~slides, self.friction * normal - jnp.abs(tangential), 1.0),
            ]
        )

    def jump(self, z: Variables, event: int) -> dict[str, Any]:
        q, v, side, slides = z.q, z.v, jnp.asarray(self.side), jnp.zeros(())
        if event < _RELEASE:
            side = jnp.asarray(float(event)) if event else side
            closed = jnp.stack([jnp.asarray(event == 0), side == 1, side == 2])
            v, p = impact(self, z, closed)
            normal, tangential = p[1] + p[2], p[4] + p[5]
            side = side if event else jnp.where(normal > 0, side, 0.0)
            held_back = jnp.abs(tangential) < _HELD * self.friction * normal
            slides = jnp.where(held_back, 0.0, jnp.sign(self.sliding(q, v, z.t)[1]))
        elif event > _RELEASE:
            v = v.at[0].set(0.0)
        touches = side > 0  # rounding is taken from what vanishes
        tilt = self._play() / self.h_sleeve * jnp.where(side == 2, 1.0, -1.0)
        q = q.at[1].set(jnp.where(touches, tilt, q[1]))
        v = v.at[1].set(jnp.where(touches, 0.0, v[1]))
        # Where it does not slide, it sticks if friction can hold it.
        there = self.with_parameters({"side": side, "slides": 0.0})
        normal, tangential = there._contact(z.q)[1]
        holds = (jnp.abs(tangential) <= self.friction * normal) & (event != _LOOSE)
        begins = jnp.where(holds, 0.0, -jnp.sign(tangential))
        slides = jnp.where(slides == 0, begins, slides)
        now = self.with_parameters({"side": side, "slides": slides})
        ends = (side == 0) | (event == _RELEASE) | (now._contact(q)[1][0] <= 0)
        return {
            "q": q,
            "v": v,
            "side": jnp.where(ends, 0.0, side),
            "slides": jnp.where(ends, 2.0, slides),
        }

    def initial_state(self) -> State:
        tilt = -self._play() / self.h_sleeve * (1 + 1e-15)  # it touches, in spite of rounding
        return State(q=np.array([0.0, tilt, -0.2788]), v=np.array([-0.3411, 0.0, -7.4583]))

    def draw(self, q: np.ndarray) -> list[np.ndarray]:
        y, tilt, lean = q
        r, half = self.r_sleeve, self.h_sleeve
        pole = [np.array([[x, -0.12], [x, 0.05]]) for x in (-self.r_pole, self.r_pole)]
        sleeve = drawing.placed(drawing.rectangle(-r, r, -half, half), tilt, [0, y])
        hinge = drawing.placed([[r, 0], [self.l_sleeve, 0]], tilt, [0, y])
        beak = [self.l_bird - self.l_beak, self.h_beak]
        tail = [self.l_bird + 0.006, -0.03]
        bird = [[0, 0], [self.l_bird, 0], [self.l_bird, 0.02], beak, tail]
        return [*pole, sleeve, hinge, drawing.placed(bird, lean, hinge[1])]
