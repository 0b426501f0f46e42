"""Names with options: printed names are read back, and messages name wrong ones."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import toy
from hypothesis import given
from hypothesis import strategies as st

from integrators.methods.generalized_alpha import HHT, GeneralizedAlpha, Newmark
from problems.base.spec import SpecError, build, split_spec
from problems.scenes.oscillators import SpringMass
from problems.scenes.pendulums import Pendulum
from problems.variables import parameter


def read(cls, text):
    name, options = split_spec(text)
    assert name == cls.name
    return build(cls, options, name)


@given(
    st.floats(0, 1),
    st.none() | st.floats(-3, 0.95),
    st.sampled_from(["fixed", "updated", "guarded"]),
    st.integers(1, 99),
)
def test_options_round_trip_through_the_printed_name(rho, delta, gamma, most):
    method = GeneralizedAlpha(rho_inf=rho, delta_m=delta, gamma=gamma, newton_max=most)
    assert read(GeneralizedAlpha, method.spec) == method


def test_the_printed_name_shows_what_matters():
    assert GeneralizedAlpha().spec == "generalized_alpha[rho_inf=0.8]"
    method = GeneralizedAlpha(gamma="updated")
    assert method.spec == "generalized_alpha[rho_inf=0.8,gamma=updated]"
    assert Newmark().spec == "newmark[beta=0.25,gamma=0.5]"
    assert Pendulum().spec == "pendulum"
    assert read(Pendulum, " pendulum[ th0 = 2 , g=1]") == Pendulum(th0=2.0, g=1.0)


def test_a_wrong_option_is_named_with_what_is_allowed():
    for cls, text, words in [
        (GeneralizedAlpha, "generalized_alpha[rho=1]", "rho_inf"),
        (GeneralizedAlpha, "generalized_alpha[rho_inf=1.5]", r"\[0.0, 1.0\]"),
        (GeneralizedAlpha, "generalized_alpha[rho_inf=nan]", "not a finite number"),
        (GeneralizedAlpha, "generalized_alpha[rho_inf=half]", "not a float"),
        (GeneralizedAlpha, "generalized_alpha[gamma=updatd]", "did you mean 'updated'"),
        (GeneralizedAlpha, "generalized_alpha[newton_max=2.5]", "not a int"),
        (GeneralizedAlpha, "generalized_alpha[rho_inf]", "option=value"),
        (GeneralizedAlpha, "generalized_alpha[rho_inf=1,rho_inf=0]", "twice"),
        (GeneralizedAlpha, "generalized_alpha[alpha_m=1]", r"\[-3.0, 0.95\]"),
        (GeneralizedAlpha, "generalized_alpha[gamma=4]", r"\[0.0, 3.0\]"),
        (GeneralizedAlpha, "generalized_alpha[gamma=nan]", "known: fixed, guarded, updated"),
        (HHT, "hht[alpha=0.4]", "outside"),
        (Pendulum, "pendulum[th0=nan]", "not a finite number"),
        (Pendulum, "pendulum]th0", "not of the form"),
    ]:
        with pytest.raises(SpecError, match=words):
            read(cls, text)


def test_a_class_that_refuses_its_values_is_one_sentence():
    for error, words in [
        (ZeroDivisionError("so it\ngoes."), "moody cannot be made: ZeroDivisionError: so it goes."),
        (KeyError(), "moody cannot be made: KeyError: no message."),
        (SystemExit("enough"), "moody cannot be made: SystemExit: enough."),
        (SpecError("These two do not go together."), "These two do not go together."),
    ]:

        def refuse(self):
            raise error

        with pytest.raises(SpecError) as caught:
            build(toy("Moody", base=HHT, __post_init__=refuse), {}, "moody")
        assert str(caught.value) == words


def test_a_numpy_default_is_a_traced_parameter_like_any_float():
    for kind in [np.float64, np.float32]:
        heavy = toy("Heavy", base=Pendulum, load=parameter(kind(2.0), "kg", "load"))
        assert type(heavy().load) is float
        assert heavy().parameters()["load"] == 2.0
        with pytest.raises(SpecError, match="not a finite number"):
            build(heavy, {"load": "nan"}, "heavy")


@given(st.floats(0, 3), st.none() | st.floats(-3, 0.95), st.none() | st.floats(0, 3))
def test_free_parameters_round_trip_and_reach_the_scheme(gamma, alpha_m, beta):
    method = GeneralizedAlpha(gamma=gamma, alpha_m=alpha_m, beta=beta)
    assert read(GeneralizedAlpha, method.spec) == method
    s, by_rule = method.scheme(), GeneralizedAlpha().scheme()
    assert s.gamma == gamma
    assert not s.updated
    assert s.alpha_m == (by_rule.alpha_m if alpha_m is None else alpha_m)
    assert s.beta == (0.25 * (gamma + 0.5) ** 2 if beta is None else beta)
    assert (s.alpha_f, s.theta) == (by_rule.alpha_f, by_rule.theta)


def test_claims_follow_the_free_parameters():
    def claims(scene, **options):
        return GeneralizedAlpha(**options).claims(scene)

    free, controlled = Pendulum(), SpringMass()
    whole = GeneralizedAlpha().claims(free)
    one_set = {"alpha_m": 0.3, "alpha_f": 0.4, "delta_m": 0.3, "delta_f": 0.4}
    assert claims(free, **one_set) == claims(controlled, **one_set) == whole
    assert set(claims(free, gamma=0.6).values()) == {1}
    assert claims(free, alpha_m=0.6, alpha_f=0.7) == {}  # not zero-stable
    assert claims(free, alpha_m=0.3, alpha_f=0.3) == {"q": 2, "v": 2}  # undamped on index 3
    assert claims(free, delta_m=0.6) == whole
    assert claims(controlled, delta_m=0.6) == {}
    assert "factor of 1.222" in (GeneralizedAlpha(alpha_m=0.4, alpha_f=0.3).supports(free) or "")
    assert GeneralizedAlpha(alpha_m=0.4, alpha_f=0.3).supports(controlled) is None
    assert GeneralizedAlpha(rho_inf=1.0).supports(free) is None
