"""The summary card: its words and numbers are those of the answer, and nothing overlaps."""

from __future__ import annotations

import itertools
import struct
from dataclasses import replace
from xml.etree import ElementTree

import pytest
from chromium import chromium, in_chromium
from click.testing import CliRunner
from planted import everything, plant
from test_questions import run, scenes_of

from bench.commands.main import main
from bench.results.records import Environment, Plan
from problems.spec import SpecError
from reports.charts.line_styles import style_of
from reports.charts.svg_text import Box, fitted, text_width
from reports.pages.card import HEIGHT, WIDTH, _paragraphs, card_svg, write_card
from reports.questions.answers import answer
from reports.questions.phrases import plain
from reports.questions.question import Question
from reports.questions.sentences import sentences
from reports.questions.words import words_of
from reports.scenes import StoredRuns, stored_runs

COUNTS = Question("a", 1e-4, "residuals")
SVG = "{http://www.w3.org/2000/svg}"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return plant(tmp_path_factory.mktemp("planted"), everything())


def texts(content: str) -> list[tuple[str, dict[str, str]]]:
    """The lines of text with their attributes."""
    root = ElementTree.fromstring(content)
    return [("".join(e.itertext()), e.attrib) for e in root.iter(f"{SVG}text")]


def boxes(content: str) -> list[tuple[str, float, float, float, float]]:
    """Each line of text with its left, right, upper and lower end."""
    found = []
    for said, a in texts(content):
        size, x, y = (float(a[k]) for k in ("font-size", "x", "y"))
        width = text_width(said, size, a.get("font-weight") == "bold")
        x -= width * {"start": 0.0, "middle": 0.5, "end": 1.0}[a.get("text-anchor", "start")]
        found.append((said, x, x + width, y - 0.75 * size, y + 0.1 * size))
    return found


def check_places(found):
    for said, left, right, top, bottom in found:
        assert left >= 40, said
        assert right <= WIDTH - 40, said
        assert (top >= 0, bottom <= HEIGHT) == (True, True), said
    for one, two in itertools.combinations(found, 2):
        apart = one[2] <= two[1] or two[2] <= one[1] or one[4] <= two[3] or two[4] <= one[3]
        assert apart, (one, two)


def stored(records, title="A suite"):
    machine = Environment(
        date="2025-03-01T10:00:00+00:00", command="", cpu="Model 1", cores=8, memory_gib=1.0,
        platform="Linux", versions={},
    )  # fmt: skip
    return StoredRuns(title, scenes_of(records), {}, {1: machine})


def card_of(records, title="A suite", question=COUNTS):
    runs = stored(records, title)
    return card_svg(runs, answer(runs.series, question), "all")


def many(names=("one", "two", "three"), scenes=12):
    """Scenes on which the first one wins but for the first two: there are a tie and a miss."""
    costs = [(50, 50, 90), (None, 30, 60), *[(10, 20, 30)] * (scenes - 2)]
    return [
        run(f"s{k}", name, cost or 1, error=1e-5 if cost else 1e-2)
        for k, own in enumerate(costs)
        for name, cost in zip(names, own, strict=True)
    ]


def test_the_sentences_of_the_card_are_those_of_the_answer(folder, tmp_path):
    for form in ({}, {"group": "lam", "target": 1e-2, "cost": "residuals"}):
        content = write_card(folder, tmp_path / "card.svg", **form).read_text(encoding="utf-8")
        runs = stored_runs(folder)
        question = Question(*({"group": "a", "target": 1e-4, "cost": "operations"} | form).values())
        words = words_of(runs.series, runs.tags)
        told = [plain(s) for s in sentences(answer(runs.series, question), words)[:3]]
        shown = " ".join(said for said, _ in texts(content))
        assert told
        assert all(sentence in shown for sentence in told)
        root = ElementTree.fromstring(content)
        assert " ".join(told) in (root.findtext(f"{SVG}desc") or "")
        assert (root.attrib["width"], root.attrib["height"]) == (str(WIDTH), str(HEIGHT))
        assert "2025-03-01 · Model 1, 8 cores" in shown
        assert "measured by stepbench" in shown
        check_places(boxes(content))


def test_many_scenes_are_counted_in_bars():
    content = card_of(many())
    shown = [said for said, _ in texts(content)]
    for name, counts in (
        ("one", "first on 11 scenes, reaches 11 of 12"),
        ("two", "first on 2, reaches 12 of 12"),
        ("three", "first on 0, reaches 12 of 12"),
    ):
        assert shown[shown.index(name) + 1] == counts
    bars = [e.attrib for e in ElementTree.fromstring(content).iter(f"{SVG}rect")]
    own = [float(b["width"]) for b in bars if b["height"] == "14"]
    unit = own[0] / 12
    assert [round(w / unit) for w in own] == [12, 11, 11, 10, 12, 12, 2, 1, 12, 12]
    check_places(boxes(content))


def owned(records, mine, scenes=12):
    """The card of a run with an integrator of the person's own."""
    plan = Plan(name="p", title="", samples=1, budget_s=1.0, studies=[], mine=mine)
    runs = replace(stored(records), plan=plan)
    return card_svg(runs, answer(runs.series, COUNTS), "all")


