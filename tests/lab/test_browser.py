"""The page in a real browser: it turns, obeys the keyboard, takes files, diagnoses, and loads nothing from elsewhere."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from hydro_env.lab.session import Session, Settings
from tests.browser import BROWSER, needs_browser
from tests.lab.server import served

pytestmark = [pytest.mark.slow, needs_browser]
playwright = pytest.importorskip("playwright.sync_api", reason="needs Playwright: pip install playwright")

#: Milliseconds that the page may take on a busy machine; a diagnosis may take longer.
PATIENCE, LONG = 30_000, 900_000


@pytest.fixture(scope="module")
def opened(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """The page of a lab in Chromium, with `foreign` and `failures`: what it asked of others, and what went wrong on it."""
    base: Path = tmp_path_factory.mktemp("lab")
    with served(base / "out", base / "temporary") as (_, port, key), playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=BROWSER, args=["--no-sandbox", "--disable-gpu"])
        page = browser.new_page(viewport={"width": 1280, "height": 1000})
        page.set_default_timeout(PATIENCE)
        page.foreign, page.failures = [], []
        own = re.compile(rf"(http|ws)://127\.0\.0\.1:{port}/|data:|blob:")
        page.on("request", lambda request: own.match(request.url) or page.foreign.append(request.url))
        page.on("pageerror", lambda problem: page.failures.append(str(problem)))
        page.goto(f"http://127.0.0.1:{port}/?key={key}")
        page.wait_for_selector(".lab-motors")
        yield page
        browser.close()


def rpm(page: Any, motor: int) -> int:
    text = page.locator(".lab-numbers > div").nth(1 + motor).locator("dd").first.inner_text()
    return int(text.replace("\u2212", "-").removesuffix(" rpm"))


def choose(page: Any, label: str, option: str) -> None:
    page.get_by_label(label, exact=True).click()
    page.get_by_role("option", name=option, exact=True).click()


def settled(page: Any, wanted: int) -> None:
    """Waits until both motors run at a speed."""
    for _ in range(300):
        if max(abs(rpm(page, motor) - wanted) for motor in (1, 2)) <= 15:
            return
        page.wait_for_timeout(100)
    raise AssertionError(f"{rpm(page, 1)}, {rpm(page, 2)} instead of {wanted} rpm")


def test_the_key_does_not_stay_in_the_address(opened: Any) -> None:
    assert "key" not in opened.url


def test_shafts_turn_and_the_keyboard_moves_the_set_point(opened: Any) -> None:
    slider = opened.get_by_label("set-point by hand")
    slider.focus()
    slider.fill("-60")
    settled(opened, -600)
    opened.keyboard.press("PageUp")
    wanted = 10 * int(slider.input_value())
    assert -600 < wanted < 0
    opened.locator(f'input[aria-valuetext="{wanted} rpm"]').wait_for()
    settled(opened, wanted)
    hand = opened.locator(".lab-motors g").first
    before = hand.get_attribute("transform")
    opened.wait_for_timeout(150)
    assert hand.get_attribute("transform") != before
    opened.get_by_text("by hand", exact=True).wait_for()


def test_controllers_change_while_it_runs(opened: Any) -> None:
    opened.get_by_label("set-point by hand").fill("30")
    for name in ("gru", "probing_flow", "oracle", "cross_coupled"):
        choose(opened, "controller", name)
        settled(opened, 300)
    assert opened.locator(".lab-bad:visible").all_inner_texts().count("") == len(
        opened.locator(".lab-bad:visible").all()
    )


def test_an_effect_brakes_a_motor_and_is_taken_back(opened: Any) -> None:
    opened.get_by_label("set-point by hand").fill("30")
    choose(opened, "controller", "pid_tuned")
    opened.get_by_text(re.compile(r"^sensor \(")).click()
    gain = opened.get_by_label("measured over true speed, channel 2")
    gain.focus()
    opened.keyboard.press("End")
    opened.wait_for_function("() => parseInt(document.querySelector('.lab-big').innerText) > 60")
    opened.get_by_role("button", name="All as they were").click()
    settled(opened, 300)
    opened.wait_for_function("slider => slider.value === '0'", arg=gain.element_handle())


def test_a_screen_reader_is_told_and_everything_has_a_name(opened: Any) -> None:
    told = opened.locator("[role=status][aria-live=polite]").first
    opened.wait_for_function(
        "() => document.querySelector('[role=status]').innerText.startsWith('difference')"
    )
    first = told.inner_text()
    opened.wait_for_timeout(1500)
    assert (
        told.inner_text() == first or "difference" in told.inner_text()
    )  # no more often than every five seconds
    unnamed = opened.evaluate(
        """() => [...document.querySelectorAll('input, button, select, textarea, [role=checkbox]')]
        .filter(e => e.checkVisibility())
        .filter(e => !(e.labels && e.labels.length) && !e.getAttribute('aria-label') && !e.innerText.trim())
        .map(e => e.outerHTML)"""
    )
    assert unnamed == []
    headings = opened.get_by_role("heading").all_inner_texts()
    assert headings[:3] == ["hydro_env lab", "Rig", "Last ten seconds"]


@pytest.mark.parametrize("width", [1280, 400])
def test_nothing_is_wider_than_the_window(opened: Any, width: int) -> None:
    opened.set_viewport_size({"width": width, "height": 900})
    opened.wait_for_timeout(500)
    assert opened.evaluate("() => document.documentElement.scrollWidth") <= width
    opened.set_viewport_size({"width": 1280, "height": 1000})


def test_a_log_is_dropped_in_diagnosed_and_its_report_opened(opened: Any) -> None:
    session = Session(Settings(preset="paper", split="own", scenario="setpoint_steps"))
    session.record()
    for _ in range(900):
        session.step()
    session.stop_recording()
    files = opened.locator("input[type=file]")
    files.set_input_files([{"name": "a.exe", "mimeType": "", "buffer": b"1"}])
    opened.get_by_text("expected a log").wait_for()
    files.set_input_files(
        [{"name": "<b>mine.csv", "mimeType": "text/csv", "buffer": session.finished_log.encode()}]
    )
    opened.get_by_text("<b>mine.csv", exact=True).wait_for()
    choose(opened, "model to diagnose", "paper")
    opened.get_by_role("button", name="Diagnose").click()
    opened.get_by_text(re.compile(r"\d+ simulations")).wait_for()
    opened.get_by_role("button", name="Cancel").click()
    opened.get_by_text("cancelled").first.wait_for()
    opened.get_by_role("button", name="Diagnose").click()
    opened.get_by_role("link", name="Open the report").wait_for(timeout=LONG)
    with opened.context.expect_page() as other:
        opened.get_by_role("link", name="Open the report").click()
    report = other.value
    report.wait_for_load_state()
    assert "mine" in report.title() and report.url.endswith("/results/diagnosis_1/report.html")
    assert report.locator("svg").count() > 0
    report.close()


def test_it_asked_nobody_else_and_no_script_failed(opened: Any) -> None:
    assert opened.foreign == [] and opened.failures == []
