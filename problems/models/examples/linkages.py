"""Scenes whose equations SymPy derives when they are first asked for; need the extra ``sympy``."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import numpy as np

from problems.base.runtime import Array
from problems.base.spec import SpecError
from problems.system import MechatronicSystem
from problems.variables import State, parameter

try:
    _SYMPY = f"SymPy {version('sympy')}"
except PackageNotFoundError:
    raise SpecError(
        'Models of SymPy need the package sympy: pip install "stepbench[sympy]".'
    ) from None


class _Derived(MechatronicSystem):
    """A scene whose blocks are those of a class that `from_sympy` makes.

    `_derived` makes it once for a scene and its subclasses: not while these are traced.
    """

    source_text = _SYMPY  # decides its fingerprint
    _derived: Any

    @classmethod
    def _from_sympy(cls, method: Any, *symbols: Any, **start: Any) -> Any:
        """The class of a model, some of whose symbols are parameters of this one."""
        from problems.models.sympy_models import from_sympy

        constants = {symbol: getattr(cls, symbol.name) for symbol in symbols}
        own = {key: getattr(cls, key) for key in ("name", "interval", "nominal_step")}
        return from_sympy(method, constants=constants, **own, **start)

    def mass(self, q: Array) -> Array:
        return self._derived().mass(self, q)

    def force(self, q: Array, v: Array, t: Array) -> Array:
        return self._derived().force(self, q, v, t)

    def initial_state(self) -> State:
        return self._derived().initial_state(self)


@dataclass(frozen=True)
class SympyFourBar(_Derived):
    """A four-bar linkage by SymPy's Lagrange's method, with two constraints (`hol_coneqs`).

    Tests a closed loop in absolute angles; the motion is that of `mjcf_four_bar`. The crank goes
    round. Left out: friction in joints.
    """

    name = "sympy_four_bar"
    interval = (0.0, 2.0)
    nominal_step = 0.01
    coordinates = ("crank [rad]", "coupler [rad]", "rocker [rad]")
    multipliers = ("support x [N]", "support y [N]")
    tags = ("multibody", "constrained", "index 3", "conservative", "smooth", "model")
    source = "data: docs/models.md; equations: sympy.physics.mechanics.LagrangesMethod"

    l1: float = parameter(1.0, "m", "length of the crank")
    l2: float = parameter(2.0, "m", "length of the coupler")
    l3: float = parameter(2.0, "m", "length of the rocker")
    rho: float = parameter(1.0, "kg/m", "mass of rods per length")
    d: float = parameter(2.5, "m", "distance of the supports")
    g: float = parameter(9.81, "m/s^2", "gravity")

    @staticmethod
    @cache
    def _derived() -> Any:
        import sympy as sm
        from sympy.physics.mechanics import LagrangesMethod, dynamicsymbols

        q, time = dynamicsymbols("q1:4"), sm.Symbol("t")
        lengths, (rho, d, g) = sm.symbols("l1:4"), sm.symbols("rho d g")
        joint, lagrangian = sm.zeros(2, 1), sm.Integer(0)
        for angle, l in zip(q, lengths, strict=True):  # noqa: E741
            rod = l * sm.Matrix([sm.cos(angle), sm.sin(angle)])
            rate = (joint + rod / 2).diff(time)
            kinetic = rho * l * (rate.dot(rate) + l**2 * angle.diff(time) ** 2 / 12) / 2
            lagrangian += kinetic - rho * l * g * (joint + rod / 2)[1]
            joint += rod
        method = LagrangesMethod(lagrangian, q, hol_coneqs=[joint[0] - d, joint[1]])
        start = {"initial": {q[0]: 1.0, q[0].diff(time): 1.0}, "guess": {q[1]: 0.3, q[2]: -1.5}}
        return SympyFourBar._from_sympy(method, *lengths, rho, d, g, **start)

    def constraint(self, q: Array, t: Array) -> Array:
        return self._derived().constraint(self, q, t)

    def energy(self, q: Array, v: Array) -> Array:
        return self._derived().energy(self, q, v)

    def draw(self, q: np.ndarray) -> list[np.ndarray]:
        rods = np.stack([np.cos(q), np.sin(q)], axis=1) * [[self.l1], [self.l2], [self.l3]]
        return [np.cumsum([[0.0, 0.0], *rods], axis=0)]


@dataclass(frozen=True)
class SympyCartLinks(_Derived):
    """SymPy's pendulum of links on a cart, by Kane's method: three links, which hang and swing.

    Tests an M(q) that couples all coordinates, without constraints. Masses are points at the ends
    of links; angles count from the upright position. Left out: a force on the cart, and friction.
    """

    name = "sympy_cart_links"
    interval = (0.0, 2.0)
    nominal_step = 0.01
    coordinates = ("cart [m]", "link 1 [rad]", "link 2 [rad]", "link 3 [rad]")
    tags = ("multibody", "smooth", "model")
    source = "sympy.physics.mechanics.models.n_link_pendulum_on_cart"

    m0: float = parameter(1.0, "kg", "mass of the cart")
    m1: float = parameter(1.0, "kg", "mass at the end of link 1")
    m2: float = parameter(1.0, "kg", "mass at the end of link 2")
    m3: float = parameter(1.0, "kg", "mass at the end of link 3")
    l0: float = parameter(0.5, "m", "length of link 1")
    l1: float = parameter(0.5, "m", "length of link 2")
    l2: float = parameter(0.5, "m", "length of link 3")
    g: float = parameter(9.81, "m/s^2", "gravity")

    @staticmethod
    @cache
    def _derived() -> Any:
        import sympy as sm
        from sympy.physics.mechanics.models import n_link_pendulum_on_cart

        kane: Any = n_link_pendulum_on_cart(3, cart_force=False)
        start = dict(zip(kane.q[1:], (2.2, 2.6, 3.0), strict=True)) | {kane.u[0]: 0.5}
        return SympyCartLinks._from_sympy(kane, *sm.symbols("m:4 l:3 g"), initial=start)

    def draw(self, q: np.ndarray) -> list[np.ndarray]:
        links = np.stack([-np.sin(q[1:]), np.cos(q[1:])], axis=1)
        links *= [[self.l0], [self.l1], [self.l2]]
        cart = np.array([[q[0] - 0.2, 0.0], [q[0] + 0.2, 0.0]])
        return [cart, np.cumsum([[q[0], 0.0], *links], axis=0)]
