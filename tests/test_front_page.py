"""The front page in Chromium: its question bar drives words, charts and heat table together."""

from __future__ import annotations

import math
import re

import pytest
from chromium import waited
from planted import everything, plant, planted

from bench.results.store import Store
from reports.pages.html_report import write_html_report


def visit(page, folder, fragment=""):
    page.get("about:blank")
    page.get((folder / "report.html").as_uri() + fragment)
    assert page.get_log("browser") == []


def choose(page, name, value):
    page.execute_script(
        """
        const select = document.querySelector(`#question [name=${arguments[0]}]`);
        select.value = arguments[1];
        select.dispatchEvent(new Event("change", { bubbles: true }));
        """,
        name,
        value,
    )


def heat_cells(page):
    """{(method's short name, scene): (class, text)} of the heat table."""
    rows = page.execute_script(
        """
        const heads = document.querySelectorAll("#heat thead tr:last-child a");
        const names = [...heads].map((a) => a.title);
        return [...document.querySelectorAll("#heat tbody tr")].flatMap((row) =>
          [...row.querySelectorAll("td")].map((cell, k) =>
            [row.querySelector("th a").title, names[k], [...cell.classList], cell.textContent]));
        """
    )
    return {(label, scene): (classes, text) for label, scene, classes, text in rows}


def shown(page):
    return page.execute_script(
        """
        const text = (name) => document.querySelector(name).textContent;
        const own = [...document.querySelectorAll(".panel:not([hidden]) svg.plot")];
        return {
          title: text("main h1"), answer: text("#answer"), standings: text("#standings"),
          heat: text("#heat caption"), charts: own.map((node) => node.getAttribute("aria-label")),
          address: location.hash,
        };
        """
    )


def expected(folder, group, target, cost):
    """The heat table's texts, from the store alone."""
    with Store(folder) as store:
        records = list(store.records().values())
    found = {}
    for scene in {r.problem for r in records}:
        own = [r for r in records if r.problem == scene]
        least = {}
        for r in own:
            error = r.errors.get(group, {}).get("max")
            if r.status == "ok" and error is not None and error <= target:
                value = r.cost(cost)
                least[r.integrator] = min(value, least.get(r.integrator, math.inf))
        for label in {r.integrator for r in records}:
            runs = [r for r in own if r.integrator == label]
            if label in least:
                ratio = least[label] / min(least.values())
                state = ("reached", f"{ratio:.1f}" if ratio < 10 else f"{ratio:.0f}")
            elif not runs:
                state = ("untried", "")
            else:
                state = ("far", "–") if any(r.status == "ok" for r in runs) else ("failed", "✕")  # noqa: RUF001
            found[label, scene] = state
    return found


def test_the_bar_drives_words_charts_and_heat_table_together(browser, site):
    visit(browser, site)
    before = shown(browser)
    assert "acceleration of at most 1e-4" in before["title"]
    for group, target, cost in (("q", "1e-3", "residuals"), ("a", "1e-2", "operations")):
        choose(browser, "group", group)
        choose(browser, "target", target)
        choose(browser, "cost", cost)
        now = shown(browser)
        word = {"q": "position", "a": "acceleration"}[group]
        for text in (now["title"], now["heat"], *now["charts"], now["answer"]):
            assert word in text
            assert target in text or "Error: of the worst" in text
        assert f"group={group}&target={target}&cost={cost}" in now["address"]
        assert now["answer"] != before["answer"]
        cells = heat_cells(browser)
        wanted = expected(site, group, float(target), cost)
        assert cells.keys() == wanted.keys()
        for place, (state, text) in wanted.items():
            assert state in cells[place][0], place
            assert text == cells[place][1], place
    assert browser.get_log("browser") == []


def test_runs_without_a_place_on_the_axes_stand_in_bands(browser, tmp_path):
    wild = [planted("spring_mass", "wild", {"a": (1e6, 1), "q": (1, 1)}, h=h) for h in (0.1, 1e-5)]
    lost = planted("spring_mass", "lost", {}, h=0.1, status="newton_failed", work={})
    write_html_report(plant(tmp_path, [*everything(), *wild, lost]))
    visit(browser, tmp_path, "#group=a&target=1e-4&cost=operations&scenes=all")
    charts = browser.execute_script(
        """
        const own = [...document.querySelectorAll(".panel:not([hidden]) svg.plot")];
        return own.map((chart) => {
          const all = (name) => [...chart.querySelectorAll(name)];
          const heights = (name) => all(name).flatMap((path) =>
            [...path.getAttribute("d").matchAll(/[ML][-\\d.]+ ([-\\d.]+)/g)].map((m) => +m[1]));
          return { bands: all(".band").map((b) => b.getBBox().y + 15), lines: heights(".line"),
            failed: heights(".marks.open"), axis: chart.textContent };
        });
        """
    )
    assert [len(chart["bands"]) for chart in charts] == [2, 1]
    for chart in charts:
        assert "error in a" in chart["axis"]
        assert max(chart["failed"]) <= max(chart["bands"]) <= min(chart["lines"])


