"""Answers that the page looks up, beside Python's; what is typed is kept."""

import math
from bisect import bisect_right

import pytest
from chromium import each, visit
from planted import answer, planted

from bench.results.quantities import COSTS, NORMS
from bench.results.records import INTERRUPTED, UNSUPPORTED, Plan, Rows, Study
from bench.results.store import Store
from bench.results.timings import LEAST_OF_FEW, by_round, quotient
from reports.formatting import number, times
from reports.pages.html_report import write_html_report
from reports.pages.report import read_report
from reports.questions import GRID, TARGETS, Question, plain
from reports.ranking import Answer, answers
from reports.series import series_of
from reports.verdicts import headline

NONE = Rows(t=[])
#: The answers of the page in one norm, and the profile over the decades.
ASK = """
const [group, norm] = arguments, found = {};
const text = (part) => typeof part === "string" ? part : part.text;
for (const cost in stepbench.data.cost_names) for (const { id } of stepbench.data.filters) {
  for (const target of stepbench.data.targets) {
    const question = { group, norm, cost, target };
    stepbench.question = { ...question, scenes: id, highlight: "" };
    const said = stepbench.headline(question).map(text).join("");
    const numbers = [stepbench.answer(question), stepbench.standings(question)];
    found[`${target} ${cost} ${id}`] = [...numbers, said];
  }
  found[`${cost} ${id}`] = stepbench.profile({ group, norm, cost });
}
return found;
"""


def run(scene, name, cost, error=1e-5, h=0.01, **changes):
    """A run with a number of residuals and an error in a; q tells methods apart."""
    errors = {"a": {"max": error}, "q": {"max": 1e-3 * sum(map(ord, name))}}
    known = {"errors": errors, "work": {"residuals": cost}, "run_s": []}
    known |= {"key": f"{scene} | {name} | {h}", "family": name.partition(" ")[0]}
    return planted(scene, name, {"a": (1, 2), "q": (1, 2)}, h=h, **(known | changes))


