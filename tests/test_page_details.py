"""Pages of a report: commands, names, terms, DOIs, equations, animations; that of a method."""

from __future__ import annotations

import re
from decimal import ROUND_HALF_UP, Decimal
from pathlib import Path
from xml.etree import ElementTree

import altair
import msgspec
import pytest
import vl_convert
from hypothesis import given
from hypothesis import strategies as st
from planted import Document, chart_rows, edited, everything, page_data, plant, whole_report
from test_ranking import costing as run
from test_ranking import scenes_of

from bench.results.records import MethodFacts, Plan
from bench.results.store import Store
from reports.charts.maps import method_strip
from reports.charts.mechanism import mechanism, motion
from reports.pages.html_report import write_html_report
from reports.pages.markdown_report import write_markdown_report
from reports.pages.site_data import _short
from reports.ranking import answers
from reports.scenes import StoredRuns
from reports.tables.glossary import TERMS, terms_in
from reports.tables.scene_tables import mathml, unknowns
from reports.verdicts import method_card
from reports.wrong import wrong_runs

LONG = "generalized_alpha[rho_inf=0.8,formulation=stabilised_index2,newton=modified]"


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """A report of a plugin and of a method with a long name; the pendulum cannot be judged."""

    def edit(record):
        if record.integrator == "poor":
            record.integrator = LONG
        if record.problem == "pendulum":
            record.reference_error = {g: {"max": 2e-5} for g in record.errors}

    planted = plant(tmp_path_factory.mktemp("details") / "first", everything())
    folder = edited(planted, planted.with_name("out"), edit)
    with Store(folder, create=True) as store:
        facts = MethodFacts(title="Mine.", sources=frozenset({"/of/mine/my method.py"}))
        plan = store.plan()
        known = {r.integrator: facts for r in store.records().values() if r.integrator != LONG}
        store.keep(msgspec.structs.replace(plan, integrators=known, mine=LONG))
        for scene in store.scenes().values():
            scene.description = "Like ``slider_crank_minimal``; a and lam ring."
            scene.source = "A (1985), doi:10.1016/0377-0427(85)90008-1: <i>; B, doi:10.1/x."
            scene.equations = ["0 = Phi(q, t)"]
            store.keep(scene)
    write_html_report(folder)
    write_markdown_report(folder)
    return folder


def page(folder: Path, name: str) -> str:
    (path,) = (folder / "report").glob(name)
    return path.read_text(encoding="utf-8")


def test_pages_have_commands_code_symbols_terms_and_dois(folder):
    html, option = page(folder, "scene-pendulum.html"), " --plugins &#39;my method.py&#39;"
    command = f"stepbench stability &#34;good[rho_inf=0.8]&#34;{option}"
    assert command in page(folder, "method-good?rho_inf=0.8?.html")
    assert option not in page(folder, "method-generalized_alpha*.html")
    plugins = {m["label"]: m["plugins"] for m in page_data(folder)["methods"]}
    assert plugins["good[rho_inf=0.8]"] == " --plugins 'my method.py'"
    assert plugins[LONG] == ""
    assert "Like <code>slider_crank_minimal</code>; a and λ ring." in html
    assert "<mi>Φ</mi>" in html
    # A cell is as wide as the name that it shows.
    assert '<td class=""><a class="named" href="method-' in html
    assert '<td class="name"><a class="named"' not in html
    link = "https://doi.org/10.1016/0377-0427(85)90008-1"
    assert f'<a href="{link}" rel="noreferrer">doi:{link[16:]}</a>: &lt;i&gt;;' in html
    used = re.findall(r'class="term" href="glossary.html#(term-[^"]+)" title="([^"]+)"', html)
    assert len({anchor for anchor, _ in used}) == len(used) > 5  # the first use alone
    definitions = {term.anchor: term.definition for term in TERMS}
    for anchor, said in used:
        assert said == definitions[anchor].replace("'", "&#39;")


def test_a_page_of_a_method_has_its_chart_and_the_front_page_knows_the_own_one(folder):
    text = page(folder, "method-generalized_alpha*.html")
    ((name, chart),) = Document(text).charts.items()
    assert f'id="{name}"' in text
    assert f'data-highlight="{LONG}"' in text
    rows = chart_rows(chart, "strip")
    assert {r["scene"] for r in rows} == {"spring mass"}
    assert page_data(folder)["first"]["highlight"] == LONG
    plan = Plan(name="", title="", samples=1, budget_s=1.0, studies=[], mine="never_run")
    assert StoredRuns("", {}, {}, {}, plan=plan).mine == ""


