"""The pages in a real headless Chromium: they draw, they answer to mouse and keys, and nothing complains."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from report_files import HOSTILE, write_run
from small_files import small_map

from tools.report import Wanted, write_report
from tools.settings import ToolSettings

OPEN = Callable[..., Any]

INKED = """
const canvas = document.querySelector(arguments[0]), context = canvas.getContext("2d");
const { data } = context.getImageData(0, 0, canvas.width, canvas.height);
const seen = new Set();
for (let k = 0; k < data.length; k += 4) if (data[k + 3]) seen.add((data[k] << 16) | (data[k + 1] << 8) | data[k + 2]);
return seen.size;
"""
"""How many colours there are on a canvas."""


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A page of each sort."""
    folder = tmp_path_factory.mktemp("pages")
    semantic_map = replace(small_map(), sources={HOSTILE: "0" * 64}, crs=HOSTILE)
    run = write_run(folder, semantic_map)
    other = write_run(folder / "second", semantic_map, off=0.5)
    sources = {"mine": [folder / "mine.h5"], "run": [run], "both": [run, other]}
    for name, some in sources.items():
        write_report(some, Wanted(folder / f"{name}.html"), ToolSettings())
    return {name: folder / f"{name}.html" for name in sources}


@pytest.fixture
def show(browser: Any, pages: dict[str, Path]) -> OPEN:
    """Opens a page, waits until it has drawn itself, and checks that the console is silent."""
    from selenium.webdriver.support.ui import WebDriverWait

    def opened(name: str, *, width: int = 1200, fragment: str = "") -> Any:
        screen = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": width < 600}
        browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", screen)
        browser.get("about:blank")
        browser.get(f"file://{pages[name]}{fragment}")
        ready = "return document.body.dataset.ready === 'yes' && !!document.querySelector('#plan canvas').width"
        WebDriverWait(browser, 20, poll_frequency=0.05).until(lambda page: page.execute_script(ready))
        settle(browser)
        assert console(browser) == []
        return browser

    return opened


def console(browser: Any) -> list[str]:
    """What the page complained of since the last look."""
    return [entry["message"] for entry in browser.get_log("browser")]


def settle(browser: Any) -> None:
    """Wait until what was asked for is painted."""
    script = "const done = arguments[0]; requestAnimationFrame(() => requestAnimationFrame(() => setTimeout(done, 60)))"
    browser.execute_async_script(script)


def text(browser: Any, selector: str) -> str:
    """What an element says."""
    return str(browser.execute_script("return document.querySelector(arguments[0]).textContent", selector))


def press(browser: Any, selector: str, *keys: str) -> None:
    """Keys to an element that has the focus."""
    element = browser.find_element("css selector", selector)
    browser.execute_script("arguments[0].focus()", element)
    element.send_keys(*keys)
    settle(browser)


def test_complaints_would_be_seen(browser: Any) -> None:
    browser.get("data:text/html,<script>undefined.x</script>")
    assert any("TypeError" in message for message in console(browser))


@pytest.mark.parametrize("name", ["mine", "run", "both"])
@pytest.mark.parametrize("width", [1200, 400])
def test_a_page_draws_itself_and_fits_the_screen(show: OPEN, name: str, width: int) -> None:
    browser = show(name, width=width)
    size = "return [document.documentElement.scrollWidth, window.innerWidth]"
    wide, screen = browser.execute_script(size)
    assert screen == width and wide <= width
    assert browser.execute_script(INKED, "#plan canvas") > 5
    for table in browser.find_elements("css selector", "table"):
        assert table.find_elements("css selector", "tbody tr") or not table.is_displayed()
    assert browser.title != "owned" and not browser.find_elements("css selector", "img")


def test_a_click_on_an_intersection_shows_it(show: OPEN) -> None:
    from selenium.webdriver import ActionChains

    browser = show("mine")
    assert text(browser, "#which") == "Intersection 3"
    canvas = browser.find_element("css selector", "#plan canvas")
    # the two intersections lie at the left end and in the middle of 60 m of roadway
    marks = browser.execute_script("return [page.intersections.x, page.intersections.y, page.plan.ends]")
    low, high = marks[0][0] - 8, marks[2][0][0] + 8
    across = 54 + (canvas.size["width"] - 60) * (marks[0][1] - low) / (high - low)
    seen = hovered(browser, canvas, across)
    ActionChains(browser).move_to_element_with_offset(canvas, *seen).click().perform()
    settle(browser)
    assert text(browser, "#which") == "Intersection 8"
    assert browser.execute_script(INKED, "#cloud canvas") > 20
    assert browser.execute_script("return document.querySelectorAll('#polar path').length") >= 1
    assert browser.execute_script(INKED, "#unrolled canvas") > 10
    assert browser.current_url.endswith("#8")
    assert console(browser) == []


