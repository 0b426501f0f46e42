"""Short names: what they say and leave out, and that no two are the same."""

from __future__ import annotations

import tomllib
from itertools import pairwise
from pathlib import Path

from hypothesis import given
from hypothesis import strategies as st
from small_stores import atlas_with

from reports.formatting import symbols
from reports.names import BUILT_IN, short_name, short_names
from reports.pages.method_page import atlas_table
from reports.pages.templating import escape_markdown

ROOT = Path(__file__).parents[1]
GGL = "formulation=stabilised_index2"


def test_a_short_name_says_method_and_options():
    for label, name in [
        ("generalized_alpha[rho_inf=0.8]", "gα 0.8"),
        (f"generalized_alpha[rho_inf=1.0,{GGL},newton=modified]", "gα 1 · GGL · modified"),
        (
            "generalized_alpha[rho_inf=0.8,gamma=updated] x 0.3/0.7",
            "gα 0.8 · γ updated · steps 0.3/0.7",
        ),
        ("generalized_alpha[rho_inf=0.8,alpha_m=0.2]", "gα 0.8 · αm 0.2"),
        ("hht[alpha=0.1]", "HHT 0.1"),
        ("newmark[beta=0.25,gamma=0.5]", "Newmark"),
        ("newmark[beta=0.3,gamma=0.6]", "Newmark · β 0.3 · γ 0.6"),
        (f"ida[{GGL}]", "IDA"),
        ("ida[formulation=index1]", "IDA · index 1"),
        ("kvaerno5", "Kvaerno5"),
        ("my_method[order=3,new_rule=on]", "my_method · order 3 · new rule on"),
        ("no [specification", "no [specification"),
    ]:
        assert short_name(label) == name


def test_what_a_family_has_in_common_is_left_out_and_what_tells_apart_stays():
    labels = [
        f"generalized_alpha[rho_inf=0.8,{GGL},start=corrected,newton=modified]",
        "generalized_alpha[rho_inf=0.8,newton=modified]",
        "hht[alpha=0.1,newton=modified]",
        "newmark[beta=0.25,gamma=0.5,newton=modified]",
        "my_method[newton=modified]",
    ]
    assert list(short_names(labels).values()) == [
        "gα 0.8 · GGL", "gα 0.8", "HHT 0.1", "Newmark", "my_method"
    ]  # fmt: skip
    # One with the full Newton method: all must say theirs.
    names = short_names([*labels, "wbz[rho_inf=0.8]"])
    assert names[labels[1]] == "gα 0.8 · modified"
    assert names["wbz[rho_inf=0.8]"] == "WBZ 0.8"
    assert names["my_method[newton=modified]"] == "my_method · modified"
    # With another start in the field, the corrected one no longer goes with GGL alone.
    names = short_names([*labels, "generalized_alpha[rho_inf=0.8,start=corrected,newton=modified]"])
    assert names[labels[0]] == "gα 0.8 · GGL · corrected start"
    assert short_names(labels[1:2]) == {labels[1]: "gα 0.8 · modified"}


def test_names_that_would_be_the_same_are_written_in_full():
    names = short_names(["ida", f"ida[{GGL}]", "m[alpha=1]", "m[rho_inf=1]"])
    assert names == {k: k for k in names}


def test_the_built_in_integrators_have_short_names():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert set(project["entry-points"]["stepbench.integrators"]) == set(BUILT_IN)


VALUES = {
    "rho_inf": ("0.5", "0.8"),
    "alpha": ("0.5",),
    "formulation": ("index1", "stabilised_index2"),
    "newton": ("modified",),
    "gamma": ("0.5", "updated"),
}
options = st.fixed_dictionaries({}, optional={k: st.sampled_from(v) for k, v in VALUES.items()})
labels = st.builds(
    lambda name, given_, steps: (
        name + (f"[{','.join(f'{k}={v}' for k, v in given_.items())}]" if given_ else "") + steps
    ),
    st.sampled_from(["generalized_alpha", "hht", "ida", "newmark", "mine"]),
    options,
    st.sampled_from(["", " x 0.3/0.7"]),
)


@given(st.lists(labels, max_size=12))
def test_no_two_integrators_of_a_report_share_a_name(found):
    names = short_names(found)
    assert set(names) == set(found)
    assert len(set(names.values())) == len(names)


def test_the_suite_with_all_scenes_has_one_set_of_methods_and_short_names():
    text = (ROOT / "bench/profiles/full.toml").read_text(encoding="utf-8")
    studies = tomllib.loads(text)["study"]
    main = [s for s in studies if not s.get("title", "").startswith("Families")]
    assert len({p for s in main for p in s["problems"]}) == 18
    assert all(s["integrators"] == main[0]["integrators"] for s in main)
    steps = [one / two for s in studies for one, two in pairwise(s["rtol"])]
    assert max(steps) < 3.4  # two tolerances a decade
    names = short_names(i for s in studies for i in s["integrators"])
    assert max(map(len, names.values())) < 20


def test_pages_write_symbols_and_names_as_a_reader_knows_them():
    assert symbols("a and lam, lam[1]; lam=0.1 and lam:1; lambda, slam") == (
        "a and λ, λ[1]; lam=0.1 and lam:1; lambda, slam"
    )
    assert escape_markdown("As ``slider_crank``, lam_1 and *lam*.") == (
        "As `slider_crank`, lam\\_1 and \\*λ\\*."
    )


def test_the_atlas_counts_the_parts_that_spare_each():
    found = [*atlas_with("mine", "e").values()]
    for name, spared in (("mine", "0 of 1"), ("spared", "1 of 1")):
        assert atlas_table(name, found).rows == [["1. ", spared]]
    assert atlas_table("bdf", found) is None
