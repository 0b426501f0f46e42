"""Spectra of methods on the oscillator: digits of their formulas, identities, and limits."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pytest
from helpers import long
from proofs import OMEGA_H, ConservingOscillator, damping_and_period, radii

from bench.stability.matrices import matrices
from bench.stability.systems import LinearSystem, Oscillator, Relaxation
from integrators import Integrator
from integrators.methods import implicit_structural as structural
from integrators.methods import simulator_steppers as steppers
from integrators.methods.ali3p import ALI3P
from integrators.methods.bdf import BDF2
from integrators.methods.energy_momentum import EnergyMomentum
from integrators.methods.explicit_structural import CR, ExplicitGeneralizedAlpha, KRAlpha, NohBathe
from integrators.methods.generalized_alpha import HHT, GeneralizedAlpha
from integrators.methods.hht_i3 import HHTI3
from integrators.methods.radau_iia import RadauIIA
from integrators.methods.symplectic import RATTLE, SHAKE, StormerVerlet, VariationalMidpoint


@dataclass(frozen=True)
class Spectrum:
    """Spectral radii, at `OMEGA_H` by default; damping and relative error of the period."""

    method: Integrator
    radii: Sequence[float]
    #: At omega h = 0.2 pi.
    shape: tuple[float, float] | None = None
    within: float = 1e-9
    on: LinearSystem = Oscillator()  # noqa: RUF009 - frozen
    at: Sequence[float] = OMEGA_H

    def __str__(self) -> str:
        return self.method.spec


Z, ROOT = 1j * np.array(OMEGA_H), 1 - 1 / math.sqrt(2)
#: Amplification of the L-stable SDIRK method of two stages.
SDIRK2 = np.abs((1 + (1 - 2 * ROOT) * Z) / (1 - ROOT * Z) ** 2)
UNDAMPED = [1.0] * len(OMEGA_H)
#: Radii and shapes of generalized-alpha by rho_inf, from a program of its own.
ALPHA = {
    0.5: ((0.999998160424, 0.989312786016, 0.682528421486, 0.537173623904),
          (0.003780049758, 0.0467153187)),
    0.8: ((0.999999931616, 0.999474614014, 0.929791767153, 0.834637608774),
          (0.0001572715, 0.0338284060)),
}  # fmt: skip
#: structural.Houbolt's method has the radii of the member of generalized-alpha that damps most.
DAMPED = (0.999951917652, 0.906563333305, 0.242535625036, 0.0478312816831)
TRAPEZOIDAL, CENTRAL = (0.0, 0.03207491062), (0.0, -0.01693422976)
#: Beyond the limit of central differences: minus the mean of the roots is w.
_W = 2.01**2 / 2 - 1
UP_TO_2 = {"at": (0.1, 1.0, 1.999, 2.01), "radii": (1, 1, 1, _W + math.sqrt(_W**2 - 1))}
SHORT = [
    # Independent computation in 50 digits from the formula's own polynomial.
    Spectrum(BDF2(), (0.999975609345, 0.933321058436, 0.300749568269, 0.078110132815),
             (0.03442589388, 0.1020606581)),
    Spectrum(structural.RhoInfBathe(rho_inf=0.5),
             (0.999999806973, 0.998315845021, 0.649747454588, 0.502080545025),
             (0.0004587631855, 0.01148896615)),
    Spectrum(GeneralizedAlpha(rho_inf=0.0), DAMPED),
    *(Spectrum(method(rho_inf=rho), *ALPHA[rho])
      for method in (KRAlpha, GeneralizedAlpha) for rho in (0.5, 0.8)),
    Spectrum(KRAlpha(rho_inf=1.0), UNDAMPED, TRAPEZOIDAL),
    Spectrum(ExplicitGeneralizedAlpha(), (0.999998149511, 0.982030217877),
             (0.004450231273, -0.01091584946), at=(0.1, 1.0)),
    Spectrum(steppers.SemiImplicitEuler(), shape=CENTRAL, **UP_TO_2),
    # rho_inf is the radius at infinite frequency.
    *(Spectrum(structural.RhoInfBathe(rho_inf=rho), [rho], within=1e-6, at=[1e7])
      for rho in (0.0, 0.3, 0.8, 1.0)),
]  # fmt: skip
MORE = [
    Spectrum(structural.WilsonTheta(),
             (0.999991720364, 0.967491846228, 0.561980474574, 0.775676799441),
             (0.01398075474, 0.0614622058)),
    Spectrum(CR(), UNDAMPED, TRAPEZOIDAL),
    Spectrum(structural.Bathe(), (0.99999965338, 0.997054485502, 0.457286606856, 0.0499519610314),
             (0.0008186670143, 0.01617937436)),
    Spectrum(structural.TRBDF2(), SDIRK2, (0.0008678050247, 0.01571442413), within=1e-12),
    Spectrum(structural.RhoInfBathe(rho_inf=0.0), SDIRK2, within=1e-12),
    Spectrum(structural.Houbolt(), DAMPED, (0.05498792741, 0.1232057196)),
    # (10 r^3 - 15 r^2 + 6 r - 1)/(6 r^3) = i omega h: the formula on u' = i omega u.
    Spectrum(structural.Park(), [abs(np.roots([10 - 6 * z, -15, 6, -1])).max() for z in Z]),
    # Independent computation in 50 digits.
    Spectrum(RadauIIA(stages=3, steps="constant"),
             (0.999999999861, 0.999869306671, 0.321402950403, 0.0300224988042),
             (1.328101807e-5, 1.441254394e-6)),
    Spectrum(RadauIIA(stages=2, steps="constant"),
             np.abs((1 + Z / 3) / (1 - 2 * Z / 3 + Z**2 / 6))),
    Spectrum(ALI3P(), UNDAMPED, within=1e-12),
    Spectrum(EnergyMomentum(), UNDAMPED, within=1e-12, on=ConservingOscillator()),
    Spectrum(steppers.LinearlyImplicitEuler(), np.abs(1 / (1 - Z)), within=1e-12),
    # A controller.
    Spectrum(steppers.LinearlyImplicitEuler(), [1 / 4], within=1e-12, on=Relaxation(), at=[3.0]),
    *(Spectrum(method, (0.9, 1.1), within=1e-12, on=Relaxation(), at=[1.9, 2.1])
      for method in (steppers.SemiImplicitEuler(), steppers.ImplicitFast())),
    *(Spectrum(method, shape=CENTRAL, **UP_TO_2)
      for method in (steppers.ImplicitFast(), StormerVerlet(), RATTLE(), SHAKE())),
    Spectrum(NohBathe(), [0.9978817565], at=[1.0]),
    Spectrum(VariationalMidpoint(), UNDAMPED, TRAPEZOIDAL),
]  # fmt: skip


@pytest.mark.parametrize("cases", [(*SHORT,), *long([*MORE])])
def test_spectra_have_the_digits_of_the_formulas(cases):
    for case in cases:
        found = radii(case.method, case.at, case.on)
        assert found == pytest.approx(list(case.radii), abs=case.within), str(case)
        if case.shape:
            assert damping_and_period(case.method) == pytest.approx(case.shape, abs=1e-9), str(case)


def test_explicit_generalized_alpha_has_the_limits_and_joint_roots_of_the_formulas():
    for rho in (0.0, 0.5, 0.8):
        method, joint = ExplicitGeneralizedAlpha(rho_b=rho), (1 + rho) * math.sqrt(2 - rho)
        limit = math.sqrt(12 * (2 - rho) * (1 + rho) / (10 - 5 * rho + rho**2))
        below, above = radii(method, [limit - 1e-5, limit + 1e-5])
        assert below < 1 < above
        # A triple root -rho and a root 0, by the polynomial of A: roots have the error's cube root.
        (a,) = matrices(method, Oscillator(), [joint]).a
        assert np.abs(a @ np.linalg.matrix_power(a + rho * np.eye(4), 3)).max() < 1e-12


@pytest.mark.long
def test_noh_bathe_is_stable_up_to_the_published_limits():
    for p, limit in ((0.54, 3.745), (0.7, 3.482)):
        below, above = radii(NohBathe(p=p), [limit - 2e-3, limit + 2e-3])
        assert below < 1 < above


@pytest.mark.long
def test_hht_i3_has_the_radii_of_hht():
    for alpha in (0.2, 0.3):
        wanted = radii(HHT(alpha=alpha))
        assert radii(HHTI3(alpha=-alpha, steps="constant")) == pytest.approx(wanted, abs=1e-12)
