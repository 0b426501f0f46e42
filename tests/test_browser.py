"""The page in Chromium: menus, legend, tooltip and download give the numbers of the store."""

import csv
import shutil

import pytest
from chromium import each, waited
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.support.ui import Select

from bench.results.store import Store
from reports.formatting import cost_text, number, times
from reports.pages.html_report import write_html_report

EXPLORER = "scene-2-1-convergence-max"


@pytest.fixture(autouse=True)
def _on_a_scene(browser, site):
    browser.get(scene_page(site))


def scene_page(folder):
    return (folder / "report" / "scene-pendulum.html").as_uri()


def test_numbers_of_scripts_are_written_as_those_of_tables_and_sentences(browser):
    values = [0.0, 4.4e-16, 9.996e-4, 1e-3, 0.0123456, 0.9996, 1.0, 99.96, 123.4, 36700.0]
    values += [999_499.0, 999_999.0, 1e6, 3.6749e7, 1e9, 1.5e13, 1e300]

    def written(function, *more):
        said = f"return arguments[0].map((value) => stepbench.{function}(value, ...arguments[1]))"
        return browser.execute_script(said, values, more)

    assert written("number") == [number(value) for value in values]
    for cost in ("seconds", "operations", "residuals"):
        assert written("costText", cost) == [cost_text(value, cost) for value in values], cost
    values[1:] = own = [1.0, 1.00123456, 1.0099, 1.01, 1.3749, 17.64, 12345.6, 1e7]
    assert written("multiple")[1:] == [times(ratio).removesuffix(" times") for ratio in own]


def chart(browser, name):
    """Scroll to a chart, in its tab, and wait until it is drawn."""
    browser.execute_script(
        """
        const tab = document.getElementById(arguments[0]).closest(".tab, details");
        if (tab?.matches("details")) return tab.open = true;
        if (tab) document.getElementById(tab.id + "-tab").click();
        """,
        name,
    )
    browser.execute_script("document.getElementById(arguments[0]).scrollIntoView()", name)
    return waited(
        lambda: browser.execute_script(
            "const p = document.getElementById(arguments[0]); return p.view ? p : null", name
        )
    )


def test_a_chart_shows_tells_isolates_and_hands_out_the_errors_of_the_store(browser, site):
    points = """
        return [...arguments[0].querySelectorAll("path")].map((path) => path.__data__)
          .filter((item) => item?.mark?.marktype === "symbol" && item.datum?.run)
          .flatMap(({ datum }) => ["q", "v", "a", "lam"].map(
            (group) => [datum.series, group, datum.h, datum[`${group}_max`]]));
    """
    place = chart(browser, EXPLORER)
    with Store(site) as store:
        records = [r for r in store.records().values() if r.problem == "pendulum"]
    good = [r for r in records if r.status == "ok" and r.controls == "step"]
    wanted = {
        (r.integrator, group, r.h, float(f"{errors['max']:.5g}"))
        for r in good
        for group, errors in r.errors.items()
    }
    assert {tuple(point) for point in browser.execute_script(points, place)} == wanted
    marks = place.find_elements("css selector", "g.mark-symbol.role-mark path")
    ActionChains(browser).move_to_element(marks[0]).perform()
    text = waited(lambda: browser.find_element("id", "vg-tooltip-element").text)
    assert any(r.integrator in text and r.resolution in text for r in good)
    # A click on the legend isolates a method.
    opacity = "Number(node.getAttribute('opacity') ?? 1)"
    selector = f"#{EXPLORER} g.mark-symbol.role-mark path"
    assert set(each(browser, selector, opacity)) == {1}
    label = place.find_element("css selector", "g.role-legend-label text")
    # Below the bar that stays in sight.
    browser.execute_script("arguments[0].scrollIntoView({ block: 'center' })", label)
    label.click()
    waited(lambda: min(each(browser, selector, opacity)) < 0.1)
    assert max(each(browser, selector, opacity)) == 1
    # Its data can be taken along.
    (link,) = place.find_elements("xpath", "../following-sibling::p[@class='data'][1]/a")
    assert link.text == "runs.csv"
    browser.execute_script("arguments[0].click()", link)
    file = browser.downloads / "runs.csv"
    waited(file.exists)
    rows = list(csv.DictReader(file.open()))
    assert len(rows) == len(good)
    assert {(r["series"], "a", float(r["h"]), float(r["a_max"])) for r in rows} <= wanted


PHONE = {"width": 420, "height": 900, "deviceScaleFactor": 1, "mobile": True}


def test_pages_ask_nothing_of_the_network_complain_of_nothing_and_fit_a_phone(browser, site):
    for page in [site / "report.html", *sorted((site / "report").glob("*.html"))]:
        browser.get(page.as_uri())
        for name in each(browser, "[data-chart]", "node.dataset.chart"):
            chart(browser, name)
        assert browser.get_log("browser") == []
        width = "return document.documentElement.scrollWidth"
        assert browser.execute_script(f"{width} <= innerWidth"), page.name
        browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", PHONE)
        assert browser.execute_script(width) <= PHONE["width"], page.name
        browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
    asked = [entry["message"] for entry in browser.get_log("performance")]
    asked = [entry for entry in asked if '"Network.requestWillBeSent"' in entry]
    assert asked
    assert not any('"url":"http' in entry for entry in asked)


