"""The guide to choosing an integrator: counted again from planted records, and true in words."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest
from planted import edited, everything, plant, planted

from bench.results.records import Environment, Record, SceneRecord, endings
from bench.running.scene_records import scene_record
from problems.scenes.pendulum import Pendulum
from reports.pages.choosing import choosing_in_markdown, heading_anchor, measured_with, sections
from reports.questions.advice import by_both, on_costs, on_energy, on_scenes
from reports.questions.answers import answers
from reports.questions.kinds import KINDS, scenes_of_kind
from reports.questions.phrases import plain
from reports.questions.question import Question
from reports.questions.words import words_of
from reports.scenes import stored_runs
from reports.series import series_of

PAGE = Path(__file__).parents[1] / "docs" / "choosing.md"


@pytest.fixture(scope="module")
def store(tmp_path_factory) -> Path:
    return plant(tmp_path_factory.mktemp("guide") / "store", everything())


def advice(folder: Path, key: str):
    found = {a.key: a for s in sections(stored_runs(folder)) for a in s.advice}
    return found[key]


def said(folder: Path, key: str) -> list[str]:
    return [plain(s) for paragraph in advice(folder, key).paragraphs for s in paragraph]


def scene(name: str, *tags: str, **sizes: int) -> SceneRecord:
    return SceneRecord(problem=name, t0=0.0, t_end=1.0, tags=list(tags), sizes=sizes)


def test_each_kind_has_its_scenes():
    scenes = {
        "free": scene("free", "smooth", nq=1),
        "stiff": scene("stiff", "stiff", "conservative", nq=1),
        "loop": scene("loop", "stiff controller states", nq=1, nx=2, ny=1),
        "rod": scene("rod", nq=2, nl=1),
        "top": scene("top", "singular mass", nq=3, nl=1),
        "twice": scene("twice", "redundant", nq=2, nl=2),
        "long": scene("long", nq=80, nl=40),
    }
    assert {kind.key: scenes_of_kind(kind, scenes) for kind in KINDS} == {
        "smooth": ["free"],
        "stiff": ["stiff", "loop"],
        "constrained": ["rod", "top", "long"],
        "singular": ["top", "twice"],
        "controlled": ["loop"],
        "large": ["long"],
        "conservative": ["stiff"],
    }


def test_a_constraint_stated_twice_is_redundant():
    def tags(scene):
        return scene_record(scene, 1.35, lambda: None, lacking="It is not needed.").tags

    assert tags(Pendulum(copies=2)) == [*tags(Pendulum()), "redundant"]


@pytest.mark.parametrize("target", [1e-2, 1e-4])
def test_the_table_has_the_least_cost_and_its_multiples(store, target):
    table = advice(store, "constrained-a").tables[0]
    place = [1e-2, 1e-4, 1e-6].index(target)
    least: dict[str, float] = {}
    for r in everything():
        if r.problem == "pendulum" and r.status == "ok" and r.errors["a"]["max"] <= target:
            least[r.integrator] = min(r.cost("operations"), least.get(r.integrator, 1e99))
    names = words_of(stored_runs(store).series, {}).names
    rows = {row[0].removesuffix(" (index 3)"): row[1] for row in table.rows}
    assert rows["least"].split(" · ")[place] == f"{min(least.values()):.0f}"
    assert least
    for label, cost in least.items():
        shown = float(rows[names[label]].split(" · ")[place])
        assert shown == pytest.approx(cost / min(least.values()), rel=0.05)
    assert rows["fragile"] == "newton_failed"
    assert {"good 0.8 (index 3)", "adaptive"} <= {row[0] for row in table.rows}
    assert not any("far · far" in row for row in rows.values())
    failed = {row[0]: row[-1] for row in table.rows}
    assert failed["fragile"] == "2 of 2: newton_failed"
    assert failed["adaptive"] == "0"


def test_other_numbers_give_other_sentences(store):
    lead = "Cheapest to 1e-2 in acceleration: {} by operations and time on pendulum."

    def dearer(r):
        if r.integrator.startswith("good"):
            r.operations = {part: 100 * cost for part, cost in r.operations.items()}

    both = lead.format("good 0.8 (index 3) and ringing 1 (index 3)")
    assert said(store, "constrained-a")[0] == both
    changed = said(edited(store, "dearer", dearer), "constrained-a")
    assert changed[0] == lead.format("ringing 1 (index 3)")


def words_and_answers(runs: list[Record], targets: Sequence[float], cost: str = "seconds"):
    """What a guide says of, by one cost and the one beside it."""
    names = dict.fromkeys(r.problem for r in runs)
    scenes = {name: series_of(r for r in runs if r.problem == name) for name in names}
    words = replace(words_of(scenes, {}), brief=True)
    found = answers(scenes, ["a"], targets)
    return words, [own for question, own in found.items() if question.cost == cost]


def joined(dearer: int, least: float = 1e-6) -> list[str]:
    """The paragraphs for 1e-2, 1e-4 and 1e-6 in a, reached at 1, 1/2 and 1/4 s by two methods.

    The second run of the slower one costs ``dearer`` times the usual, the third errs by ``least``.
    """
    errors, runs = (1e-2, 1e-4, 1e-6), []
    for name, factors, last in (("one", (1, 1, 1), 1e-6), ("two", (10, 10 * dearer, 10), least)):
        for k, error in enumerate((*errors[:2], last)):
            run = planted("s", name, {}, h=2.0**-k, errors={"a": {"max": error}})
            run.operations = {"residuals": 100.0 * factors[k] * 2**k}
            run.run_s = [1e-3 * 2**k * (3 if name == "one" else 1)] * 6
            runs.append(run)
    words, own = words_and_answers(runs, errors)
    return [" ".join(map(plain, said)) for said in on_costs(own, words)]


def test_accuracies_with_one_answer_share_a_sentence():
    assert joined(1) == [
        "Cheapest to 1e-2, 1e-4 and 1e-6 in acceleration: two by time (3 times), one by operations "
        "(10 times) on s."
    ]
    assert joined(2) == [
        "Cheapest to 1e-2, 1e-4 and 1e-6 in acceleration: two by time (3 times), one by operations "
        "(10, 20 and 10 times) on s."
    ]
    assert joined(1, least=1e-5) == [
        "Cheapest to 1e-2 and 1e-4 in acceleration: two by time (3 times), one by operations "
        "(10 times) on s.",
        "Cheapest to 1e-6 in acceleration: one by time and operations on s.",
    ]


def both(**scenes: dict[str, tuple[float, float | None]]) -> str:
    """The sentence on scenes, with the operations and the seconds of their integrators."""
    runs = [
        planted(
            scene, name, {"a": (1e-5 * (1 + k), 0)}, h=0.1, operations={"residuals": operations},
            run_s=[seconds] * 6 if seconds else [],
        )
        for scene, own in scenes.items()
        for k, (name, (operations, seconds)) in enumerate(own.items())
    ]  # fmt: skip
    words, (found,) = words_and_answers(runs, [1e-4])
    (sentence,) = by_both(found, words)
    return plain(sentence).removeprefix("Cheapest to 1e-4 in acceleration: ")


def test_a_winner_is_named_where_time_and_operations_agree():
    one, two = {"a": (1.0, 1.0), "b": (2.0, 3.0)}, {"a": (2.6, 1.0), "b": (2.0, 2.1)}
    assert both(s=one) == "a by time and operations on s."
    assert both(s=two) == "a by time (2.1 times), b by operations (1.3 times) on s."
    # Whoever ties by one cost and is alone by the other is the winner.
    tied = {"a": (1.0, 1.05), "b": (2.0, 1.0)}
    assert both(s=tied) == "a by time and operations on s."
    # ... but not if it takes longer than the ties allow.
    assert both(s=tied | {"a": (1.0, 1.2)}) == (
        "b by time (1.2 times), a by operations (2 times) on s."
    )
    # The nearest of those who tie by the other cost is compared.
    three = {"a": (1.0, 5.0), "b": (1.05, 4.0), "c": (3.0, 1.0)}
    assert both(s=three) == "c by time (4 times), a and b by operations (3 times) on s."
    # Scenes with one verdict are together, those with a common winner first.
    assert both(s=two, t=one, u=one, w=two) == (
        "a by time and operations on t and u; "
        "a by time (2.1 times), b by operations (1.3 times) on s; "
        "a by time (2.1 times), b by operations (1.3 times) on w."
    )
    swapped = {"a": (2.0, 3.0), "b": (1.0, 1.0)}
    assert both(r=swapped, s=one, t=one) == (
        "a by time and operations on s and t; b by time and operations on r."
    )


def test_a_cost_that_is_not_known_names_nobody():
    untimed = {"a": (1.0, None), "b": (2.0, None)}
    assert both(s=untimed) == "a by operations on s."
    assert both(s=untimed | {"c": (3.0, 1.0)}) == "a by operations on s."
    assert both(s={"a": (1.0, None), "b": (2.0, 1.0), "c": (3.0, 2.0)}) == (
        "b by time, a by operations (2 times) on s."
    )
    assert both(s={"a": (1.0, 1.0)}) == (
        "To 1e-4 in acceleration, no scene has two methods to compare."
    )


def test_invocations_that_choose_from_a_suite_are_counted_with_the_whole():
    def made(command: str, date: str = "2025-03-01") -> Environment:
        machine = {"cpu": "Model 1", "cores": 2, "memory_gib": 1.0, "platform": ""}
        return Environment(date=date, command=command, versions={"stepbench": "1"}, **machine)

    whole, own = "stepbench run it", "stepbench run that -i ida"
    parts = ["stepbench run it -p 'a[b=2]' -i ida --out x", "stepbench run it --problem a"]
    head = "2025-03-01, stepbench 1, Model 1, 2 cores:"
    assert measured_with([made(c) for c in (f"{whole} --out y", *parts, own)]) == [
        f"{head} `{whole}`, and 2 times with a choice of scenes or integrators",
        f"{head} `{own}`",
    ]
    later = "2025-03-02T01:00"
    assert measured_with([made(whole), made(own, later), made(f"{whole} --samples 2")]) == [
        f"{head} `{whole}`",
        f"{head} `{whole} --samples 2`",
        f"{head.replace('01,', '02,')} `{own}`",
    ]


def test_nothing_is_recommended_where_nobody_reaches_it(store):
    def worse(r):
        for norms in r.errors.values():
            norms["max"] = 0.5

    folder = edited(store, "worse", worse)
    texts = said(folder, "constrained-a")
    assert any(
        "No integrator reaches 1e-2, 1e-4 and 1e-6 in acceleration" in text for text in texts
    )
    assert not any("heapest" in text for text in texts)
    assert any(
        "Every run wrong in acceleration without warning" in text and "0.5" in text
        for text in texts
    )
    table = advice(folder, "constrained-a").tables[0]
    assert {row[1] for row in table.rows[1:]} == {"far", "newton_failed"}


def test_energies_that_change_by_rounding_tie():
    series = series_of([planted("s", name, {}, h=0.1) for name in ("one", "two", "three")])
    words = words_of({"s": series}, {})
    drifts = {"s": {"one": 1e-15, "two": 3e-14, "three": 1e-3}, "t": {"one": 2e-3, "three": 1e-3}}
    question = Question("q", 1e-2, "operations")
    (sentence,) = on_energy(question, drifts, words)
    assert plain(sentence) == (
        "Among the cheapest runs that reach 1e-2 in position (largest over time), the energy "
        "changes least with one and two on s (below 1e-12); three on t (0.001)."
    )
    assert on_energy(question, {"s": {"one": 1e-3}}, words) == []


def test_few_scenes_are_called_few():
    assert plain(on_scenes([])) == "The run has no scene of this kind."
    assert plain(on_scenes(["s"])).endswith("One scene is too few for a general rule.")
    assert plain(on_scenes(["s", "t"])).endswith("Two scenes are too few for a general rule.")
    assert "rule" not in plain(on_scenes(["s", "t", "u"]))


def each_sentence_leads_to_a_table(text: str) -> int:
    named = [heading_anchor(title) for title in re.findall(r"^#+ (.*)$", text, re.MULTILINE)]
    anchors = set(named)
    assert len(anchors) == len(named)
    lines = [line for line in text.splitlines() if "[↓]" in line]
    for line in lines:
        assert line.startswith("- ")
        assert line.endswith(")")
        assert set(re.findall(r"\[↓\]\(#([\w-]+)\)", line)) <= anchors
    assert {heading_anchor(kind.name) for kind in KINDS} <= anchors
    return len(lines)


def test_the_page_names_its_run_and_every_sentence_leads_to_a_table(store):
    text = choosing_in_markdown(store)
    for words in ("2025-03-01", "Model 1, 8 cores", "`stepbench run planted`"):
        assert words in text
    assert f"planned runs measured: {endings(everything())}." in text
    assert each_sentence_leads_to_a_table(text) > 5


def test_the_page_of_the_documents_is_one():
    text = PAGE.read_text(encoding="utf-8")
    assert each_sentence_leads_to_a_table(text) > 15
    assert re.search(r"\d+ planned runs measured: \d+ ok", text)
    assert re.search(r"\d{4}-\d\d-\d\d, stepbench \d\S+, .+ cores: `stepbench run families", text)
    assert text.count("stepbench choose") >= 1


def test_the_command_writes_the_guide(store, stepbench, tmp_path):
    shown = stepbench("choose", store)
    assert shown.exit_code == 0
    assert shown.stdout == choosing_in_markdown(store)
    written = stepbench("choose", store, "-o", tmp_path / "guide.md")
    assert "Guide:" in written.stdout
    assert (tmp_path / "guide.md").read_text(encoding="utf-8") == shown.stdout


@pytest.mark.parametrize("made", [PAGE, PAGE.with_name("card_full.svg")])
def test_pages_and_pictures_are_not_older_than_the_last_minor_release(made):
    """`make pictures` makes them anew."""
    project = (PAGE.parents[1] / "pyproject.toml").read_text(encoding="utf-8")
    (now,) = re.findall(r'^version = "(\d+\.\d+)\.', project, re.M)
    assert {*re.findall(r"stepbench (\d+\.\d+)\.", made.read_text(encoding="utf-8"))} == {now}
