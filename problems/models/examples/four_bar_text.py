# Written by `python -m problems.models.examples.derived`, SymPy 1.14.0.
"""The scene sympy_four_bar, written by `problems.from_sympy`."""

from dataclasses import dataclass

from problems import MechatronicSystem, jnp, parameter
from problems.models.starts import completed


@dataclass(frozen=True)
class SympyFourBar(MechatronicSystem):
    'A SymPy model (LagrangesMethod); coordinates: q0 = q1, q1 = q2, q2 = q3'

    name = 'sympy_four_bar'
    interval = (0.0, 2.0)
    nominal_step = 0.01
    coordinates = ('q1 [rad]', 'q2 [rad]', 'q3 [rad]')
    tags = ('multibody', 'constrained', 'index 3', 'conservative')

    l1: float = parameter(1.0, 'm', 'l1 of the model')
    l2: float = parameter(2.0, 'm', 'l2 of the model')
    l3: float = parameter(2.0, 'm', 'l3 of the model')
    rho: float = parameter(1.0, 'kg/m', 'rho of the model')
    d: float = parameter(2.5, 'm', 'd of the model')
    g: float = parameter(9.81, 'm/s^2', 'g of the model')

    def mass(self, q):
        [q0, q1, q2] = q
        c0 = jnp.sin(q0)
        c1 = c0**2
        c2 = self.l1**2
        c3 = 2*c2
        c4 = jnp.cos(q0)
        c5 = c4**2
        c6 = (1/2)*self.rho
        c7 = c6*(c1*c3 + c3*c5)
        c8 = (1/2)*c2
        c9 = jnp.sin(q1)
        c10 = self.l1*self.l2
        c11 = c0*c10*c9
        c12 = jnp.cos(q1)
        c13 = c10*c12*c4
        c14 = c6*self.l2
        c15 = c6*self.l3
        c16 = c14*(c11 + c13) + c15*(2*c11 + 2*c13)
        c17 = jnp.sin(q2)
        c18 = self.l1*self.l3
        c19 = jnp.cos(q2)
        c20 = c15*(c0*c17*c18 + c18*c19*c4)
        c21 = c9**2
        c22 = self.l2**2
        c23 = 2*c22
        c24 = c12**2
        c25 = (1/2)*c22
        c26 = self.l2*self.l3
        c27 = c15*(c12*c19*c26 + c17*c26*c9)
        c28 = self.l3**2
        c29 = (1/2)*c28
        return jnp.array(
            [
                [c6*self.l1*(c1*c8 + (1/6)*c2 + c5*c8) + c7*self.l2 + c7*self.l3, c16, c20],
                [c16, c14*(c21*c25 + (1/6)*c22 + c24*c25) + c15*(c21*c23 + c23*c24), c27],
                [c20, c27, c15*(c17**2*c29 + c19**2*c29 + (1/6)*c28)],
            ],
            dtype=float,
        )

    def force(self, q, v, t):
        [q0, q1, q2] = q
        [v0, v1, v2] = v
        c0 = jnp.cos(q0)
        c1 = c0*self.g
        c2 = c1*self.l1*self.rho
        c3 = (1/2)*self.rho
        c4 = self.l1*v0
        c5 = c0*c4
        c6 = jnp.cos(q1)
        c7 = self.l2*v1
        c8 = c6*c7
        c9 = c5 + (1/2)*c8
        c10 = jnp.sin(q0)
        c11 = c10*c4
        c12 = 2*c11
        c13 = jnp.sin(q1)
        c14 = c13*c7
        c15 = -c11 - 1/2*c14
        c16 = 2*c5
        c17 = c12*c9 + c15*c16
        c18 = jnp.cos(q2)
        c19 = c18*self.l3
        c20 = (1/2)*v2
        c21 = c19*c20 + c5 + c8
        c22 = self.l3*jnp.sin(q2)
        c23 = -c11 - c14 - c20*c22
        c24 = c12*c21 + c16*c23
        c25 = self.l1*v0**2
        c26 = c10*c25
        c27 = self.l2*v1**2
        c28 = c13*c27
        c29 = -c26 - 1/2*c28
        c30 = c0*c25
        c31 = c27*c6
        c32 = -c30 - 1/2*c31
        c33 = 2*c10*self.l1
        c34 = c3*self.l2
        c35 = (1/2)*v2**2
        c36 = -c22*c35 - c26 - c28
        c37 = -c19*c35 - c30 - c31
        c38 = c3*self.l3
        c39 = c3*self.g
        c40 = c14*c9 + c15*c8
        c41 = 2*c14*c21 + 2*c23*c8
        c42 = c13*self.l2
        c43 = c19*c23*v2 + c21*c22*v2
        return jnp.array(
            [
                -c1*c3*self.l1**2 - 1/2*c17*self.l2*self.rho - c2*self.l2 - c2*self.l3 - 1/2*c24*self.l3*self.rho - c34*(2*c0*c29*self.l1 - c17 - c32*c33) - c38*(2*c0*c36*self.l1 - c24 - c33*c37),
                -c34*(c29*c6*self.l2 - c32*c42 - c40) - c38*(2*c36*c6*self.l2 - 2*c37*c42 - c41) - c39*c6*self.l2**2 - 1/2*c40*self.l2*self.rho - 1/2*c41*self.l3*self.rho - c6*self.g*self.l2*self.l3*self.rho,
                -c18*c39*self.l3**2 - c38*(c18*c36*self.l3 - c22*c37 - c43) - 1/2*c43*self.l3*self.rho,
            ],
            dtype=float,
        )

    def constraint(self, q, t):
        [q0, q1, q2] = q
        return jnp.array(
            [
                -self.d + self.l1*jnp.cos(q0) + self.l2*jnp.cos(q1) + self.l3*jnp.cos(q2),
                self.l1*jnp.sin(q0) + self.l2*jnp.sin(q1) + self.l3*jnp.sin(q2),
            ],
            dtype=float,
        )

    def energy(self, q, v):
        [q0, q1, q2] = q
        [v0, v1, v2] = v
        c0 = jnp.sin(q0)
        c1 = self.l1**2
        c2 = (1/2)*self.rho
        c3 = c0*self.l1
        c4 = self.l2*jnp.sin(q1)
        c5 = self.g*self.rho
        c6 = self.l3*jnp.sin(q2)
        c7 = (1/2)*c6
        c8 = c1*v0**2
        c9 = c0**2
        c10 = (1/4)*c8
        c11 = jnp.cos(q0)
        c12 = c11**2
        c13 = c2*self.l1
        c14 = self.l2**2
        c15 = c11*self.l1*v0
        c16 = jnp.cos(q1)
        c17 = c16*self.l2
        c18 = c17*v1
        c19 = c15 + (1/2)*c18
        c20 = c3*v0
        c21 = c4*v1
        c22 = -c20 - 1/2*c21
        c23 = c2*self.l2
        c24 = self.l3**2
        c25 = self.l3*jnp.cos(q2)
        c26 = c15 + c18 + (1/2)*c25*v2
        c27 = -c20 - c21 - c7*v2
        c28 = c2*self.l3
        c29 = c1*v0
        c30 = (1/2)*c29
        c31 = 2*c3
        return c0*c1*c2*self.g - c13*(c10*c12 + c10*c9 + (1/12)*c8) - c23*((1/12)*c14*v1**2 + c19**2 + c22**2) + c28*v2*((1/6)*c24*v2 + c25*c26 - c27*c6) - c28*((1/12)*c24*v2**2 + c26**2 + c27**2) + c5*self.l2*(c3 + (1/2)*c4) + c5*self.l3*(c3 + c4 + c7) + v0*(c13*(c12*c30 + (1/6)*c29 + c30*c9) + c23*(2*c11*c19*self.l1 - c22*c31) + c28*(2*c11*c26*self.l1 - c27*c31)) + v1*(c23*((1/6)*c14*v1 + c17*c19 - c22*c4) + c28*(2*c16*c26*self.l2 - 2*c27*c4))

    def initial_state(self):
        q = [1.0, 0.3, -1.5]
        v = [1.0, 0.0, 0.0]
        return completed(self, q, v, open_q=[1, 2], open_v=[1, 2])