def test_markdown_has_short_names_code_and_what_cannot_be_judged(folder):
    index, scene = (folder / "report.md").read_text("utf-8"), page(folder, "scene-pendulum.md")
    reason = "cannot be judged: the reference's own error there is 2e-5, more than a hundredth of"
    assert all(f"{reason} 1e-4" in text for text in (index, scene))
    assert "Like `slider_crank_minimal`; a and λ ring." in scene
    assert f"- gα 0.8 · GGL · modified: `{LONG}`" in index
    assert index.count(LONG) == 1
    assert not any(name in scene for name in (LONG, "| good[rho_inf=0.8]"))
    assert "| good 0.8 |" in scene
    assert "| spring mass |" in index


def strip(label, records):
    """{(scene, column): (state, text)} of the strip of an integrator."""
    scenes = scenes_of(records)
    found = [a for q, a in answers(scenes, ["a"]).items() if q.cost == "residuals"]
    wrong = wrong_runs(StoredRuns("", scenes, {}, {}), "a", label)
    chart = method_strip(label, found, wrong)
    if chart is None:
        return None
    altair.LayerChart.from_dict(chart, validate=True)
    assert vl_convert.vegalite_to_svg(chart).count('fill="#1a7f5a"') > 1  # in cells, too
    rows = chart_rows(chart, "strip")
    return {(r["scene"], r["target"]): (r["state"], r["text"]) for r in rows}


def test_the_strip_has_a_state_for_each_scene_and_accuracy():
    records = [
        *(run("won", n, c) for n, c in (("me", 10), ("other", 25))),
        *(run("tied", n, 10) for n in ("me", "other")),
        *(run("lost", n, c) for n, c in (("me", 25), ("other", 10))),
        run("lost", "me", 5, error=2.0, h=0.1),
        run("lost", "me", 6, error=2.0, h=0.05, message="It is wrong."),
        run("died", "me", 1, status="newton_failed"),
        run("died", "other", 1),
        run("single_one", "me", 7),
        run("foreign", "other", 7),
    ]
    found = strip("me", records)
    assert {k: state for (k, t), state in found.items() if t == "1e-4"} == {
        "won": ("cheapest alone", ""),
        "tied": ("tied for the cheapest", ""),
        "lost": ("dearer, by this factor", "2.5"),
        "died": ("no run reaches the end", ""),
        "single one": ("reached, with none to compare", ""),
    }
    assert found["won", "1e-6"] == ("not reached", "")
    assert {k: v for k, v in found.items() if k[1] in ("wrong", "warned")} == {
        ("lost", "wrong"): ("runs silently wrong", "1 of 3"),
        ("lost", "warned"): ("runs wrong with a warning", "1 of 3"),
    }
    assert len(found) == 5 * 9 + 2
    assert strip("nobody", records) is None


def test_the_card_of_a_method_says_where_it_wins_loses_and_fails(tmp_path):
    plant(tmp_path, everything())
    reaches = "reaches 1e-4 in acceleration (largest over time) on"
    assert method_card(tmp_path, "good[rho_inf=0.8]") == [
        f"good 0.8 (index 3) {reaches} 2 of 2 scenes tried.",
        "Cheapest alone by operations: spring mass.",
        "More operations than the cheapest: pendulum (1.92 times the cost of adaptive).",
        "All of its runs reached the end.",
    ]
    assert method_card(tmp_path, "poor") == [
        f"poor {reaches} 0 of 1 scene tried.",
        "Does not reach it: spring mass (smallest error: 0.00938).",
        "Silently wrong, sometimes: spring mass.",
        "These are 2 of 6 runs that reached the end (error in acceleration above 0.1, "
        "largest over time).",
    ]
    assert method_card(tmp_path, "fragile")[1:] == [
        "Fails: pendulum (2 newton failed).",
        "2 of its 2 runs on all scenes failed.",
    ]


