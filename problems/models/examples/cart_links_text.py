# Written by `python -m problems.models.examples.derived`, SymPy 1.14.0.
"""The scene sympy_cart_links, written by `problems.from_sympy`."""

from dataclasses import dataclass

from problems import MechatronicSystem, jnp, parameter
from problems.models.starts import completed


@dataclass(frozen=True)
class SympyCartLinks(MechatronicSystem):
    'A SymPy model (KanesMethod); coordinates: q0 = q0, q1 = q1, q2 = q2, q3 = q3'

    name = 'sympy_cart_links'
    interval = (0.0, 2.0)
    nominal_step = 0.01
    coordinates = ('q0 [m]', 'q1 [rad]', 'q2 [rad]', 'q3 [rad]')
    tags = ('multibody',)

    m0: float = parameter(1.0, 'kg', 'm0 of the model')
    m1: float = parameter(1.0, 'kg', 'm1 of the model')
    m2: float = parameter(1.0, 'kg', 'm2 of the model')
    m3: float = parameter(1.0, 'kg', 'm3 of the model')
    l0: float = parameter(0.5, 'm', 'l0 of the model')
    l1: float = parameter(0.5, 'm', 'l1 of the model')
    l2: float = parameter(0.5, 'm', 'l2 of the model')
    g: float = parameter(9.81, 'm/s^2', 'g of the model')

    def mass(self, q):
        [q0, q1, q2, q3] = q
        c0 = jnp.cos(q1)
        c1 = c0*self.l0
        c2 = -c1*self.m1 - c1*self.m2 - c1*self.m3
        c3 = jnp.cos(q2)
        c4 = c3*self.l1
        c5 = -c4*self.m2 - c4*self.m3
        c6 = jnp.cos(q3)
        c7 = self.l2*self.m3
        c8 = -c6*c7
        c9 = self.l0**2
        c10 = jnp.sin(q1)
        c11 = jnp.sin(q2)
        c12 = self.l0*self.l1*(c0*c3 + c10*c11)
        c13 = c12*self.m2 + c12*self.m3
        c14 = jnp.sin(q3)
        c15 = c7*self.l0*(c0*c6 + c10*c14)
        c16 = self.l1**2
        c17 = c7*self.l1*(c11*c14 + c3*c6)
        return jnp.array(
            [
                [self.m0 + self.m1 + self.m2 + self.m3, c2, c5, c8],
                [c2, c9*self.m1 + c9*self.m2 + c9*self.m3, c13, c15],
                [c5, c13, c16*self.m2 + c16*self.m3, c17],
                [c8, c15, c17, self.l2**2*self.m3],
            ],
            dtype=float,
        )

    def force(self, q, v, t):
        [q0, q1, q2, q3] = q
        [v0, v1, v2, v3] = v
        c0 = v1**2
        c1 = jnp.sin(q1)
        c2 = c1*self.l0
        c3 = c0*c2
        c4 = v2**2
        c5 = jnp.sin(q2)
        c6 = c4*c5*self.l1
        c7 = v3**2
        c8 = jnp.sin(q3)
        c9 = self.l2*self.m3
        c10 = c2*self.g
        c11 = self.l0*self.l1
        c12 = c11*self.m2
        c13 = jnp.cos(q2)
        c14 = jnp.cos(q1)
        c15 = c1*c13 - c14*c5
        c16 = c15*c4
        c17 = c11*self.m3
        c18 = jnp.cos(q3)
        c19 = c1*c18 - c14*c8
        c20 = c7*c9
        c21 = -c0*c15
        c22 = -c13*c8 + c18*c5
        return jnp.array(
            [
                -c3*self.m1 - c3*self.m2 - c3*self.m3 - c6*self.m2 - c6*self.m3 - c7*c8*c9,
                c10*self.m1 + c10*self.m2 + c10*self.m3 - c12*c16 - c16*c17 - c19*c20*self.l0,
                -c12*c21 - c17*c21 - c20*c22*self.l1 + c5*self.g*self.l1*self.m2 + c5*self.g*self.l1*self.m3,
                c0*c19*c9*self.l0 + c22*c4*c9*self.l1 + c8*self.g*self.l2*self.m3,
            ],
            dtype=float,
        )

    def initial_state(self):
        q = [0.0, 2.2, 2.6, 3.0]
        v = [0.5, 0.0, 0.0, 0.0]
        return completed(self, q, v, open_q=[0], open_v=[1, 2, 3])