def test_a_scene_without_the_quantity_is_not_counted_and_says_so(browser, site):
    visit(browser, site, "#group=lam&target=1e-4&cost=operations&scenes=all")
    assert "reached, of 1 scene" in shown(browser)["standings"]
    cells = heat_cells(browser)
    assert cells["good[rho_inf=0.8]", "spring_mass"] == (["unjudged", "start"], "·")
    assert cells["ringing[rho_inf=1]", "spring_mass"][0][0] == "untried"
    labels = browser.execute_script(
        'return [...document.querySelectorAll("#heat .unjudged a")].map((a) => a.ariaLabel);'
    )
    assert labels
    assert all(": No run on this scene has an error in multiplier" in s for s in labels)
    assert "Tied: counts that differ by at most 10 %, or" in shown(browser)["answer"]
    panel = "return document.querySelectorAll('#panels .chart')[0].innerHTML"
    assert browser.execute_script(panel) == (
        '<p class="note">No run on this scene has an error in multiplier λ.</p>'
    )


def test_a_scene_that_cannot_be_judged_says_why(browser, site):
    for group, words in (
        ("lam", "No run on this scene has an error in multiplier λ."),
        ("a", ""),
    ):
        address = (site / "report" / "scene-spring_mass.html").as_uri()
        browser.get("about:blank")
        browser.get(f"{address}#group={group}&target=1e-4&cost=operations")
        said, hidden, untold = browser.execute_script(
            """
            const table = document.querySelector("[data-methods]");
            const command = document.querySelector("[data-try]");
            const said = document.querySelector("[data-verdict]").textContent;
            return [said, !table.offsetParent, !command.offsetParent];
            """
        )
        assert hidden == untold == bool(words)
        assert said == words or (
            not words and "9600 operations at h=0.003125) alone reaches it." in said
        )


def test_the_address_restores_the_view_and_a_method_is_put_in_front(browser, site):
    fragment = "#group=lam&target=1e-2&cost=residuals&scenes=all&highlight=adaptive"
    visit(browser, site, fragment)
    chosen = browser.execute_script(
        "return [...document.getElementById('question').elements].filter(e => e.name)"
        ".map(e => [e.name, e.value])"
    )
    assert chosen.pop(2) == ["norm", "max"]  # the usual one is not told
    assert fragment == "#" + "&".join(f"{name}={value}" for name, value in chosen)
    count = "return document.querySelectorAll(arguments[0]).length"
    assert browser.execute_script(count, ".panel svg.field .curve.mine") == 1
    link = browser.execute_script("return document.querySelector('.panel h3 a').href")
    assert link.endswith("report/scene-spring_mass.html" + fragment)
    # What the address does not know is the first question's.
    visit(browser, site, "#group=nonsense&target=1e-2")
    assert browser.execute_script("return stepbench.question.group") == "a"


def test_keys_walk_through_the_runs_and_say_the_numbers_of_the_store(browser, site):
    from selenium.webdriver.common.keys import Keys

    visit(browser, site)
    plot = browser.find_elements("css selector", ".panel svg.plot")[1]
    browser.execute_script("arguments[0].focus()", plot)
    with Store(site) as store:
        records = [r for r in store.records().values() if r.problem == "pendulum"]
    plot.send_keys(Keys.ARROW_RIGHT)
    told = browser.execute_script(
        """
        const [plot, n] = arguments, told = [];
        for (let k = 0; k < n; k++) {
          told.push([...document.querySelector(".tip").children].map((n) => n.textContent.trim()));
          plot.dispatchEvent(new KeyboardEvent("keydown", { key: "ArrowRight" }));
        }
        return told;
        """,
        plot,
        len(records),
    )
    said = {(lines[0], float(lines[1].partition("=")[2])): lines[2:] for lines in told}
    assert len(said) == len(records)
    for r in records:
        at = r.h if r.controls == "step" else r.rtol
        (first, cost, _) = said[r.integrator, float(f"{at:.4g}")]
        if r.status == "ok":
            error = re.search(r"error (\S+) in acceleration", first).group(1)
            assert float(error) == pytest.approx(r.errors["a"]["max"], rel=0.05)
        else:
            assert first == f"ended with {r.status}"
        number, prefix = re.match(r"([\d.]+)\s*(k?)", cost).groups()
        value = float(number) * (1000 if prefix else 1)
        assert value == pytest.approx(sum(r.operations.values()), rel=0.01)
    plot.send_keys(Keys.ENTER)
    waited(lambda: "scene-pendulum.html#group=a" in browser.current_url)
    assert browser.get_log("browser") == []


