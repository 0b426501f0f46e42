"""Answers that the page finds from its runs, beside Python's; what is typed is kept."""

from __future__ import annotations

import math

import pytest
from chromium import chromium, in_chromium, waited
from helpers import long
from test_recount import odd_runs, run, write_odd

from bench.results.quantities import NORM, NORMS, RANKED_COSTS
from reports.pages.html_report import write_html_report
from reports.pages.report import read_report
from reports.questions.answers import answers
from reports.questions.cheapest import headline
from reports.questions.phrases import plain
from reports.questions.question import TARGETS, questions

#: Accuracies of the menu and others, some of which are the error of a run.
ACCURACIES = (*TARGETS, 3e-4, 2.5e-3, 0.5, 7e-12)
ASK = """
const [group, target, norm, cost] = arguments;
stepbench.ask({ group, target, norm, cost, scenes: "all" });
const own = stepbench.answer();
const text = (part) => typeof part === "string" ? part : part.text;
return { ...own, filters: Object.fromEntries(Object.entries(own.filters).map(
  ([id, { headline, standings }]) => [id, [headline.map(text).join(""), standings]])) };
"""


def norms_apart():
    """Runs whose errors differ by norm; some on an accuracy or beside it, some at no cost."""
    records = odd_runs()
    records += [run("edge", f"m{k}", 100 - k, 1e-4 * (1 + 1e-7 * k)) for k in (-1, 0, 1)]
    records += [run("free", name, cost) for name, cost in (("one", 0), ("two", 7), ("three", 0))]
    # Two runs at one cost, of which the coarser counts; two with a time each, which tell nothing.
    records += [
        run("same", "one", 50, 1e-6, h=0.005),
        run("same", "one", 50),
        run("same", "two", 9),
    ]
    records += [run("single", f"timed once {k}", 100**k) for k in (1, 2)]
    for record in records:
        if record.problem != "twins":
            for k, group in enumerate(record.errors):
                own = record.errors[group]["max"]
                factors = (3.7, 0.21, 0.07 ** (1 + (len(record.integrator) + k) % 3))
                record.errors[group] |= {
                    norm: own * f
                    for norm, f in zip(("end", "rms", "settled"), factors, strict=True)
                }
    copied = next(r for r in records if r.problem == "twins")
    copied.errors["a"] |= {"rms": 1e-2}
    return records


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = write_odd(tmp_path_factory.mktemp("any"), norms_apart())
    write_html_report(path)
    return path


@pytest.fixture(scope="module")
def page():
    with chromium() as driver:
        yield driver


def visit(page, file, fragment=""):
    page.get("about:blank")
    page.get(file.as_uri() + fragment)
    waited(lambda: page.execute_script("return stepbench.data.complete"))
    assert page.get_log("browser") == []


def near(shown, counted):
    """Whether a multiple of the page, of numbers with five digits, is the one that was counted."""
    return math.isclose(shown, min(counted, 1e40), rel_tol=5e-5)


@in_chromium
@pytest.mark.parametrize("norm", ["settled", *long(*(n for n in NORMS if n != "settled"))])
def test_the_page_finds_the_answers_that_python_finds(page, folder, norm):
    report = read_report(folder, interactive=False)
    visit(page, folder / "report.html")
    data = page.execute_script("return stepbench.data")
    names = [m["label"] for m in data["methods"]]
    groups = list(data["group_names"])
    counted = answers(report.series, groups, ACCURACIES, norm)
    assert len(counted) == len(groups) * len(ACCURACIES) * len(RANKED_COSTS)
    for question in questions(groups, ACCURACIES):
        found = counted[question]
        shown = page.execute_script(
            ASK, question.group, f"{question.target:g}", norm, question.cost
        )
        for scene, own in zip(report.series, shown["scenes"], strict=True):
            where, python = (question, scene), found.scenes.get(scene)
            assert (own is None) == (python is None), where
            if not python:
                continue
            states = {names[k]: s for k, s in enumerate(own["states"]) if s is not None}
            assert states.keys() == python.entries.keys(), where
            for label, entry in python.entries.items():
                state = states[label]
                if isinstance(entry.state, str):
                    assert state == entry.state, (*where, label)
                else:
                    runs = next(s for s in report.series[scene] if s.label == entry.contestant)
                    assert near(state[0], entry.state), (*where, label)
                    assert runs.records[state[1]].key == entry.run.key, (*where, label)
            assert [names[k] for k in own["first"]] == python.winners, where
            second = own["second"]
            assert (second and names[second[0]]) == (python.second and python.second.label), where
            assert not second or near(second[1], python.second.ratio), where
        for chosen in data["filters"]:
            own = found.on(data["scenes"][k]["id"] for k in chosen["scenes"])
            said, rows = shown["filters"][chosen["id"]]
            assert said == plain(headline(own, report.words)), (question, chosen["id"])
            assert {names[k]: row for k, *row in rows} == {
                s.label: [s.alone, s.tied, s.reached, s.tried] for s in own.standings
            }, question


