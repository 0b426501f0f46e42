"""The pages of a report for all readers: axe-core finds no fault, headings follow each other."""

import base64
import re
from importlib import resources
from itertools import pairwise

import pytest
from chromium import waited
from planted import everything, plant

from reports.pages.html_report import write_html_report

PAGES = {
    "report.html",
    "report/scene-pendulum.html",
    "report/method-fragile.html",
    "report/methods.html",
    "report/failures.html",
    "report/atlas.html",
    "report/measured.html",
    "report/glossary.html",
}
DRAWN = """
return [...document.querySelectorAll("script[data-chart]")].every(
  (node) => document.getElementById(node.dataset.chart).view);
"""


def show(browser, page, scheme="light"):
    seen = [{"name": "prefers-color-scheme", "value": scheme}]
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": seen})
    browser.get("about:blank")
    browser.get(page.as_uri())
    # Charts are drawn when they come into sight, or all of them to be printed.
    browser.execute_script("window.dispatchEvent(new Event('beforeprint'))")
    waited(lambda: browser.execute_script(DRAWN))


def grave(browser):
    """Violations that axe-core calls serious or critical: rule and first place of each."""
    axe = resources.files("axe_playwright_python") / "axe.min.js"
    browser.execute_script(axe.read_text(encoding="utf-8"))
    found = browser.execute_async_script(
        """
        const done = arguments[0];
        axe.run(document, { resultTypes: ["violations"] }).then(done, (e) => done(String(e)));
        """
    )
    browser.get_log("browser")  # axe complains of what the page does not let it load
    assert len(found["passes"]) > 20
    wrong = [v for v in found["violations"] if v["impact"] in ("serious", "critical")]
    return [(v["id"], v["nodes"][0]["html"], v["nodes"][0]["failureSummary"]) for v in wrong]


@pytest.mark.long
def test_axe_finds_no_grave_fault_on_pages_of_a_folder_or_of_a_single_file(browser, site, tmp_path):
    one = write_html_report(plant(tmp_path, everything()), single_file=True)
    for page in [site / name for name in sorted(PAGES - {"report.html"})] + [one]:
        for scheme in ("light", "dark"):
            show(browser, page, scheme)
            assert grave(browser) == [], (page.name, scheme)


def test_the_first_page_has_no_grave_fault_whatever_the_shade_of_its_table(browser, site):
    for scheme in ("dark", "light"):
        show(browser, site / "report.html", scheme)
        browser.execute_script(
            """
            const table = document.getElementById("heat"), cell = table.querySelector(".reached");
            for (let near = 8; near <= 100; near++) {
              const other = table.tBodies[0].insertRow().appendChild(cell.cloneNode(true));
              other.style.setProperty("--near", `${near}%`);
            }
            """
        )
        assert grave(browser) == [], scheme
    browser.execute_script("document.querySelector('#answer').style.color = '#aaa5'")
    assert [fault[0] for fault in grave(browser)] == ["color-contrast"]  # as was planted


def test_paper_has_the_question_and_the_answer_and_nothing_to_operate(browser, site):
    show(browser, site / "report.html")
    printed = browser.execute_cdp_cmd("Page.printToPDF", {"preferCSSPageSize": True})["data"]
    assert 1 <= base64.b64decode(printed).count(b"/Type /Page\n") <= 4
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "print"})
    seen = browser.execute_script(
        "return Object.fromEntries(arguments[0].map((name) => [name, "
        "document.querySelector(name).checkVisibility()]));",
        ["nav.side", "#question button", "#question", "#answer", "#panels .plot", "#heat"],
    )
    # A heat table of twenty scenes is no wider than paper.
    paper = {"width": 718, "height": 1000, "deviceScaleFactor": 1, "mobile": False}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", paper)
    right = browser.execute_script(
        """
        const table = document.getElementById("heat");
        for (const row of table.rows)
          for (let k = 0; k < 18; k++) row.append(row.lastElementChild.cloneNode(true));
        return table.getBoundingClientRect().right;
        """
    )
    assert 0 < right <= 718
    hidden = {name for name, is_seen in seen.items() if not is_seen}
    assert hidden == {"nav.side", "#question button"}


def test_headings_follow_each_other_on_every_page(site):
    for page in [site / "report.html", *site.glob("report/*.html")]:
        text = re.sub("<script.*?</script>", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
        levels = [int(level) for level in re.findall("<h([1-6])", text)]
        assert levels[0] == levels.count(1) == 1, page.name
        for above, below in pairwise(levels):
            assert below <= above + 1, (page.name, levels)


def test_without_scripts_every_page_says_so_and_shows_its_tables(browser, site):
    browser.execute_cdp_cmd("Emulation.setScriptExecutionDisabled", {"value": True})
    for name in sorted(PAGES):
        browser.get((site / name).as_uri())
        words = browser.find_element("tag name", "main").text
        assert "need JavaScript" in words, name
        tables = browser.find_elements("css selector", "main table.sortable")
        folded = browser.find_elements("css selector", "main details table.sortable")
        assert tables or name == "report/glossary.html", name
        assert all(t.is_displayed() for t in tables if t not in folded), name