def test_charts_far_below_wait_until_they_come_near(browser, site):
    drawn = (
        "return [...document.querySelectorAll('[data-chart]')]"
        ".map(n => Boolean(document.getElementById(n.dataset.chart).dataset.drawn))"
    )
    states = browser.execute_script(drawn)
    assert not all(states)
    browser.execute_script("window.dispatchEvent(new Event('beforeprint'))")
    assert all(browser.execute_script(drawn))


def test_a_script_that_is_not_the_page_s_own_does_not_run(browser, site):
    browser.get((site / "report.html").as_uri())
    browser.execute_script(
        """
        const script = document.createElement("script");
        script.textContent = "window.came = 1";
        document.body.append(script);
        document.body.insertAdjacentHTML("beforeend", "<img src=x onerror='window.came = 1'>");
        """
    )
    said = waited(lambda: browser.get_log("browser"))
    assert browser.execute_script("return window.came === undefined")
    assert "Content Security Policy" in said[0]["message"]


def test_a_scene_answers_the_question_in_words_and_in_its_table(browser, site):
    browser.get(scene_page(site) + "#group=q&target=1e-2&cost=residuals&scenes=all")
    with Store(site) as store:
        records = [r for r in store.records().values() if r.problem == "pendulum"]
    for group, target in (("q", "1e-2"), ("v", "1e-3")):
        Select(browser.find_element(By.NAME, "group")).select_by_value(group)
        typed = browser.find_element(By.NAME, "target")
        typed.clear()
        typed.send_keys(target, Keys.ENTER)
        able = [r for r in records if r.status == "ok" and r.errors[group]["max"] <= float(target)]
        least = min(r.work["residuals"] for r in able)
        words = browser.find_element(By.CSS_SELECTOR, "[data-verdict]").text
        assert words.startswith(f"To {target} in {'position' if group == 'q' else 'velocity'} ")
        assert str(least) in words
        rows = browser.find_elements(By.CSS_SELECTOR, "table.methods tbody tr")
        assert len(rows) == len({r.integrator for r in records})
        assert f" {least} 1 × " in rows[0].text  # noqa: RUF001
        assert sum("×" in row.text for row in rows) == len({r.integrator for r in able})  # noqa: RUF001
        assert "fragile no run reached the end: newton failed" in [row.text for row in rows]


def test_a_method_follows_the_question_on_all_its_scenes_and_reset_returns_to_the_first(
    browser, site
):
    page = next((site / "report").glob("method-good*0.8*"))
    browser.get(page.as_uri())
    address, seen = "return location.hash", "[data-standing], table.methods tbody tr"
    first = [node.text for node in browser.find_elements("css selector", seen)]
    reset = browser.find_element("css selector", "[type=reset]")
    assert not reset.is_displayed()
    browser.get(page.as_uri() + "#group=q&target=1e-9&cost=residuals&scenes=all")
    browser.refresh()
    reset = browser.find_element("css selector", "[type=reset]")
    standing, *rows = [node.text for node in browser.find_elements("css selector", seen)]
    assert "Reaches 1e-9 in position q" in standing
    assert "on 0 of 2 scenes tried" in standing
    assert len(rows) == 2
    with Store(site) as store:
        own = [r for r in store.records().values() if r.integrator == "good[rho_inf=0.8]"]
    for scene, row in zip(("spring_mass", "pendulum"), rows, strict=True):
        errors = [r.errors["q"]["max"] for r in own if r.problem == scene and r.status == "ok"]
        assert f"not reached: least error {number(min(errors))}, down to h=0.003125" in row
    reset.click()
    assert "target=1e-9" not in browser.execute_script(address)
    assert not reset.is_displayed()
    assert [node.text for node in browser.find_elements("css selector", seen)] == first


def test_one_file_shows_every_page(browser, site, tmp_path):
    shutil.copytree(site, tmp_path / "one", ignore=shutil.ignore_patterns("report*"))
    browser.get(write_html_report(tmp_path / "one", single_file=True).as_uri())
    browser.find_element(By.LINK_TEXT, "pendulum").click()
    assert browser.find_element(By.CSS_SELECTOR, "#scene-pendulum h1").is_displayed()
    assert browser.execute_script("return scrollY") > 500
    assert browser.find_element(By.ID, "question").is_displayed()
    assert len(browser.find_elements(By.CSS_SELECTOR, ".chart.large svg")) == 2


