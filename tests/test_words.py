"""Words: phrases, suites, titles, counts of runs, and short names."""

from __future__ import annotations

import json
import tomllib
from importlib.metadata import entry_points
from itertools import pairwise
from pathlib import Path

import msgspec
from hypothesis import given
from hypothesis import strategies as st
from planted import plant, planted
from small_stores import A_SCENE, atlas_with, filled

from bench.results.records import endings
from bench.results.store import Store
from bench.running.inventory import Inventory
from bench.running.plan import built_in_profiles, make_suite, read_profile
from reports.formatting import symbols
from reports.names import BUILT_IN, short_name, short_names
from reports.pages.method_page import atlas_table
from reports.pages.report import read_report
from reports.pages.templating import escape_markdown
from reports.questions import Ref, listed, plain

GROUPS = {"q": (1.0, 2), "v": (1.0, 2), "a": (1.0, 2), "lam": (1.0, 2)}


def ended(status: str, h: float = 0.1, integrator: str = "good"):
    errors, message = (GROUPS, "") if status == "ok" else ({}, "Because.")
    return planted("pendulum", integrator, errors, h=h, status=status, message=message)


def test_runs_that_are_not_supported_are_no_failures():
    runs = [*map(ended, ["ok", "ok", "unsupported", "diverged"])]
    assert endings(runs) == "2 ok, 1 not supported, 1 failed with a reason"
    assert endings(runs[:2]) == "2 ok, 0 failed with a reason"
    cut = [*runs, ended("interrupted")]
    assert endings(cut) == f"{endings(runs)}, 1 interrupted"


def test_an_order_of_unsupported_runs_alone_is_one_sentence(refused, monkeypatch, tmp_path):
    def run_suite(suite, registry, out, *more):
        Store(out, create=True).close()
        return [ended("unsupported", h) for h in (0.1, 0.05, 0.025)], []

    monkeypatch.setattr("bench.commands.suite.run_suite", run_suite)
    said = refused("order", "pendulum", "newmark", "--out", tmp_path)
    assert said == "Error: No order was measured. All end with unsupported: Because."


def test_a_part_of_a_suite_is_titled_by_what_was_run(tmp_path):
    name, profile = read_profile("quick")
    registry = Inventory()
    assert make_suite(name, profile, registry).plan.title == profile.title
    part = make_suite(name, profile, registry, ["pendulum"], ["newmark"]).plan
    assert part.title == ""
    runs = [ended("ok"), ended("ok", 0.05), ended("ok", 0.05, "other")]
    assert part.heading(runs) == "quick: 1 scene, 2 integrators"
    assert part.heading([]) == "quick"
    folder = plant(tmp_path / "store", runs, plan=False)
    with Store(folder, create=True) as store:
        store.keep(part)
    report = read_report(folder)
    assert report.title == "quick: 1 scene, 2 integrators"
    assert "3 reached the end, 0 failed with a reason" in report.stored.state


def test_a_method_of_one_s_own_comes_beside_the_suite():
    name, profile = read_profile("quick")
    registry = Inventory()
    whole = make_suite(name, profile, registry)
    plan = make_suite(name, profile, registry, mine="wbz").plan
    assert (plan.mine, plan.title) == ("wbz[rho_inf=0.8]", whole.plan.title)
    assert set(plan.integrators) == {*whole.plan.integrators, plan.mine}
    assert sum(plan.mine in key for study in plan.studies for key in study.cells) == 12
    alone = make_suite(name, profile, registry, ["pendulum"], ["ida"], mine="wbz").plan
    assert {text.partition("[")[0] for text in alone.integrators} == {"ida", "wbz"}
    there = make_suite(name, profile, registry, mine="generalized_alpha[rho_inf=0.8]").plan
    assert set(there.integrators) == set(whole.plan.integrators)