def test_a_run_of_cost_zero_is_drawn_and_told(browser, tmp_path):
    records = [r for r in everything() if r.problem == "spring_mass"]
    for record in records:
        record.work["residuals"] *= record.integrator == "poor"
    write_html_report(plant(tmp_path, records))
    visit(browser, tmp_path, "#group=q&target=1e-2&cost=residuals")
    cells = {label: text for (label, _), (_, text) in heat_cells(browser).items()}
    told = browser.execute_script(
        """
        const chart = document.querySelector(".panel svg.plot"), told = [];
        for (const key of [..."123456"]) {
          chart.dispatchEvent(new KeyboardEvent("keydown", { key: "ArrowRight", bubbles: true }));
          told.push([...document.querySelector(".tip").children].map((n) => n.textContent.trim()));
        }
        return told;
        """
    )
    assert cells == {"good[rho_inf=0.8]": "1.0", "poor": "∞"}
    assert {lines[3] for lines in told} == {"0 evaluations"}
    axis = browser.find_elements("css selector", ".panel:not([hidden]) svg.plot .axis text")
    assert "0" not in [text.get_attribute("textContent") for text in axis]  # it holds the others
    scene = (tmp_path / "report" / "scene-spring_mass.html").as_uri()
    browser.get(f"{scene}#group=q&target=1e-2&cost=residuals")
    rows = browser.execute_script(
        "return [...document.querySelectorAll('[data-methods] tbody tr')].map("
        "(row) => [...row.querySelectorAll('td')].slice(0, 2).map((cell) => cell.textContent))"
    )
    assert rows == [["0", "1 ×"], ["480", "∞ ×"]]  # noqa: RUF001
    assert browser.get_log("browser") == []


@pytest.mark.long
def test_a_chosen_set_of_scenes_is_shown_alone(browser, site):
    visit(browser, site)
    browser.execute_script(
        "stepbench.data.filters.push({ id: 'one', name: 'one', scenes: [1] });"
        "document.getElementById('question').elements.scenes.add(new Option('one', 'one'));"
    )
    choose(browser, "scenes", "one")
    assert len(shown(browser)["charts"]) == 1
    assert {scene for _, scene in heat_cells(browser)} == {"pendulum"}


@pytest.mark.long
def test_a_large_chart_names_every_curve_and_no_names_overlap(browser, site):
    visit(browser, site)
    boxes = browser.execute_script(
        """
        const place = document.createElement("div");
        place.style.width = "900px";
        document.querySelector("main").append(place);
        stepbench.draw(place, 1, { large: true });
        return [...place.querySelectorAll(".legend .entry text")].map((node) => {
          const box = node.getBoundingClientRect();
          return [node.textContent, box.left, box.top, box.right, box.bottom];
        });
        """
    )
    with Store(site) as store:
        able = {r.integrator for r in store.records().values() if r.problem == "pendulum"}
    assert len(boxes) == len(able) - 1  # one method has failed runs only
    for k, (_, left, top, right, bottom) in enumerate(boxes):
        for _, left2, top2, right2, bottom2 in boxes[:k]:
            assert right <= left2 or right2 <= left or bottom <= top2 + 2 or bottom2 <= top + 2


def test_tables_sort_and_filter(browser, site):
    browser.get((site / "report" / "scene-pendulum.html").as_uri())
    table = (
        "const t = [...document.querySelectorAll('table.sortable')]"
        ".find(t => t.tBodies[0].rows.length > 12);"
    )
    column_of = table + "return [...t.tBodies[0].rows].map(r => r.cells[0].textContent)"
    browser.execute_script(table + "t.tHead.querySelector('button').click()")
    names = browser.execute_script(column_of)
    assert names == sorted(names, key=str.lower)
    sorted_by = table + "return t.tHead.rows[0].cells[0].getAttribute('aria-sort')"
    assert browser.execute_script(sorted_by) == "ascending"
    visible = table + "return [...t.tBodies[0].rows].filter(r => !r.hidden).length"
    assert browser.execute_script(visible) == 12  # a long table begins folded
    browser.execute_script(
        table + "const i = t.closest('.wide').previousElementSibling; i.value = 'fragile';"
        "i.dispatchEvent(new Event('input'))"
    )
    assert browser.execute_script(visible) == 2
    assert browser.get_log("browser") == []