def odd_runs():
    """Every way in which a method can stand on a scene; errors differ by norm."""
    pair = "one", "two"
    records = [
        *(run("won", name, cost) for name, cost in (("one", 100), ("two", 250), ("far", 9))),
        run("won", "two", 900, 1e-8, h=0.001),
        *(run("tied", name, cost) for name, cost in (("one", 100), ("two", 100), ("three", 300))),
        *(run("near", name, cost) for name, cost in (("one", 100), ("two", 105), ("three", 120))),
        *(run("behind", name, cost) for name, cost in (("one", 105), ("two", 100))),
        *(run("dark", name, cost) for name, cost in (("one", 100), ("two", 50), ("unseen", None))),
        run("darkest", "unseen", None),
        run("darkest", "one", 10, 1e-2),
        run("alone", "one", 100),
        *(run("missed", name, 10, 3e-3) for name in pair),
        run("broken", "one", 100),
        *(run("coarse", n, 9, reference_error={"a": {"max": 2e-6}}) for n in pair),
        run("lucky", "one", 100, later=[{"a": 1e-5}, {"a": 1e-2}]),
        run("lucky", "two", 300, later=[{"a": 1e-5}, {"a": 1e-5}]),
        run("lucky", "three", 500, later=[{"a": 1e-5}, {"a": 1e-5}]),
        # Some on an accuracy or beside it, some at no cost.
        *(run("edge", f"m{k}", 100 - k, 1e-4 * (1 + 1e-7 * k)) for k in (-1, 0, 1)),
        *(run("free", name, cost) for name, cost in (("one", 0), ("two", 7), ("three", 0))),
        # Two runs at one cost, of which the more accurate counts; two that were timed but once.
        run("same", "one", 50, 1e-6, h=0.005),
        run("same", "one", 50),
        run("same", "two", 9),
        *(run("single", f"timed once {k}", 100**k) for k in (1, 2)),
        *(run("noisy", f"n{k}", cost) for k, cost in enumerate((102, 104, 118, 130, 220))),
    ]
    records[2].errors["a"]["max"] = 1e-2
    for name, status in {"two": "newton_failed", "cut": INTERRUPTED, "shy": UNSUPPORTED}.items():
        lost = {"status": status, "errors": {}, "message": "It takes no rods."}
        records.append(run("broken", name, None, **lost))
    for record in records:
        for k, group in enumerate(record.errors):
            own = record.errors[group]["max"]
            factors = (3.7, 0.21, 0.07 ** (1 + (len(record.integrator) + k) % 3))
            names = "end", "rms", "settled"
            record.errors[group] |= {n: own * f for n, f in zip(names, factors, strict=True)}
    return records


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A run folder with these records, their times, a plan and pages."""
    path, cells = tmp_path_factory.mktemp("any"), {}
    with Store(path, create=True) as store:
        for record in odd_runs():
            store.save(record, NONE)
            cells.setdefault(record.problem, []).append(record.key)
            name, cost = record.integrator, record.work["residuals"]
            samples = 1 if "once" in name else 4 if name == "n2" else 7
            for k in range(samples if cost and record.status == "ok" else 0):
                scatter = 0.1 * math.sin(5 * k + cost) if record.problem == "noisy" else 0.001 * k
                apart = 7 if name == "n3" else None  # rounds that no other has
                store.add_sample(record.key, k, 1e-6 * cost * (1 + scatter), apart)
        studies = [
            Study(title=k, problem=k, t_end=1.0, figures=[], cells=own) for k, own in cells.items()
        ]
        store.keep(Plan(name="odd", title="Odd", samples=3, budget_s=1.0, studies=studies))
    write_html_report(path)
    return path


def near(shown, counted):
    """Whether a multiple of the page, of numbers with five digits, is the one that was counted."""
    return math.isclose(min(shown, 1e40), min(counted, 1e40), rel_tol=5e-5)


def profile_of(found, chosen):
    """The numbers of pairs, of all and of each method, and their ratios, counted in Python."""
    scenes = [s for a in found for k, s in a.scenes.items() if k in chosen and len(s.entries) > 1]
    own = {}
    for scene in scenes:
        for label, entry in scene.entries.items():
            own.setdefault(label, []).append(entry.state)
    return len(scenes), own


def test_the_table_of_the_page_and_python_agree(browser, folder):
    report = read_report(folder)
    visit(browser, folder / "report.html")
    data = browser.execute_script("return stepbench.data")
    names = [m["label"] for m in data["methods"]]
    groups, ids = list(data["group_names"]), [s["id"] for s in data["scenes"]]
    assert list(map(float, data["targets"])) == list(GRID)
    counted = answers(report.series, groups, GRID, tuple(NORMS))
    assert len(counted) == len(groups) * len(GRID) * len(COSTS) * len(NORMS)
    asked = {
        key: browser.execute_script(ASK, *key)
        for key in dict.fromkeys((q.group, q.norm) for q in counted)
    }
    told = set()
    for question, found in counted.items():
        shown = asked[question.group, question.norm]
        for chosen in data["filters"]:
            kept = {ids[k] for k in chosen["scenes"]}
            own = Answer(question, {k: s for k, s in found.scenes.items() if k in kept}, {})
            key = f"{question.accuracy} {question.cost} {chosen['id']}"
            scenes, rows, said = shown[key]
            assert said == plain(headline(own, report.names)), (question, key)
            assert {names[k]: row for k, *row in rows} == {
                s.label: [s.alone, s.tied, s.reached, s.tried] for s in own.standings
            }, (question, key)
        for scene, own in zip(ids, scenes, strict=True):
            where, python = (question, scene), found.scenes.get(scene)
            assert (own is None) == (python is None), where
            if not python:
                continue
            states = {names[k]: s for k, s in enumerate(own["states"]) if s is not None}
            assert states.keys() == python.entries.keys(), where
            for label, entry in python.entries.items():
                state = states[label]
                told.add(str(entry.state))
                if isinstance(entry.state, str):
                    assert state == entry.state, (*where, label)
                else:
                    runs = entry.series.records
                    assert near(state[0], entry.state), (*where, label)
                    assert runs[state[1]].key == entry.run.key, (*where, label)
                    assert near(max(state[2], 1e-40), max(entry.value, 1e-40)), (*where, label)
            assert [names[k] for k in own["first"]] == python.tied, where
            assert {names[k] for k in own["later"]} == {*python.later}, where
            second = own["second"]
            assert (second is not None and names[second]) == (
                python.second is not None and python.second.label
            ), where
    assert told >= {"1.0", "2.5", "far", "failed", "unknown"}
    for (group, norm), shown in asked.items():
        for cost in COSTS:
            over = [counted[Question(group, t, cost, norm)] for t in TARGETS]
            for chosen in data["filters"]:
                pairs, ratios = profile_of(over, {ids[k] for k in chosen["scenes"]})
                drawn = shown[f"{cost} {chosen['id']}"]
                assert drawn["pairs"] == pairs
                lines = {line["method"]["label"]: line["parts"] for line in drawn["lines"]}
                assert lines.keys() == ratios.keys()
                for label, states in ratios.items():
                    known = sorted(s for s in states if not isinstance(s, str))
                    parts = [bisect_right(known, 10 ** (k / 10) * 1.00005) for k in range(31)]
                    assert lines[label] == pytest.approx([n / pairs for n in parts])


def test_an_accuracy_is_typed_and_kept(browser, folder):
    visit(browser, folder / "report.html", "#group=a&target=0.0003&cost=residuals&norm=rms")

    def typed(text):
        return browser.execute_script(
            """
            const place = document.querySelector("[name=target]");
            place.value = arguments[0];
            place.dispatchEvent(new Event("change", { bubbles: true }));
            const said = document.querySelector("#question output").textContent;
            return [stepbench.question.target, said];
            """,
            text,
        )

    assert browser.execute_script("return stepbench.question.target") == "2e-4"
    said = browser.execute_script("return document.querySelector('#question output').textContent")
    assert said == "The next accuracy of the table: 2e-4."
    for text, target in ("0.002", "2e-3"), (" 5E-7 ", "5e-7"), ("1.25e-3", "1e-3"), ("0.9", "1e-1"):
        other = f"The next accuracy of the table: {target}."
        assert typed(text) == [target, "" if float(text) == float(target) else other]
    for text in ("", "much", "0", "-1", "1", "1e-10", "1e-4 m", "Infinity"):
        kept, said = typed(text)
        assert kept == "1e-1"
        assert "is no accuracy" in said
    address = browser.execute_script("return location.hash")
    assert "target=1e-1" in address
    assert "norm=rms" in address


def test_links_keep_the_question_from_page_to_page(browser, folder):
    asked = "group=q&target=5e-4&norm=end&cost=residuals"
    visit(browser, folder / "report.html", f"#{asked}")
    links = each(browser, "a[href]", "node.getAttribute('href')")
    own = [a for a in links if ".html" in a and not a.startswith("http")]
    assert own
    assert all(asked in a for a in own if "#" not in a or "#group" in a)
    scene = next(a for a in own if "scene-won" in a)
    browser.get(f"{folder.as_uri()}/{scene}")
    assert browser.execute_script("return location.hash").startswith(f"#{asked}")
    file = folder / "report" / "scene-won.html"
    # A page that was reached by an anchor remembers it, and so does one without a bar.
    browser.get(file.as_uri() + "#run-1")
    assert browser.execute_script("return stepbench.question.target") == "5e-4"
    browser.get(file.as_uri() + "#target=1e-2")
    assert browser.execute_script("return stepbench.question.target") == "1e-2"
    browser.get((folder / "report" / "glossary.html").as_uri())
    links = each(browser, "a[href]", "node.getAttribute('href')")
    assert any("scene-won" in a and "target=1e-2" in a for a in links)


def test_the_command_of_a_scene_follows_the_question(browser, folder):
    found = []
    for target in ("1e-4", "1e-6", "1e-9"):
        fragment = f"#group=a&target={target}&cost=residuals"
        visit(browser, folder / "report" / "scene-won.html", fragment)
        found.append(each(browser, "[data-try], pre + .note", "node.textContent"))
    assert [text for text, _ in found] == [
        f"stepbench solve won {run} --t-end 1"
        for run in ("one --step 0.01", "two --step 0.001", "two --step 0.001")
    ]
    assert "verdict" in found[0][1]
    assert "No method reaches 1e-9" in found[2][1]
    assert "1.0e-8" in found[2][1] or "1e-8" in found[2][1]
    # Of a tie it repeats the run whose number stands first.
    file = folder / "report" / "scene-behind.html"
    visit(browser, file, "#group=a&target=1e-4&cost=operations")
    said, command = (
        each(browser, k, "node.innerText")[0] for k in ("[data-verdict] p", "[data-try]")
    )
    assert "two (1000 operations at h=0.01) and one (1050 operations at h=0.01) tie" in said
    assert command.startswith("stepbench solve behind two --step 0.01")


def test_a_scene_tells_whom_to_avoid(browser, folder):
    for scene, cost, said in (
        ("free", "residuals", "Costly: two (∞ \N{MULTIPLICATION SIGN})."),
        ("won", "operations", "Not reached by far."),
        ("broken", "operations", "Failed: two (newton failed). Reasons of 1 of 2 runs."),
        ("near", "operations", ""),
    ):
        fragment = f"#group=a&target=1e-4&cost={cost}"
        visit(browser, folder / "report" / f"scene-{scene}.html", fragment)
        (_, *more) = each(browser, "[data-verdict] > p", "node.innerText")
        assert " ".join(more).startswith(said), more
        assert ("Costly" in " ".join(more)) == (scene == "free")


def test_times_are_told_apart_as_in_the_ranking(browser, folder):
    with Store(folder) as store:
        noisy = {r.integrator: r for r in store.records().values() if r.problem == "noisy"}
    (own,) = answer({"": series_of(noisy.values())}, Question("a", 1e-4, "seconds")).scenes.values()
    said = set()
    # Also beside the best: the first in the list has the larger median, but less in most rounds.
    assert own.tied[:2] == ["n1", "n0"]
    assert own.entries["n0"].ratio == 1
    for highlight in ("", *noisy):
        one = highlight or own.tied[0]
        fragment = f"#group=a&target=1e-4&cost=seconds&highlight={highlight}"
        visit(browser, folder / "report" / "scene-noisy.html", fragment)
        rows = each(browser, ".methods tbody tr", "node.innerText.split('\t')")
        assert [row[0] for row in rows] == sorted(noisy, key=lambda k: own.entries[k].value)
        told = {row[0]: row[2].replace("\N{MULTIPLICATION SIGN}", "times") for row in rows}
        assert told[one] == "1 times"
        for two in noisy.keys() - {one}:
            found = quotient(by_round(noisy[one]), by_round(noisy[two]))
            word = "significant" if found.differs else "not significant"
            word = "a tie" if {one, two} <= {*own.tied} else word
            few = " (few samples)" * (found.least == LEAST_OF_FEW)
            ends = f"({number(found.low)} to {number(found.high)})"
            assert told[two] == f"{times(found.value)} {ends}, {word}{few}"
            said.add(word + few)
    assert len(said) > 3


def test_each_is_compared_with_the_highlighted_method_or_else_with_the_best(browser, folder):
    """Times are 1e-6 s per residual; in all of seven rounds they have the same quotient."""
    for scene, cost, said in (
        ("won", "seconds", "2.5 x, significant"),
        ("won", "residuals", "2.5 x"),
        ("near", "operations", "1.05 x, a tie"),
        ("near", "residuals", "1.05 x"),
        ("lucky", "operations", "3 x, a tie from a later start"),
        ("lucky", "seconds", "3 x, a tie from a later start"),
    ):
        for highlight in ("one", ""):
            fragment = f"#group=a&target=1e-4&cost={cost}&highlight={highlight}"
            visit(browser, folder / "report" / f"scene-{scene}.html", fragment)
            rows = each(browser, ".methods tbody tr", "node.innerText.replaceAll('\u00d7', 'x')")
            cells = {row.split("\t")[0]: row.split("\t") for row in rows}
            assert (cells["two"][2], cells["one"][2]) == (said, "1 x")
        visit(browser, folder / "report" / f"scene-{scene}.html", fragment + "two")
        lines = each(browser, "[data-verdict] p", "node.innerText.replaceAll('\u00d7', 'x')")
        beside = [line for line in lines if line.startswith("two: ")]
        assert [line.partition(", ")[2] for line in beside] == (
            [] if "tie" in said else [f"{said}, beside one; compare with all."]
        )
    visit(browser, folder / "report" / "scene-won.html", "#group=a&target=1e-4&highlight=far")
    said = each(browser, "[data-verdict] p", "node.innerText")[1]
    assert said == "far does not reach it: its least error is 0.01; ask for 1e-2."
    rows = each(browser, ".methods tbody tr", "node.innerText.split('\t')")
    beyond = {row[0]: row[2] if row[2:] else "" for row in rows}
    assert beyond["one"] != beyond["two"]
    visit(browser, folder / "report" / "scene-won.html", "#group=a&target=1e-2&highlight=far")
    rows = each(browser, ".methods tbody tr", "node.innerText.split('\t')")
    # The cost is that of the run which is compared.
    asked = {row[0]: f"at 1e-2: {row[1]}, {row[2]}" for row in rows if row[2]}
    assert beyond == asked | {"far": ""}
    assert beyond["one"]
    visit(browser, folder / "report" / "scene-won.html", "#group=a&target=1e-4&highlight=far")
    browser.execute_script("document.querySelector('[data-verdict] button').click()")
    assert browser.execute_script("return stepbench.question.target") == "1e-2"
    assert each(browser, "[data-verdict] p", "node.innerText")[0].startswith("To 1e-2 in ")
    visit(browser, folder / "report" / "scene-broken.html", "#group=a&target=1e-4&cost=operations")
    rows = each(browser, ".methods tbody tr", "node.innerText")
    cells = dict(row.split("\t")[:2] for row in rows)
    assert cells["shy"] == "the method does not take the scene: It takes no rods."
    assert cells["two"] == "no run reached the end: newton failed"
    assert "cut" not in cells  # it was interrupted
    assert "null" not in "".join(rows)
