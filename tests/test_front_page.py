"""The front page in Chromium: its question bar drives words, charts and heat table; its layout."""

import re
from contextlib import contextmanager

import pytest
from chromium import each, visit, waited
from planted import everything, plant, planted
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.keys import Keys

from bench.results.store import Store
from reports.pages.html_report import write_html_report
from reports.pages.report import read_report
from reports.questions import Question
from reports.ranking import answers


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


def text(browser, selector):
    return each(browser, selector, "node.textContent")[0]


def heat_cells(browser):
    """{(method, scene): (classes, text)} of the heat table."""
    names = each(browser, "#heat thead tr:last-child a", "node.title")
    rows = each(
        browser,
        "#heat tbody tr",
        "[node.querySelector('th a').title,"
        " [...node.querySelectorAll('td')].map((cell) => [[...cell.classList], cell.textContent])]",
    )
    return {(m, scene): cell for m, own in rows for scene, cell in zip(names, own, strict=True)}


def expected(folder, group, target, cost):
    """The classes and texts of the heat table, from the ranking."""
    report = read_report(folder)
    found = answers(report.series, [group], [target])[Question(group, target, cost)]
    cells = {}
    for scene, own in found.scenes.items():
        for label in report.names:
            entry = own.entries.get(label)
            state = entry.state if entry else "untried"
            cells[label, scene] = (
                (state, {"far": "–", "failed": "✕"}.get(state, ""))  # noqa: RUF001
                if isinstance(state, str)
                else ("reached", f"{state:.1f}" if state < 10 else f"{state:.0f}")
            )
    return cells


CHARTS = ".panel:not([hidden]) svg.plot"


def test_the_bar_drives_words_charts_and_heat_table_together(browser, site):
    visit(browser, site / "report.html")
    before = text(browser, "#answer")
    assert "acceleration of at most 1e-4" in text(browser, "main h1")
    for group, target, cost in (("q", "1e-3", "residuals"), ("a", "1e-2", "operations")):
        for name, value in (("group", group), ("target", target), ("cost", cost)):
            choose(browser, name, value)
        word = {"q": "position", "a": "acceleration"}[group]
        charts = each(browser, CHARTS, "node.ariaLabel")
        for said in (text(browser, "main h1"), text(browser, "#heat caption"), *charts):
            assert word in said
            assert target in said
        assert word in text(browser, "#answer") != before
        assert f"group={group}&target={target}&cost={cost}" in browser.current_url
        cells, wanted = heat_cells(browser), expected(site, group, float(target), cost)
        assert cells.keys() == wanted.keys()
        for place, (state, shown) in wanted.items():
            assert state in cells[place][0], place
            assert shown == cells[place][1], place


def test_runs_without_a_place_on_the_axes_stand_in_bands(browser, tmp_path):
    wild = [planted("spring_mass", "wild", {"a": (1e6, 1), "q": (1, 1)}, h=h) for h in (0.1, 1e-5)]
    lost = planted("spring_mass", "lost", {}, h=0.1, status="newton_failed", work={})
    write_html_report(plant(tmp_path, [*everything(), *wild, lost]))
    visit(browser, tmp_path / "report.html", "#group=a&target=1e-4&cost=operations&scenes=all")
    lines, failed = (
        f"[...node.querySelectorAll('{kind}')].flatMap((path) => [...path.getAttribute('d')"
        ".matchAll(/[ML][-\\d.]+ ([-\\d.]+)/g)].map((m) => +m[1]))"
        for kind in (".line", ".marks.open")
    )
    bands = "[...node.querySelectorAll('.band')].map((b) => b.getBBox().y + 15)"
    parts = f"[{bands}, {lines}, {failed}]"
    charts = each(browser, CHARTS, parts)
    assert [len(bands) for bands, *_ in charts] == [2, 1]
    for bands, lines, failed in charts:
        assert max(failed) <= max(bands) <= min(lines)
    assert all("error in a" in said for said in each(browser, CHARTS, "node.textContent"))


