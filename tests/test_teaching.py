"""Terms, DOIs, equations and animations on the pages of a report."""

from __future__ import annotations

import re
from xml.etree import ElementTree

from planted import Document, everything, plant, whole_report

from bench.results.store import Store
from reports.charts.mechanism import mechanism, motion
from reports.pages.html_report import write_html_report
from reports.tables.glossary import TERMS, terms_in
from reports.tables.scene_tables import mathml, unknowns


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
