"""Options that decide nothing beside others: refused, as they would give a second printed name."""

from __future__ import annotations

import pytest

from bench.plugins.registry import Registry
from problems.spec import SpecError

REGISTRY = Registry()


@pytest.mark.parametrize(
    ("spec", "said"),
    [
        ("rodas5p[alpha=5]", "alpha=5.0 decides nothing without constraints=baumgarte"),
        ("radau[constraints=projected,beta=5]", "beta=5.0 decides nothing without constraints="),
        ("hht_i3[steps=constant,control=chrono]", "control=chrono decides nothing without steps="),
        ("phem56[steps=constant,max_steps=5]", "max_steps=5 decides nothing without steps="),
        ("radau_iia[steps=constant,error_test=all]", "error_test=all decides nothing without"),
        ("rattle[multiplier=one_sided,values=equations]", "one_sided decides nothing without val"),
    ],
)
def test_an_option_without_effect_is_refused_with_what_it_needs(spec, said):
    with pytest.raises(SpecError, match=said):
        REGISTRY.integrator(spec)


def test_defaults_may_be_given_and_options_with_an_effect_keep_their_names():
    assert REGISTRY.integrator("rodas5p[alpha=20,beta=20,max_steps=1000000]").spec == "rodas5p"
    for spec in (
        "rodas5p[constraints=baumgarte,alpha=5.0]",
        "hht_i3[alpha=-0.2,control=chrono]",
        "radau_iia[stages=3,error_test=all]",
        "variational_midpoint[multiplier=one_sided]",
    ):
        assert REGISTRY.integrator(spec).spec.count(",") == spec.count(",")


def test_at_constant_steps_a_method_forgets_what_chose_its_steps():
    constant = REGISTRY.integrator("radau_iia[error_test=all,max_steps=7]").at_constant_steps()
    assert constant is not None
    assert constant.spec == REGISTRY.integrator("radau_iia[steps=constant]").spec