def test_a_scene_without_the_quantity_is_not_counted_and_says_so(browser, site):
    said = "This scene has no multiplier λ."
    visit(browser, site / "report.html", "#group=lam&target=1e-4&cost=operations&scenes=all")
    assert "reached, of 1 scene" in text(browser, "#standings")
    cells = heat_cells(browser)
    assert cells["good[rho_inf=0.8]", "spring_mass"] == [["unjudged", "start"], "·"]
    assert cells["ringing[rho_inf=1]", "spring_mass"][0][0] == "untried"
    labels = each(browser, "#heat .unjudged a", "node.ariaLabel")
    assert labels
    assert all(said[:-3] in label for label in labels)
    assert "Tied: counts that differ by at most 10 %, or" in text(browser, "#answer")
    assert each(browser, "#panels .chart", "node.innerHTML")[0] == f'<p class="note">{said}</p>'
    # Its own page has neither table nor command, but for a quantity that it has.
    scene = site / "report" / "scene-spring_mass.html"
    for group, words in (
        ("lam", said),
        ("a", "9600 operations at h=0.003125) alone reaches it; nearest: poor ("),
    ):
        visit(browser, scene, f"#group={group}&target=1e-4&cost=operations")
        seen = each(browser, "[data-methods], [data-try]", "Boolean(node.offsetParent)")
        assert seen == [group == "a"] * 2
        assert words in text(browser, "[data-verdict]")
    offered = dict(each(browser, "#question [name=group] option", "[node.value, !node.disabled]"))
    assert (offered["a"], offered["lam"]) == (True, False)


def test_the_address_restores_the_view_and_a_method_is_put_in_front(browser, site):
    fragment = "#group=lam&target=1e-2&cost=residuals&scenes=all&highlight=adaptive"
    visit(browser, site / "report.html", fragment)
    chosen = each(browser, "#question [name]", "[node.name, node.value]")
    assert chosen.pop(2) == ["norm", "max"]  # the usual one is not told
    assert fragment == "#" + "&".join(f"{name}={value}" for name, value in chosen)
    assert len(each(browser, ".panel svg.field .curve.mine", "1")) == 1
    link = each(browser, ".panel h3 a", "node.href")[0]
    assert link.endswith("report/scene-spring_mass.html" + fragment)
    visit(browser, site / "report.html", "#group=a&target=1e-2&highlight=poor")
    said, count = each(browser, "#answer > .wrong", "node.innerText")
    assert said == "poor: Silently wrong, sometimes: spring mass."
    assert count.startswith("These are 2 of 6 runs that reached the end ")
    assert each(browser, "#answer > .wrong .scene", "node.pathname.split('/').at(-1)") == [
        "scene-spring_mass.html"
    ]
    # What the address does not know is the first question's.
    visit(browser, site / "report.html", "#group=nonsense&target=1e-2")
    assert browser.execute_script("return stepbench.question.group") == "a"


#: The notes at runs that the arrow key finds one after the other.
WALK = """
const [plot, n] = arguments, told = [];
for (let k = 0; k < n; k++) {
  plot.dispatchEvent(new KeyboardEvent("keydown", { key: "ArrowRight", bubbles: true }));
  told.push([...document.querySelector(".tip").children].map((n) => n.textContent.trim()));
}
return told;
"""


def test_keys_walk_through_the_runs_and_say_the_numbers_of_the_store(browser, site):
    visit(browser, site / "report.html")
    plot = browser.find_elements("css selector", CHARTS)[1]
    with Store(site) as store:
        records = [r for r in store.records().values() if r.problem == "pendulum"]
    told = browser.execute_script(WALK, plot, len(records))
    said = {(lines[0], float(lines[1].partition("=")[2])): lines[2:] for lines in told}
    assert len(said) == len(records)
    for r in records:
        at = r.h if r.controls == "step" else r.rtol
        first, cost = said[r.integrator, float(f"{at:.4g}")]
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