def test_an_equation_in_plain_text_is_typeset():
    for text, parts in [
        ("M(q) a = g - Phi_q^T lam", {"msubsup": ["Φ q T"], "mi": ["M", "λ"], "mo": ["−"]}),  # noqa: RUF001
        ("xdot = f(x)", {"mover": ["x ˙"], "mi": ["f", "x"]}),
        ("0 = a^2 <b>", {"mn": ["0", "2"], "msup": ["a 2"], "mo": ["<", ">"]}),
        ("x_", {"mi": ["x"], "mo": ["_"]}),
    ]:
        tree = ElementTree.fromstring(str(mathml(text)))
        for tag, wanted in parts.items():
            found = [" ".join(node.itertext()) for node in tree.iter(tag)]
            assert set(wanted) <= set(found), tag
        written = "".join(tree.itertext())
        for word, symbol in (("Phi", "Φ"), ("lam", "λ"), ("-", "−"), ("xdot", "x˙")):  # noqa: RUF001
            text = text.replace(word, symbol)
        assert written == re.sub(r"[\s_^](?=.)|\s", "", text)


def test_unknowns_are_counted_and_none_is_named_that_is_not_there(tmp_path):
    with Store(plant(tmp_path, everything())) as store:
        by_name = {scene.problem: scene for scene in store.scenes().values()}
    assert unknowns(by_name["pendulum"]) == "2 coordinates q, 1 multiplier λ"
    assert "multiplier" not in unknowns(by_name["spring_mass"])


def test_every_term_is_one_sentence_and_is_found_in_texts():
    anchors = [term.anchor for term in TERMS]
    assert len(set(anchors)) == len(anchors)
    assert [t.name.lower() for t in TERMS] == sorted(t.name.lower() for t in TERMS)
    for term in TERMS:
        assert re.fullmatch(r"[A-Z].*[a-z0-9%)]\.", term.definition)
        assert not re.search(r"\. [A-Z]", term.definition)
        for form in (term.name, term.name.lower(), f"{term.name}s"):
            assert [t for _, _, t in terms_in(f"the {form}, then")] == [term]
    found = terms_in("modified Newton on index 3, in the last quarter")
    assert [t.name for _, _, t in found] == ["Newton iteration", "Index", "Settled"]
    assert list(terms_in("reordered in the normal border by order statistics")) == []


def test_one_file_holds_all_pages_and_nothing_beside_it(tmp_path):
    folder = plant(tmp_path, everything())
    write_html_report(folder)
    many = whole_report(folder)
    (folder / "report").rename(folder / "gone")
    text = write_html_report(folder, single_file=True).read_text(encoding="utf-8")
    assert not (folder / "report").exists()
    places = Document(text).places
    assert all(place.startswith(("#", "data:", "https://doi.org/")) for _, place in places)
    ids = re.findall(r' id="([^"]+)"', text)
    assert len(ids) == len(set(ids))
    assert {place[1:] for _, place in places if place.startswith("#")} <= set(ids)
    assert set(re.findall(r"<caption[^>]*>(.*?)</caption>", many)) == set(
        re.findall(r"<caption[^>]*>(.*?)</caption>", text)
    )


def test_a_scene_is_played_from_its_drawings_and_shown_at_few_times():
    drawings = [
        {"t": k / 10, "lines": [[[0.0, 0.0], [1.0, k / 60]], [[None, 1.0]]]} for k in range(61)
    ]
    played = motion(drawings)
    assert played
    assert len(played.frames) == 61
    assert played.frames[60]["lines"][0] == [(0.0, 0.0), (1.0, -1.0)]
    assert played.still == "M0 0L1 -1"
    assert motion([{"t": 0.0, "lines": [[]]}]) is None
    chart = mechanism(drawings)
    assert chart
    rows = next(iter(chart["datasets"].values())).splitlines()[1:]
    assert len({row.split(",")[0].split(".")[0] for row in rows}) == 7


@given(st.floats(1e-9, 1e9), st.integers(100, 999), st.integers(-2, 6), st.sampled_from([5, 7]))
def test_scripts_show_the_three_digits_that_python_does(value, digits, power, kept):
    for number in (value, 10.0**power * (10 * digits + 5) / 10):  # and halves between three digits
        shown = Decimal(_short(number, kept))  # a script rounds halves up
        place = Decimal(1).scaleb(shown.adjusted() - 2)
        assert float(shown.quantize(place, ROUND_HALF_UP)) == float(f"{number:.3g}")
