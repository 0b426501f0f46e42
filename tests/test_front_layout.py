"""The layout of the front page in Chromium: cards, screens, legends, large panels."""

from __future__ import annotations

from contextlib import contextmanager

import pytest
from chromium import chromium, in_chromium
from planted import everything, plant, planted
from test_front_page import choose, visit

from reports.pages.html_report import write_html_report


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = plant(tmp_path_factory.mktemp("planted"), everything())
    write_html_report(path)
    return path


@pytest.fixture(scope="module")
def page():
    with chromium() as driver:
        yield driver


@in_chromium
def test_cards_stand_in_rows_and_names_beside_rings(page, folder):
    visit(page, folder)
    tops = page.execute_script(
        "return ['.opening > .card', '#panels > .panel'].map((cards) =>"
        " [...document.querySelectorAll(cards)].map((card) => card.getBoundingClientRect().top))"
    )
    assert [len(set(own)) for own in tops] == [1, 1]
    assert min(map(len, tops)) > 1
    heat, card = page.execute_script(
        "const heat = document.getElementById('heat');"
        "return [heat, heat.parentNode].map((node) => node.getBoundingClientRect().width)"
    )
    assert card - 40 < heat < card
    near = page.execute_script(
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
def screen(page, width, height):
    """A screen of this size, in pixels of CSS."""
    size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 600}
    page.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    try:
        yield
    finally:
        page.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})


@in_chromium
def test_the_first_row_of_charts_is_in_sight_four_in_a_row(page, tmp_path):
    scenes = ("duffing", "oscillator", "friction")
    more = [planted(scene, "poor", {"a": (1.0, 1)}, h=0.1) for scene in scenes]
    write_html_report(plant(tmp_path, everything() + more))
    with screen(page, 1400, 900):
        visit(page, tmp_path)
        tops = page.execute_script(
            "return [...document.querySelectorAll('#panels > .panel')].map("
            "(panel) => panel.getBoundingClientRect().top)"
        )
    assert len(tops) == 5
    assert len(set(tops[:4])) == 1
    assert 0 < tops[0] < 450 < tops[4]


@in_chromium
def test_on_a_phone_the_bar_stays_in_sight_and_nothing_is_cut(page, folder):
    with screen(page, 420, 900):
        visit(page, folder)
        top, bottom, wide, room = page.execute_script(
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


def hidden_methods(page):
    """Labels of the methods of which no chart has a curve, if all charts agree."""
    curves = {tuple(pair) for pair in page.execute_script(HIDDEN)}
    assert len(curves) == len(dict(curves))
    return {label for label, off in curves if off}


@in_chromium
def test_a_legend_hides_and_shows_methods_in_all_charts(page, folder):
    from selenium.webdriver.common.action_chains import ActionChains
    from selenium.webdriver.common.keys import Keys

    visit(page, folder)
    labels = page.execute_script("return stepbench.data.methods.map((m) => m.label)")
    assert hidden_methods(page) == set()
    *_, one, two = page.find_elements("css selector", ".chooser .switch:has(.badge)")
    first, second = (labels[int(node.get_attribute("data-method"))] for node in (one, two))
    everything = page.find_element("css selector", ".chooser .switch")
    one.click()
    assert hidden_methods(page) == {first}
    assert one.get_attribute("aria-pressed") == "false"
    choose(page, "target", "1e-2")  # the next question keeps it
    assert hidden_methods(page) == {first}
    one.send_keys(Keys.ENTER)
    assert hidden_methods(page) == set()
    ActionChains(page).double_click(two).perform()
    assert hidden_methods(page) == set(labels) - {second}
    everything.send_keys(Keys.SPACE)
    assert hidden_methods(page) == set()
    one.send_keys(Keys.SHIFT, Keys.ENTER)
    assert hidden_methods(page) == set(labels) - {first}
    # Neither pointer nor keys find hidden runs.
    own = f".plot:has(.curve[data-method='{labels.index(first)}'])"
    plot = page.find_element("css selector", own)
    for key in (Keys.ARROW_RIGHT, Keys.ARROW_RIGHT, Keys.ARROW_DOWN, Keys.ARROW_LEFT):
        plot.send_keys(key)
        tip = page.find_element("css selector", ".tip strong").get_attribute("textContent")
        assert tip.strip() == first
    assert "target=1e-2&" in page.current_url
    assert all(f"={label}" not in page.current_url for label in labels)
    assert page.get_log("browser") == []


@in_chromium
def test_the_legend_of_a_large_chart_hides_methods_too(page, folder):
    from selenium.webdriver.common.keys import Keys

    page.get("about:blank")
    page.get((folder / "report" / "scene-pendulum.html").as_uri())
    off = "return [...document.querySelectorAll('.curve.off')].map((c) => c.dataset.method)"
    entry = page.find_element("css selector", ".legend .entry")
    own = entry.get_attribute("data-method")
    curves = page.execute_script("return document.querySelectorAll('.plot.large .curve').length")
    assert page.execute_script(off) == []
    entry.send_keys(Keys.ENTER)
    assert page.execute_script(off) == [own]
    assert page.execute_script("return document.activeElement.dataset.method") == own
    entry.click()
    assert page.execute_script(off) == []
    entry.send_keys(Keys.SHIFT, Keys.ENTER)
    assert len(page.execute_script(off)) == curves - 1
    assert own not in page.execute_script(off)


@in_chromium
def test_a_panel_becomes_large_in_its_place_and_escape_closes_it(page, folder):
    from selenium.webdriver.common.keys import Keys

    visit(page, folder)
    wide = (
        "return [...document.querySelectorAll('.panel svg.plot')].map((plot) => plot.clientWidth)"
    )
    before = page.execute_script(wide)
    one, two = page.find_elements("css selector", "button.enlarge")
    large = "return [...document.querySelectorAll('.plot.large')].map((plot) => plot.ariaLabel)"
    for button, name in ((one, "spring mass"), (two, "pendulum")):
        button.click()
        (said,) = page.execute_script(large)
        assert said.startswith(f"{name}: error in")
        assert button.get_attribute("aria-expanded") == "true"
        assert max(page.execute_script(wide)) > 1.5 * max(before)
    page.switch_to.active_element.send_keys(Keys.ESCAPE)
    assert page.execute_script(large) == []
    assert page.execute_script(wide) == before
    assert two == page.switch_to.active_element
    assert page.get_log("browser") == []