def hovered(browser: Any, canvas: Any, across: float) -> tuple[int, int]:
    """An offset from the middle of the plan at which its hint tells of intersection 8, near ``across`` pixels."""
    from selenium.webdriver import ActionChains

    width, height = canvas.size["width"], canvas.size["height"]
    for down in range(20, height - 50, 12):
        offset = (round(across - width / 2), round(down - height / 2))
        ActionChains(browser, duration=0).move_to_element_with_offset(canvas, *offset).perform()
        settle(browser)
        tip = browser.find_element("css selector", "#plan .tip")
        if tip.is_displayed() and tip.text.startswith("8: X, 4 roadways"):
            return offset
    raise AssertionError("no hint told of intersection 8")


def test_keys_go_from_intersection_to_intersection(show: OPEN) -> None:
    from selenium.webdriver.common.keys import Keys

    browser = show("mine")
    press(browser, "#plan canvas", Keys.ARROW_RIGHT)
    assert "8: X" in text(browser, "#plan .tip")
    press(browser, "#plan canvas", Keys.ENTER)
    assert text(browser, "#which") == "Intersection 8"
    before = browser.execute_script("return document.querySelector('#cloud canvas').toDataURL()")
    press(browser, "#cloud canvas", Keys.ARROW_LEFT, "+")
    assert browser.execute_script("return document.querySelector('#cloud canvas').toDataURL()") != before
    press(browser, "#matrix-cwc canvas", Keys.ARROW_RIGHT)
    assert text(browser, "#matrix-cwc [aria-live]").startswith("3 and 8: ")
    press(browser, "#table tbody tr", Keys.ENTER)
    assert text(browser, "#which") == "Intersection 3"
    assert console(browser) == []


def test_a_number_or_a_link_leads_to_an_intersection(show: OPEN) -> None:
    browser = show("mine", fragment="#8")
    assert text(browser, "#which") == "Intersection 8"
    browser.find_element("css selector", "#after").click()
    settle(browser)
    assert text(browser, "#which") == "Intersection 3"


def test_tables_are_sorted_and_searched(show: OPEN) -> None:
    browser = show("run")
    browser.find_element("css selector", "#sights select").send_keys("all")
    header = browser.find_elements("css selector", "#sights th button")[1]
    header.click()
    cells = [row.text for row in browser.find_elements("css selector", "#sights tbody td:nth-child(2)")]
    assert cells == ["3", "8"]
    header.click()
    cells = [row.text for row in browser.find_elements("css selector", "#sights tbody td:nth-child(2)")]
    assert cells == ["8", "3"]


def test_an_event_shows_its_scores_and_what_was_laid_over_the_map(show: OPEN) -> None:
    browser = show("run")
    assert text(browser, "#which") == "Intersection 8 at 4.0 s"
    assert "database, 200 points" in text(browser, "#cloud .legend")
    assert "keyframes, by ICP, 300 points" in text(browser, "#cloud .legend")
    assert "0.912" in text(browser, "#figures")
    browser.find_element("css selector", "#after").click()
    settle(browser)
    assert text(browser, "#reason") == f"Refused: {HOSTILE}"
    assert browser.title != "owned"
    assert console(browser) == []


def test_the_time_that_is_pointed_at_is_shown_on_the_plan(show: OPEN) -> None:
    from selenium.webdriver import ActionChains

    browser = show("run")
    figure = browser.find_element("css selector", "#position [data-time-axis]")
    browser.execute_script("arguments[0].scrollIntoView({block: 'center'})", figure)
    ActionChains(browser).move_to_element(figure).perform()
    settle(browser)
    lines = browser.execute_script("return [...document.querySelectorAll('.cursor')].map((line) => line.hidden)")
    assert len(lines) >= 4 and not any(lines)
    inked = browser.execute_script(INKED, "#plan canvas")
    choose = browser.find_element("css selector", "#plan select")
    for name in ("state", "mode", "nothing"):
        choose.send_keys(name)
        settle(browser)
    assert inked > 5 and console(browser) == []


def test_compared_runs_can_be_hidden(show: OPEN) -> None:
    browser = show("both")
    assert len(browser.find_elements("css selector", "#plan input[type=checkbox]")) == 3
    before = browser.execute_script("return document.querySelector('#plan canvas').toDataURL()")
    browser.find_element("css selector", "#plan input[type=checkbox]").click()
    settle(browser)
    assert browser.execute_script("return document.querySelector('#plan canvas').toDataURL()") != before
