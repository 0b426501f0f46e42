"""The layout of the front page in Chromium: cards, screens, legends, large panels."""

from __future__ import annotations

from contextlib import contextmanager

from planted import everything, plant, planted
from test_front_page import choose, visit

from reports.pages.html_report import write_html_report


def test_cards_stand_in_rows_and_names_beside_rings(browser, site):
    visit(browser, site)
    tops = browser.execute_script(
        "return ['.opening > .card', '#panels > .panel'].map((cards) =>"
        " [...document.querySelectorAll(cards)].map((card) => card.getBoundingClientRect().top))"
    )
    assert [len(set(own)) for own in tops] == [1, 1]
    assert min(map(len, tops)) > 1
    heat, card = browser.execute_script(
        "const heat = document.getElementById('heat');"
        "return [heat, heat.parentNode].map((node) => node.getBoundingClientRect().width)"
    )
    assert card - 40 < heat < card
    near = browser.execute_script(
        """
        const plots = [...document.querySelectorAll("#panels .plot")];
        return plots.flatMap((plot) => [...plot.querySelectorAll(".name")].flatMap((name) => {
          const box = name.getBBox(), right = box.x + box.width, low = box.y + box.height;
          return [...plot.querySelectorAll(".winner")].map((ring) => {
            const [x, y, r] = ["cx", "cy", "r"].map((key) => Number(ring.getAttribute(key)));
            const [dx, dy] = [Math.max(box.x - x, x - right, 0), Math.max(box.y - y, y - low, 0)];
            return Math.hypot(dx, dy) - r;
          });
        }));
        """
    )
    assert near
    assert min(near) > 0


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
        visit(browser, tmp_path)
        tops = browser.execute_script(
            "return [...document.querySelectorAll('#panels > .panel')].map("
            "(panel) => panel.getBoundingClientRect().top)"
        )
    assert len(tops) == 5
    assert len(set(tops[:4])) == 1
    assert 0 < tops[0] < 450 < tops[4]


def test_on_a_phone_the_bar_stays_in_sight_and_nothing_is_cut(browser, site):
    with screen(browser, 420, 900):
        visit(browser, site)
        top, bottom, wide, room = browser.execute_script(
            """
            document.getElementById("heat-head").scrollIntoView();
            const bar = document.getElementById("question"), box = bar.getBoundingClientRect();
            const pen = document.createElement("canvas").getContext("2d");
            const room = [...bar.querySelectorAll("select, input")].map((node) => {
              const { left, right, width } = node.getBoundingClientRect();
              pen.font = getComputedStyle(node).font;
              const text = node.selectedOptions?.[0].text ?? node.value;
              return [node.name, left, right, width - pen.measureText(text).width];
            });
            return [box.top, box.bottom, document.documentElement.scrollWidth, room];
            """
        )
    assert (top, wide) == (0, 420)
    assert 30 < bottom < 100
    assert [own[0] for own in room] == ["group", "target", "norm", "cost", "scenes", "highlight"]
    for name, left, right, beside in room:
        assert left >= 0, name
        assert right <= 420, name
        assert beside > 0, name


HIDDEN = """
return [...document.querySelectorAll("#panels .curve, #profile .curve")].map(
  (curve) => [stepbench.data.methods[curve.dataset.method].label, !curve.getClientRects().length]);
"""


def hidden_methods(browser):
    """Labels of the methods of which no chart has a curve, if all charts agree."""
    curves = {tuple(pair) for pair in browser.execute_script(HIDDEN)}
    assert len(curves) == len(dict(curves))
    return {label for label, off in curves if off}


def test_a_legend_hides_and_shows_methods_in_all_charts(browser, site):
    from selenium.webdriver.common.action_chains import ActionChains
    from selenium.webdriver.common.keys import Keys

    visit(browser, site)
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
        tip = browser.find_element("css selector", ".tip strong").get_attribute("textContent")
        assert tip.strip() == first
    assert "target=1e-2&" in browser.current_url
    assert all(f"={label}" not in browser.current_url for label in labels)
    assert browser.get_log("browser") == []


def test_the_legend_of_a_large_chart_hides_methods_too(browser, site):
    from selenium.webdriver.common.keys import Keys

    browser.get("about:blank")
    browser.get((site / "report" / "scene-pendulum.html").as_uri())
    off = "return [...document.querySelectorAll('.curve.off')].map((c) => c.dataset.method)"
    entry = browser.find_element("css selector", ".legend .entry")
    own = entry.get_attribute("data-method")
    curves = browser.execute_script("return document.querySelectorAll('.plot.large .curve').length")
    assert browser.execute_script(off) == []
    entry.send_keys(Keys.ENTER)
    assert browser.execute_script(off) == [own]
    assert browser.execute_script("return document.activeElement.dataset.method") == own
    entry.click()
    assert browser.execute_script(off) == []
    entry.send_keys(Keys.SHIFT, Keys.ENTER)
    assert len(browser.execute_script(off)) == curves - 1
    assert own not in browser.execute_script(off)


def test_a_panel_becomes_large_in_its_place_and_escape_closes_it(browser, site):
    from selenium.webdriver.common.keys import Keys

    visit(browser, site)
    wide = (
        "return [...document.querySelectorAll('.panel svg.plot')].map((plot) => plot.clientWidth)"
    )
    before = browser.execute_script(wide)
    one, two = browser.find_elements("css selector", "button.enlarge")
    large = "return [...document.querySelectorAll('.plot.large')].map((plot) => plot.ariaLabel)"
    for button, name in ((one, "spring mass"), (two, "pendulum")):
        button.click()
        (said,) = browser.execute_script(large)
        assert said.startswith(f"{name}: error in")
        assert button.get_attribute("aria-expanded") == "true"
        assert max(browser.execute_script(wide)) > 1.5 * max(before)
    browser.switch_to.active_element.send_keys(Keys.ESCAPE)
    assert browser.execute_script(large) == []
    assert browser.execute_script(wide) == before
    assert two == browser.switch_to.active_element
    assert browser.get_log("browser") == []