def test_the_own_integrator_is_named_and_marked():
    names = [f"m{k:02}" for k in range(10)]
    records = [run(f"s{k}", n, 10 + j) for k in range(8) for j, n in enumerate(names)]
    content = owned(records, "m09")
    shown = [said for said, _ in texts(content)]
    assert [name for name in shown if "m0" in name][-1] == "► m09"
    assert ("m06" in shown, "m07" in shown, "2 more" in shown) == (True, False, True)
    told = " ".join(shown)
    assert "m09 reaches 1e-4 in acceleration (largest over time) on 8 of 8 scenes tried." in told
    check_places(boxes(content))
    first = [said for said, _ in texts(owned(records, "m00"))]
    assert (first[first.index("► m00") + 1], "m07" in first) == (
        "first on 8 scenes, reaches 8 of 8", True
    )  # fmt: skip
    assert "►" not in owned(records, "")
    assert "►" not in owned(records, "never_run")
    few = owned(many(scenes=3), "three")
    assert "► three" in [said for said, _ in texts(few)]
    check_places(boxes(few))
    lines = [e.attrib for e in ElementTree.fromstring(few).iter(f"{SVG}polyline")]
    own = [e["stroke-width"] for e in lines if e["stroke"] == style_of("three").color]
    assert own == ["3"] * 3


def test_two_groups_at_once_have_a_card(folder, tmp_path):
    result = CliRunner().invoke(
        main,
        ["card", str(folder), "--group", "a,lam", "--target", "0.1", "-o", str(tmp_path / "c.svg")],
    )
    assert result.exit_code == 0, result.output
    shown = " ".join(said for said, _ in texts((tmp_path / "c.svg").read_text(encoding="utf-8")))
    assert "Error at most 1e-1 in acceleration and multiplier (largest over time)" in shown
    assert "spring mass" not in shown  # it has no multiplier


def test_panels_of_few_scenes_name_the_cheapest_and_mark_its_run():
    content = card_of(many(scenes=3))
    found = boxes(content)
    winners = {
        scene: next(w[0] for w in found if w[2] > WIDTH / 2 and w[3] == top and w[1] > right)
        for scene, _, right, top, _ in found
        if scene in ("s0", "s1", "s2")
    }
    assert winners == {"s0": "one, two", "s1": "two", "s2": "one"}
    assert content.count("<circle") == 4
    check_places(found)
    tops, right = {w[3] for w in found if w[0] in winners}, max(w[2] for w in found)
    assert len(tops) == 2  # the third scene has the second row for itself
    assert [w for w in found if w[0] == winners["s2"] and w[2] == right]
    assert "not reached" in card_of([run("s", n, 9, error=1.0) for n in ("one", "two")])


@pytest.mark.parametrize("scenes", [1, 2, 3, 6, 7, 30])
def test_long_names_stay_within_the_card(scenes):
    names = [f"method_{'of_a_long_name_' * 4}{k}" for k in range(3)]
    records = [
        run(f"scene_{'W' * 60}_{k}", name, 10 + k, error=10.0 ** -(k % 12))
        for k in range(scenes)
        for name in names
    ]
    content = card_of(records, "A title & <b>that</b> never ends \x1b \ud800" + "W " * 60)
    check_places(boxes(content))
    assert "…" in content


def test_long_sentences_are_smaller_and_complete():
    said = [("To 1e-4 " + "all of them tie and so on " * 12,)] * 2
    shown = "".join(_paragraphs(said, Box(0, 0, 560, 400)))
    lines = texts(f'<svg xmlns="http://www.w3.org/2000/svg">{shown}</svg>')
    assert " ".join(words for words, _ in lines) == " ".join(" ".join(s).strip() for s in said)
    assert 15 <= float(lines[0][1]["font-size"]) < 24


def test_text_that_is_too_wide_ends_in_an_ellipsis():
    assert fitted("short", 10, 100) == "short"
    cut = fitted("a long text", 10, 40)
    assert (cut[-1], text_width(cut, 10) <= 40) == ("…", True)


def test_a_png_has_the_size_of_the_card(folder, tmp_path):
    content = write_card(folder, tmp_path / "card.png").read_bytes()
    assert content[:8] == b"\x89PNG\r\n\x1a\n"
    assert struct.unpack(">II", content[16:24]) == (WIDTH, HEIGHT)


@pytest.mark.parametrize(
    ("given", "reason"),
    [
        (["-o", "card.pdf"], "card.pdf is no card; give a name that ends in .svg and .png"),
        (["--group", "b"], "There is no group 'b'"),
        (["--target", "2e-4"], "0.0002 is no target; give one of 1e-1, 1e-2 ... 1e-9"),
        (["--cost", "second"], "There is no cost 'second'; did you mean 'seconds'?"),
        (["--scenes", "stiff"], "There is no set of scenes 'stiff'"),
        (["--group", "lam", "--target", "1e-9", "--scenes", "none"], "There is no set of scenes"),
    ],
)
def test_wrong_input_is_refused_in_a_sentence(folder, tmp_path, monkeypatch, given, reason):
    monkeypatch.chdir(tmp_path)
    result = CliRunner().invoke(main, ["card", str(folder), *given])
    assert result.exit_code == 1
    assert reason in result.output


def test_there_is_no_card_without_an_answer():
    vague = [run("s", n, 10, reference_error={"a": {"max": 1e-5}}) for n in ("one", "two")]
    with pytest.raises(SpecError, match="nothing to show on a card: 1e-4 cannot be judged on s"):
        card_of(vague)


@pytest.mark.long
@in_chromium
def test_a_browser_needs_no_more_room_than_was_measured(tmp_path):
    (tmp_path / "card.svg").write_text(card_of(many()), encoding="utf-8")
    with chromium() as page:
        page.get((tmp_path / "card.svg").as_uri())
        taken = page.execute_script(
            "return [...document.querySelectorAll('text')]"
            ".map((t) => [t.textContent, t.getBBox().width])"
        )
    measured = [(right - left) for _, left, right, _, _ in boxes(card_of(many()))]
    assert len(taken) == len(measured)
    for (said, width), room in zip(taken, measured, strict=True):
        assert width <= 1.13 * room, said  # a line with bold words is measured as if it had none