def test_tables_sort_and_filter(browser, site):
    visit(browser, site / "report" / "scene-pendulum.html")
    (number,) = [k for k, n in enumerate(each(browser, ".sortable", "node.tBodies[0].rows.length"))
                 if n > 12]  # fmt: skip
    place = f"document.querySelectorAll('.sortable')[{number}]"
    visible = f"return [...{place}.tBodies[0].rows].filter((row) => !row.hidden).length"
    browser.execute_script(f"{place}.tHead.querySelector('button').click()")
    names = browser.execute_script(
        f"return [...{place}.tBodies[0].rows].map((row) => row.cells[0].textContent)"
    )
    assert names == sorted(names, key=str.lower)
    sorted_by = f"return {place}.tHead.rows[0].cells[0].ariaSort"
    assert browser.execute_script(sorted_by) == "ascending"
    assert browser.execute_script(visible) == 12  # a long table begins folded
    browser.execute_script(
        f"const i = {place}.closest('.wide').previousElementSibling; i.value = 'fragile';"
        "i.dispatchEvent(new Event('input'))"
    )
    assert browser.execute_script(visible) == 2


# ---- layout ------------------------------------------------------------------------------
BOX = "(({ left, top, right, bottom }) => [left, top, right, bottom])(node.getBoundingClientRect())"


def apart(one, two):
    return one[2] <= two[0] or two[2] <= one[0] or one[3] <= two[1] + 2 or two[3] <= one[1] + 2


def test_names_of_curves_cover_neither_each_other_nor_rings(browser, site):
    visit(browser, site / "report" / "scene-pendulum.html")
    names = each(browser, ".plot.large .legend .entry text", BOX)
    with Store(site) as store:
        able = {r.integrator for r in store.records().values() if r.problem == "pendulum"}
    assert len(names) == len(able) - 1  # one method has failed runs only
    assert all(apart(one, two) for k, one in enumerate(names) for two in names[:k])
    visit(browser, site / "report.html")
    names, rings = (each(browser, f"#panels {kind}", BOX) for kind in (".name", ".winner"))
    assert rings
    assert all(apart(name, ring) for name in names for ring in rings)


@contextmanager
def screen(browser, width, height):
    """A screen of this size, in pixels of CSS."""
    size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 600}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    try:
        yield
    finally:
        browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})


def test_the_first_row_of_charts_is_in_sight_four_in_a_row(browser, tmp_path):
    scenes = ("duffing", "oscillator", "friction")
    more = [planted(scene, "poor", {"a": (1.0, 1)}, h=0.1) for scene in scenes]
    write_html_report(plant(tmp_path, everything() + more))
    with screen(browser, 1400, 900):
        visit(browser, tmp_path / "report.html")
        tops = [box[1] for box in each(browser, "#panels > .panel", BOX)]
        cards = [box[1] for box in each(browser, ".opening > .card", BOX)]
        (heat,), (card,) = each(browser, "#heat", BOX), each(browser, ".card:has(> #heat)", BOX)
    assert len(tops) == 5
    assert len(set(tops[:4])) == len(set(cards)) == 1
    assert 0 < tops[0] < 450 < tops[4]
    assert card[0] < heat[0] < heat[2] < card[2] < heat[2] + 40


def test_on_a_phone_the_bar_stays_in_sight_and_nothing_is_cut(browser, site):
    beside = """(() => {
      const pen = document.createElement("canvas").getContext("2d");
      pen.font = getComputedStyle(node).font;
      const text = node.selectedOptions?.[0].text ?? node.value;
      return node.getBoundingClientRect().width - pen.measureText(text).width;
    })()"""
    with screen(browser, 420, 900):
        visit(browser, site / "report.html")
        browser.execute_script("document.getElementById('heat-head').scrollIntoView()")
        wide = browser.execute_script("return document.documentElement.scrollWidth")
        (bar,) = each(browser, "#question", BOX)
        fields = each(browser, "#question :is(select, input)", f"[node.name, {BOX}, {beside}]")
        labels = each(browser, "#question label", "parseFloat(getComputedStyle(node).fontSize)")
    assert min(labels) >= 10
    assert (bar[1], wide) == (0, 420)
    assert 30 < bar[3] < 100
    assert [own[0] for own in fields] == ["group", "target", "norm", "cost", "scenes", "highlight"]
    for name, (left, _, right, _), room in fields:
        assert 0 <= left <= right <= 420, name
        assert room > 0, name