@in_chromium
def test_an_accuracy_is_typed_and_kept(page, folder):
    visit(page, folder / "report.html", "#group=a&target=0.0003&cost=residuals&norm=rms")

    def typed(text):
        return page.execute_script(
            """
            const place = document.querySelector("[name=target]");
            place.value = arguments[0];
            place.dispatchEvent(new Event("change", { bubbles: true }));
            const said = document.querySelector("#question output").textContent;
            return [stepbench.question.target, said];
            """,
            text,
        )

    assert page.execute_script("return [stepbench.question.target, stepbench.question.norm]") == [
        "3e-4",
        "rms",
    ]
    assert "largest over time" in page.execute_script(
        "return document.querySelector('#answer details').textContent"
    )
    for text, target in (("0.002", "2e-3"), (" 5E-7 ", "5e-7"), ("1.25e-3", "1.25e-3")):
        assert typed(text) == [target, ""]
    for text in ("", "much", "0", "-1", "1", "1e-13", "1e-4 m", "Infinity"):
        kept, said = typed(text)
        assert kept == "1.25e-3"
        assert said.count(".") >= 1
    address = page.execute_script("return location.hash")
    assert "target=1.25e-3" in address
    assert "norm=rms" in address


@in_chromium
def test_links_keep_the_question_from_page_to_page(page, folder):
    asked = "group=q&target=3e-4&norm=end&cost=residuals"
    visit(page, folder / "report.html", f"#{asked}")
    links = page.execute_script("return [...document.links].map((a) => a.getAttribute('href'))")
    own = [a for a in links if ".html" in a and not a.startswith("http")]
    assert own
    assert all(asked in a for a in own if "#" not in a or "#group" in a)
    scene = next(a for a in own if "scene-won" in a)
    page.get(f"{folder.as_uri()}/{scene}")
    assert page.execute_script("return location.hash").startswith(f"#{asked}")
    file = folder / "report" / "scene-won.html"
    # A page that was reached by an anchor remembers it, and so does one without a bar.
    page.get(file.as_uri() + "#run-1")
    assert page.execute_script("return stepbench.question.target") == "3e-4"
    page.get(file.as_uri() + "#target=1e-2")
    assert page.execute_script("return stepbench.question.target") == "1e-2"
    page.get((folder / "report" / "glossary.html").as_uri())
    links = page.execute_script("return [...document.links].map((a) => a.getAttribute('href'))")
    assert any("scene-won" in a and "target=1e-2" in a for a in links)


@in_chromium
def test_the_command_of_a_scene_follows_the_question(page, folder):
    file = folder / "report" / "scene-won.html"
    found = []
    for target in ("1e-4", "1e-6", "1e-9"):
        visit(page, file, f"#group=a&target={target}&cost=residuals")
        found.append(
            page.execute_script(
                "const code = document.querySelector('[data-try]');"
                "const note = code.closest('section').querySelector('.note');"
                "return [code.textContent, note.textContent];"
            )
        )
    assert [text for text, _ in found] == [
        "stepbench solve won one --step 0.01 --t-end 1",
        "stepbench solve won two --step 0.001 --t-end 1",
        "stepbench solve won two --step 0.001 --t-end 1",
    ]
    assert "verdict" in found[0][1]
    assert "No integrator reaches 1e-9" in found[2][1]
    assert "1.0e-8" in found[2][1] or "1e-8" in found[2][1]


def test_python_takes_the_norm_of_a_question(folder):
    report = read_report(folder, interactive=False)
    usual, other = (answers(report.series, ["a"], [1e-4], norm) for norm in (NORM, "rms"))
    assert usual.keys() == other.keys()
    assert any(usual[q].standings != other[q].standings for q in usual)
