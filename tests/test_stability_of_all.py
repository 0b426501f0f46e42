"""The stability analysis takes every native method, or says in a sentence why it does not."""

from __future__ import annotations

import math

import pytest

from bench.plugins.registry import Registry
from bench.stability.spectra import spectrum
from bench.stability.systems import Oscillator
from integrators.native.step_method import NativeMethod
from problems.base.spec import SpecError

REGISTRY = Registry()
NATIVE = [
    name
    for name, plugin in REGISTRY.integrators.items()
    if plugin.cls is not None and issubclass(plugin.cls, NativeMethod)
]
#: They have no form at constant steps.
ALWAYS_ADAPTIVE = {"bdf_adaptive", "generalized_alpha_adaptive"}


def test_all_native_methods_are_seen():
    assert len(NATIVE) > 30
    assert set(NATIVE) > ALWAYS_ADAPTIVE


@pytest.mark.long
@pytest.mark.parametrize("name", NATIVE)
def test_each_has_a_spectrum_or_a_reason(name):
    method = REGISTRY.integrator(name)
    constant = method.at_constant_steps()
    if name in ALWAYS_ADAPTIVE:
        assert constant is None
        with pytest.raises(SpecError, match="chooses its own steps"):
            spectrum(method, Oscillator())
        return
    if constant.why_not(Oscillator()):
        with pytest.raises(SpecError, match="take generalized_alpha"):
            spectrum(constant, Oscillator())
        return
    found = vars(spectrum(constant, Oscillator(), (1.0,), (0.1,)))
    k = found["omega_h"].tolist().index(0.1)
    # All are of order 1 at least: exp(i 0.1) has size and angle within a term of second order.
    assert found["radius"][k] == pytest.approx(1.0, abs=0.1**2)
    assert found["period_error"][k] == pytest.approx(0.0, abs=0.1**2)
    assert found["damping"][k] == pytest.approx(-math.log(found["radius"][k]) / 0.1, abs=0.1**2)
    # Eigenvalues may be more accurate than solutions: a symplectic Euler step has those of order 2.
    assert found["order"] >= constant.claims(Oscillator())["q"]
    assert all(found[part][k] < 1.1 for part in ("overshoot_q", "overshoot_v"))