def hidden_methods(browser):
    """Labels of the methods of which no chart has a curve, if all charts agree."""
    state = "[stepbench.data.methods[node.dataset.method].label, !node.getClientRects().length]"
    curves = {tuple(pair) for pair in each(browser, "#panels .curve, #profile .curve", state)}
    assert len(curves) == len(dict(curves))
    return {label for label, off in curves if off}


def test_a_legend_hides_and_shows_methods_in_all_charts(browser, site):
    visit(browser, site / "report.html")
    labels = browser.execute_script("return stepbench.data.methods.map((m) => m.label)")
    assert hidden_methods(browser) == set()
    *_, one, two = browser.find_elements("css selector", ".chooser .switch:has(.badge)")
    first, second = (labels[int(node.get_attribute("data-method"))] for node in (one, two))
    everything = browser.find_element("css selector", ".chooser .switch")
    one.click()
    assert hidden_methods(browser) == {first}
    assert one.get_attribute("aria-pressed") == "false"
    choose(browser, "target", "1e-2")  # the next question keeps it
    assert hidden_methods(browser) == {first}
    one.send_keys(Keys.ENTER)
    assert hidden_methods(browser) == set()
    ActionChains(browser).double_click(two).perform()
    assert hidden_methods(browser) == set(labels) - {second}
    everything.send_keys(Keys.SPACE)
    assert hidden_methods(browser) == set()
    one.send_keys(Keys.SHIFT, Keys.ENTER)
    assert hidden_methods(browser) == set(labels) - {first}
    # Neither pointer nor keys find hidden runs.
    own = f".plot:has(.curve[data-method='{labels.index(first)}'])"
    plot = browser.find_element("css selector", own)
    for key in (Keys.ARROW_RIGHT, Keys.ARROW_RIGHT, Keys.ARROW_DOWN, Keys.ARROW_LEFT):
        plot.send_keys(key)
        assert text(browser, ".tip strong").strip() == first


def test_the_legend_of_a_large_chart_hides_methods_too(browser, site):
    visit(browser, site / "report" / "scene-pendulum.html")

    def off():
        return each(browser, ".curve.off", "node.dataset.method")

    entry = browser.find_element("css selector", ".legend .entry")
    own = entry.get_attribute("data-method")
    assert off() == []
    entry.send_keys(Keys.ENTER)
    assert off() == [own]
    assert browser.execute_script("return document.activeElement.dataset.method") == own
    entry.click()
    assert off() == []
    entry.send_keys(Keys.SHIFT, Keys.ENTER)
    assert len(off()) == len(each(browser, ".plot.large .curve", "1")) - 1
    assert own not in off()


def test_a_panel_becomes_large_in_its_place_and_escape_closes_it(browser, site):
    visit(browser, site / "report.html")
    before = each(browser, ".panel svg.plot", "node.clientWidth")
    one, two = browser.find_elements("css selector", "button.enlarge")
    for button, name in ((one, "spring mass"), (two, "pendulum")):
        button.click()
        (said,) = each(browser, ".plot.large", "node.ariaLabel")
        assert said.startswith(f"{name}: error in")
        assert button.get_attribute("aria-expanded") == "true"
        assert max(each(browser, ".panel svg.plot", "node.clientWidth")) > 1.5 * max(before)
    browser.switch_to.active_element.send_keys(Keys.ESCAPE)
    assert each(browser, ".plot.large", "1") == []
    assert each(browser, ".panel svg.plot", "node.clientWidth") == before
    assert two == browser.switch_to.active_element
