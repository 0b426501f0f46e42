"""Chromium for tests of pages, where it and its driver are installed."""

import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

CHROMIUM, DRIVER = shutil.which("chromium"), shutil.which("chromedriver")


@contextmanager
def chromium(*flags: str, logs: tuple[str, ...] = ("browser",), **preferences: str) -> Iterator:
    """A browser without a window, of 1400 x 1000 pixels."""
    from selenium import webdriver

    options = webdriver.ChromeOptions()
    options.binary_location = CHROMIUM or ""
    for flag in ("headless=new", "no-sandbox", "disable-gpu", "window-size=1400,1000", *flags):
        options.add_argument(f"--{flag}")
    options.set_capability("goog:loggingPrefs", dict.fromkeys(logs, "ALL"))
    if preferences:
        options.add_experimental_option("prefs", preferences)
    driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(DRIVER))
    try:
        yield driver
    finally:
        driver.quit()


def waited(ask: Callable[[], Any], seconds: float = 20.0) -> Any:
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        answer = ask()
        if answer:
            return answer
        time.sleep(0.05)
    raise AssertionError("waited in vain")


def each(browser: Any, selector: str, expression: str) -> list[Any]:
    """An expression of JavaScript for each node of a page that a selector finds."""
    script = f"return [...document.querySelectorAll(arguments[0])].map((node) => {expression});"
    return browser.execute_script(script, selector)


def visit(browser: Any, page: Path, fragment: str = "") -> None:
    """Load a page anew; it has no complaint."""
    browser.get("about:blank")
    browser.get(page.as_uri() + fragment)
    assert browser.get_log("browser") == []
