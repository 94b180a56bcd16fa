"""Tests of the window page in a browser: its drawing, steering, layout and privacy."""

import json
import stat
import threading
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import urlsplit
from urllib.request import url2pathname

import numpy as np
import pytest

from smarttouch.instruments.electric_mouse import open_texture_source
from smarttouch.views import window_server

from ..support.runs import until
from .browser import AXE, opened
from .conftest import colors, drawn, strongest


@pytest.fixture
def on_page(browser, running):
    """Return a context manager that yields a run and its page after the first drawing."""

    @contextmanager
    def show(width=800, height=700, media=None, **options):
        media = media or {}
        with (
            running(rate_hz=20, **options) as run,
            opened(browser, run.address, width, height, **media) as page,
        ):
            page.wait_for_selector("#electrodes[data-number]")
            yield run, page

    return show


def test_pixels_are_the_delivered_sequence(on_page, profile):
    def driven():
        """Return the drawing and its sequence, or None if a late computer left it empty."""
        found = drawn(page, profile)
        sequence = run.results[found["number"]].sequence
        return (found, sequence) if sequence.slots else None

    with on_page() as (run, page):
        until(lambda: len(run.results) > 25)
        for _ in range(3):
            found, sequence = until(driven)
            expected = colors(strongest(sequence), profile)
            assert np.array_equal(found["colors"], expected)
            page.wait_for_timeout(100)
        page.click("#slot-after")
        sequence = run.results[drawn(page, profile)["number"]].sequence
        for slot in range(sequence.slots):
            found = drawn(page, profile)
            assert found["slot"] == str(slot)
            assert np.array_equal(found["colors"], colors(sequence.current_ua[slot], profile))
            page.click("#slot-after")
        assert "12 by 8" in page.get_attribute("#sensor", "aria-label")


def test_a_second_page_takes_over_when_the_first_is_closed_and_can_always_stop(on_page, browser):
    with on_page() as (run, page):
        with opened(browser, run.address) as first:
            first.wait_for_selector("#status.runs")
            first.keyboard.press("-")
            until(lambda: run.state().level < 1)
            page.wait_for_selector("#less:disabled")
        until(lambda: run.state().paused)
        page.wait_for_selector("#pause[aria-pressed=true]:enabled")
        page.click("#pause")
        until(lambda: not run.state().paused)
        page.wait_for_selector("#steer[aria-pressed=true]")
        # Space pauses the run on the page that steers, and stops the run on any other page.
        with opened(browser, run.address) as other:
            # `less` shows that the page does not steer. (At full level, `more` is always disabled.)
            other.wait_for_selector("#less:disabled")
            other.keyboard.press("Space")
            assert run.ended() == "the window"


def test_the_browser_is_led_to_the_page_by_a_private_file(browser, running, monkeypatch):
    """Any user can read the arguments of the browser, so they must not contain the secret."""
    given, read = threading.Event(), threading.Event()

    def told(address):
        given.address = address
        given.set()
        read.wait(60)

    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr(window_server.webbrowser, "open", told)
    monkeypatch.setattr(window_server, "_FILE_KEPT_S", 0.0)
    with running(rate_hz=20, show=window_server.open_browser) as run:
        assert given.wait(60)
        path = Path(url2pathname(urlsplit(given.address).path))
        assert urlsplit(run.address).path.split("/")[1] not in given.address
        assert [stat.S_IMODE(each.stat().st_mode) for each in (path.parent, path)] == [0o700, 0o600]
        page = browser.new_page()
        page.goto(given.address)
        page.wait_for_url(run.address)
        page.wait_for_selector("#electrodes[data-number]")
        page.close()
        read.set()
        until(lambda: not path.parent.exists())


def test_the_pointer_in_a_browser_is_the_hand(browser, running, profile):
    def is_near(pose):
        return abs(pose.x_mm - 20) < 2 and abs(pose.y_mm + 10) < 2

    grating = open_texture_source("grating:4mm?motion=page", profile)
    with running(grating) as run, opened(browser, run.address) as page:
        page.wait_for_selector("#page[data-x='0.00']")
        box = page.locator("#page").bounding_box()
        middle = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        page.mouse.move(*middle)
        mm_per_px = 100 / box["height"]  # the sheet, 100 mm high, is shown in full
        page.mouse.move(middle[0] + 20 / mm_per_px, middle[1] - 10 / mm_per_px, steps=30)
        until(lambda: any(is_near(each.input.pose) for each in [*run.results.values()]))
        assert json.loads(run.window.hello)["moves"]


def test_a_keyboard_is_enough(on_page):
    with on_page() as (run, page):
        page.focus("#more")
        for key, holds in (
            ("-", lambda: run.state().level < 1), ("Space", lambda: run.state().paused),
            ("Space", lambda: not run.state().paused), ("x", lambda: run.source.pressed),
            ("0", lambda: not run.state().level),
        ):  # fmt: skip
            page.keyboard.press(key)
            until(holds)
            page.wait_for_selector("#steer[aria-pressed=true]")
            # Wait for the new state: the effect of the next key depends on the state shown.
            page.wait_for_selector(f"#pause[aria-pressed={str(run.state().paused).lower()}]")
        page.focus("#slider")
        for key, level in (("End", 1), ("Home", 0), ("ArrowRight", 0.01)):
            page.keyboard.press(key)
            until(lambda level=level: run.state().level == level)
        page.wait_for_selector("#events :text('intensity 0.01')")
        reached = set()
        for _ in range(40):
            page.keyboard.press("Tab")
            reached.add(page.evaluate("document.activeElement.id"))
        buttons = page.evaluate(
            "[...document.querySelectorAll('button[id]:enabled')]"
            ".filter(each => each.offsetParent).map(each => each.id)"
        )
        assert {*buttons} <= reached
        page.keyboard.press("Escape")
        assert run.ended() == "the window"
        page.wait_for_selector("#stop:disabled")
        assert page.is_disabled("#less")


def test_it_fits_a_phone_and_respects_reduced_motion(on_page):
    with on_page(360, 640, media={"reduced_motion": "reduce"}) as (run, page):
        page.click("#slow")
        slot = page.inner_text("#slot")
        page.wait_for_timeout(400)
        assert page.inner_text("#slot") == slot
        assert page.evaluate("document.documentElement.scrollWidth") == 360
        page.evaluate("scrollTo(0, document.body.scrollHeight)")
        assert page.locator("#stop").bounding_box()["height"] >= 44
        page.click("#stop")
        assert run.ended() == "the window"


@pytest.mark.skipif(not AXE.is_file(), reason="needs: npm install --prefix build/axe axe-core")
def test_axe_finds_nothing(on_page):
    with on_page() as (_, page):
        page.click("#table-more summary")
        # The page's security policy blocks loading this script, but not injecting it.
        page.evaluate(AXE.read_text("utf-8"))
        for scheme in ("light", "dark"):
            page.emulate_media(color_scheme=scheme)
            found = page.evaluate("axe.run(document, {resultTypes: ['violations']})")
            assert found["violations"] == []
