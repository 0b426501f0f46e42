"""Scenes of SymPy models; `derived.py` has the models, and writes the text of their equations."""

from __future__ import annotations

import numpy as np

from problems.models.examples import cart_links_text, four_bar_text


class SympyFourBar(four_bar_text.SympyFourBar):
    """A four-bar linkage by SymPy's Lagrange's method, with two constraints (`hol_coneqs`).

    Tests a closed loop in absolute angles; the motion is that of `mjcf_four_bar`. The crank goes
    round. Left out: friction in joints.
    """

    coordinates = ("crank [rad]", "coupler [rad]", "rocker [rad]")
    multipliers = ("support x [N]", "support y [N]")
    tags = ("multibody", "constrained", "index 3", "conservative", "smooth", "model")
    source = "data: docs/models.md; equations: sympy.physics.mechanics.LagrangesMethod"

    def draw(self, q: np.ndarray) -> list[np.ndarray]:
        rods = np.stack([np.cos(q), np.sin(q)], axis=1) * [[self.l1], [self.l2], [self.l3]]
        return [np.cumsum([[0.0, 0.0], *rods], axis=0)]


class SympyCartLinks(cart_links_text.SympyCartLinks):
    """SymPy's pendulum of links on a cart, by Kane's method: three links, which hang and swing.

    Tests an M(q) that couples all coordinates, without constraints. Masses are points at the ends
    of links; angles count from the upright position. Left out: a force on the cart, and friction.
    """

    coordinates = ("cart [m]", "link 1 [rad]", "link 2 [rad]", "link 3 [rad]")
    tags = ("multibody", "smooth", "model")
    source = "sympy.physics.mechanics.models.n_link_pendulum_on_cart"

    def draw(self, q: np.ndarray) -> list[np.ndarray]:
        links = np.stack([-np.sin(q[1:]), np.cos(q[1:])], axis=1)
        links *= [[self.l0], [self.l1], [self.l2]]
        cart = np.array([[q[0] - 0.2, 0.0], [q[0] + 0.2, 0.0]])
        return [cart, np.cumsum([[q[0], 0.0], *links], axis=0)]
