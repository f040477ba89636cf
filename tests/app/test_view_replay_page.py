"""The replay's page in a real browser, served by the command itself."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
from contextlib import contextmanager

import pytest
from axe_playwright_python.sync_playwright import Axe


@contextmanager
def serving(run_folder, *options):
    """Yield the page's address; at the end the command is left as by Ctrl-C, and has nothing to complain of."""
    command = (
        sys.executable,
        "-m",
        "sidelong.app",
        "replay",
        str(run_folder),
        "--view",
        "--set",
        "display.port=0",
        "--quiet",
        *options,
    )
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    try:
        url = next(match[1] for line in process.stdout if (match := re.search(r"replay: (http\S+)", line)))
        yield url
    finally:
        process.send_signal(signal.SIGINT)
        rest, _ = process.communicate(timeout=60)
    assert process.returncode == 0, rest


@pytest.fixture(scope="module")
def replayed(run_of_autopilot):
    with serving(run_of_autopilot, "--what-if", "requirement.side=right") as url:
        yield url


@pytest.fixture
def page(browser, replayed):
    page = browser.new_context(viewport={"width": 1280, "height": 860}, bypass_csp=True).new_page()
    complaints: list[str] = []
    page.on("console", lambda message: complaints.append(message.text))
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.goto(replayed)
    page.locator("#phase", has_text="watching").wait_for()
    yield page
    assert complaints == []
    page.context.close()


def test_there_are_no_buttons_of_a_flight(page):
    assert not page.locator("#buttons").is_visible()
    assert page.locator("#replay").is_visible()


def test_it_is_paused_sought_through_and_stepped_by_keys(page):
    page.locator("#map").focus()
    page.keyboard.press(" ")
    page.locator("#play", has_text="Play").wait_for()
    page.locator("#seek").fill("310")
    page.locator("#at", has_text="of").wait_for()
    page.locator("#clock", has_text="3:30").wait_for()  # it is watched from 100 s on
    stood = page.locator("#clock").inner_text()
    page.locator("#map").focus()
    page.keyboard.press("[")
    page.wait_for_function(f"document.querySelector('#clock').textContent !== '{stood}'")
    page.locator("#speed").select_option("50")
    page.locator("#play").click()
    page.locator("#play", has_text="Pause").wait_for()


def test_what_if_is_reported_next_to_it(page):
    page.locator("#log .what-if", has_text="what if: ").first.wait_for()
    assert page.locator("#legend li.what-if").is_visible()
    page.locator("#map .label", has_text="what if, ").wait_for()  # an aircraft of its own, with its height


def test_after_a_jump_the_strips_have_no_invented_lines_and_the_decisions_their_marks(page):
    page.locator("#map").focus()
    page.keyboard.press(" ")
    page.locator("#play", has_text="Play").wait_for()
    page.locator("#seek").fill("300")
    page.locator("#clock", has_text="3:2").wait_for()
    page.locator("#decided path").first.wait_for(state="attached")
    page.locator("#plots svg polyline").first.wait_for()
    steps_px = (
        page.locator("#plots svg")
        .first.locator("polyline")
        .evaluate_all(
            "all => all.flatMap((one) => { const x = [...one.points].map((p) => p.x);"
            " return x.slice(1).map((v, k) => v - x[k]); })"
        )
    )
    assert max(steps_px) < 30  # of 180 s over some 300 px: no line is longer than 10 s
    assert page.locator("#news").is_hidden()


@pytest.mark.parametrize("size", [(1440, 900), (390, 844)], ids="{0[0]}".format)
def test_everybody_can_read_it(page, size):
    page.set_viewport_size({"width": size[0], "height": size[1]})
    found = Axe().run(page, options={"runOnly": ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa"]})
    assert found.violations_count == 0, found.generate_report()
    assert page.evaluate("document.documentElement.scrollWidth") <= size[0]