def test_the_list_has_a_line_for_each_and_details_of_one(stepbench, monkeypatch):
    monkeypatch.setenv("COLUMNS", "100")
    registry = Inventory()
    lines = stepbench("list").stdout.splitlines()
    names = [*registry.problems, *registry.integrators, *built_in_profiles()]
    for name in names:
        assert sum(line.split()[:1] == [name] for line in lines) == 1, name
    assert len(lines) == len(names) + 4
    only = stepbench("list", "scenes").stdout
    assert "pendulum" in only
    assert "newmark" not in only
    text = " ".join(stepbench("list", "pendulum", "generalized_alpha").stdout.split())
    for words in (
        "Released at rest at angle th0 from the downward vertical",
        "th0 1.5708 from 1e-06 to 3.14159 amplitude: angle at rest at t=0 in rad",
        "start consistent consistent, corrected consistent: aux = a at t0",
        "beta none from 0 to 3",
    ):
        assert words in text
    suite = " ".join(stepbench("list", "quick").stdout.split())
    assert "6 timings per run, at most 60 s" in suite
    assert "Pendulum: IDA on raw index 3" in suite
    wrong = stepbench("list", "pendulm")
    assert wrong.exit_code == 1
    assert "did you mean 'pendulum'" in wrong.stderr


def test_the_json_of_the_list_is_complete(stepbench):
    listed = json.loads(stepbench("list", "--json").stdout)
    for kind in ("problems", "integrators"):
        names = {entry.name for entry in entry_points(group=f"stepbench.{kind}")}
        assert {row["name"] for row in listed[kind]} == names
    assert {row["name"] for row in listed["suites"]} >= {"quick", "full", "methods"}
    (row,) = json.loads(stepbench("list", "pendulum", "--json").stdout)["problems"]
    assert row in listed["problems"]
    assert row["description"][0].startswith("Released at rest")
    assert [option["name"] for option in row["options"]][:3] == ["m", "length", "g"]
    (suite,) = json.loads(stepbench("list", "quick", "--json").stdout)["suites"]
    assert suite["study"][1]["problems"] == ["pendulum"]


def test_parts_become_text():
    sentence = ["On ", *listed([[Ref("scene", k, k.upper())] for k in "abcd"]), "."]
    assert plain(sentence) == "On A, B, C and 1 more."


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


def test_pages_write_symbols_and_names_as_a_reader_knows_them():
    assert symbols("a and lam, lam[1], lam12; lam=0.1 and lam:1; lambda, slam") == (
        "a and λ, λ[1], λ12; lam=0.1 and lam:1; lambda, slam"
    )
    assert escape_markdown("As ``slider_crank``, lam_1 and *lam*.") == (
        "As `slider_crank`, lam\\_1 and \\*λ\\*."
    )


def test_the_atlas_counts_the_parts_that_spare_each():
    found = [*atlas_with("mine", "e").values()]
    for name, spared in (("mine", "0 of 1"), ("spared", "1 of 1")):
        assert atlas_table(name, found).rows == [["1. About e: it fails", spared]]
    assert atlas_table("bdf", found) is None


def test_the_suite_with_all_scenes_has_one_set_of_methods_and_short_names():
    text = Path("bench/profiles/full.toml").read_text(encoding="utf-8")
    studies = tomllib.loads(text)["study"]
    main = [s for s in studies if not s.get("title", "").startswith("Families")]
    assert len({p for s in main for p in s["problems"]}) == 18
    assert all(s["integrators"] == main[0]["integrators"] for s in main)
    steps = [one / two for s in studies for one, two in pairwise(s["rtol"])]
    assert max(steps) < 3.4  # two tolerances a decade
    names = short_names(i for s in studies for i in s["integrators"])
    assert max(map(len, names.values())) < 20


def test_the_page_of_the_measurement_names_the_scene_with_the_least_certain_reference(tmp_path):
    worse = {"problem": "stiff_bar", "reference_error": {"a": 3e-11}}
    with Store(filled(tmp_path), create=True) as store:
        store.keep(msgspec.structs.replace(A_SCENE, **worse))
    (reason, *_), *_ = read_report(tmp_path).chapters[-1].sections[0].parts
    assert reason == "The largest error of a reference is 3e-11 in acceleration (stiff bar)."