def test_tabs_follow_the_arrow_keys_and_links_open_them(browser, site):
    shown = "return [...document.querySelectorAll('.tab')].filter(t => !t.hidden).map(t => t.id)"
    assert browser.execute_script(shown) == ["scene-2-cost"]
    browser.find_element(By.ID, "scene-2-cost-tab").send_keys(Keys.ARROW_LEFT)
    assert browser.execute_script(shown) == ["scene-2-runs"]
    browser.switch_to.active_element.send_keys(Keys.ARROW_RIGHT)
    assert browser.execute_script(shown) == ["scene-2-cost"]
    assert browser.switch_to.active_element.get_attribute("aria-selected") == "true"
    # A link to a run opens its tab and the folded table, one to a chart the fold around it.
    run = browser.execute_script("return document.querySelector('tr[id^=run-]').id")
    browser.execute_script("location.hash = arguments[0]", run)
    waited(lambda: browser.find_element(By.ID, run).is_displayed())
    assert browser.execute_script(shown) == ["scene-2-runs"]
    browser.get((site / "report" / "atlas.html").as_uri())
    place = browser.find_element(By.ID, "atlas-e-1")
    assert not place.is_displayed()
    browser.execute_script("location.hash = 'atlas-e-1'")
    waited(lambda: browser.execute_script("return Boolean(arguments[0].view)", place))


def test_tabs_stand_under_the_verdict_and_the_legend_beside_the_lines(browser, site):
    box = "(({ top, bottom }) => [top, bottom])(node.getBoundingClientRect())"
    (beside,), (bar,) = each(browser, ".beside", box), each(browser, ".tabbar", box)
    assert 0 < bar[0] - beside[1] < 50
    verdict, command = each(browser, ".beside > .stack > .card", box)
    assert 0 < command[0] - verdict[1] < 50
    left, right = each(browser, ".beside > * > :last-child", box)
    assert left[1] == pytest.approx(right[1], abs=1)
    place = chart(browser, "scene-2-1-accuracy")
    lines, legend = browser.execute_script(
        """
        const box = (name) => arguments[0].querySelector(name).getBoundingClientRect();
        return [box("g.mark-symbol.role-mark").right, box("g.role-legend").left];
        """,
        place,
    )
    assert lines <= legend


def test_contents_are_filtered(browser, site):
    links = """
    const all = [...document.querySelectorAll("nav.side li")];
    return all.filter((node) => node.offsetParent).map((node) => node.innerText);
    """
    before = browser.execute_script(links)
    field = browser.find_element("css selector", "nav.side input.filter")
    status = browser.find_element("css selector", "nav.side [role=status]")
    for asked, found in (
        ("PEND", ["pendulum"]),
        ("ringing", ["ringing 1"]),
        ("spared", ["Verdict fails (spared)"]),
        ("the pendulum scene", ["pendulum"]),
        ("zzz spared", ["Verdict fails (spared)"]),
        ("a word.", ["A word."]),
        ("accel feeds", ["A word."]),  # in the claim of that experiment
        ("λ", ["Multiplier"]),
        ("trust", ["How it was measured"]),
        ("zzz", []),
    ):
        field.send_keys(asked)  # scenes, methods by name, sections, words of the glossary
        assert browser.execute_script(links) == found
        assert status.text == ("" if found else "Nothing is called “zzz”.")
        field.clear()
    field.send_keys("baumg")
    assert browser.execute_script(links) == ["Baumgarte"]
    field.clear()
    field.send_keys(" ")
    assert browser.execute_script(links) == before
    # A word of a title counts more than one that is found with it.
    browser.execute_script(
        """
        const [first, second] = document.querySelectorAll("nav.side li a");
        first.textContent = "gα 0.8";
        second.insertAdjacentHTML("beforeend", "<span hidden> gα 0.8</span>");
        """
    )
    for asked in ("galpha", "gα", "ga", "GALPHA 0.8"):
        field.clear()
        field.send_keys(asked)
        assert browser.execute_script(links) == ["gα 0.8"]


def test_paper_has_all_tabs_all_rows_and_no_folds(browser, site):
    seen = """
    const folds = "main details:not([open], .chart *)";
    const own = (name) => [...document.querySelectorAll(name)].filter((n) => n.offsetParent).length;
    return [own(".tab"), own("main table.sortable tbody tr"), own(folds)];
    """
    tabs, rows, _ = browser.execute_script(seen)
    browser.execute_script("dispatchEvent(new Event('beforeprint'))")
    printed, printed_rows, folds = browser.execute_script(seen)
    everything = "return document.querySelectorAll('main table.sortable tbody tr').length"
    assert (tabs, printed, folds) == (1, 5, 0)
    assert rows < printed_rows == browser.execute_script(everything)
    browser.execute_script("dispatchEvent(new Event('afterprint'))")
    assert browser.execute_script(seen)[0] == 1


def test_an_animation_plays_and_nothing_is_complained_of(browser, tmp_path):
    from reports.pages.catalogue import write_animation

    pictures = [{"t": k / 10, "lines": [[[0.0, 0.0], [1.0, k / 10]]]} for k in range(30)]
    browser.get(write_animation("<b>pendulum", pictures, tmp_path / "a.html").as_uri())
    path = "return document.querySelector('path').getAttribute('d')"
    first = browser.execute_script(path)
    assert first.startswith("M0 0L1 ")
    waited(lambda: browser.execute_script(path) != first)
