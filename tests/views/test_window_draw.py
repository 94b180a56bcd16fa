"""Drawing on the page, in a real browser: what a mouse draws comes out of the emulator."""

import json

import numpy as np
import pytest

from smarttouch.emulator.firmware import read_delivered
from smarttouch.instruments.drawing_source import DrawSource

from ..waiting import until
from .browser import opened, violations

pytestmark = pytest.mark.usefixtures("patient_boards")


def stroke(page, *places):
    """Draw along rows and columns of the sketch of 8 x 8 electrodes."""
    box = page.locator("#sketch").bounding_box()
    at = [
        (box["x"] + (column + 0.5) * box["width"] / 8, box["y"] + (row + 0.5) * box["height"] / 8)
        for row, column in places
    ]
    page.mouse.move(*at[0])
    page.mouse.down()
    for place in at[1:]:
        page.mouse.move(*place, steps=4)
    page.mouse.up()


def numbers_of(run, letter):
    """Return the numbers of the sequences that a letter was delivered with."""
    return {
        number
        for number, each in [*run.results.items()]
        if number
        and each.sequence.intensity > 0.5
        and np.array_equal(each.tactile.activation[0] > 0, letter.ravel())
    }


def test_a_letter_drawn_by_hand_comes_out_of_the_emulator(browser, running, profile, tmp_path):
    letter = np.zeros((8, 8), bool)
    letter[1:7, 2] = letter[6, 2:6] = True
    source = DrawSource(profile)
    with running(source, board="emulator:", rate_hz=20, books=tmp_path) as run:
        with opened(browser, run.address) as page:
            page.wait_for_selector("#draw-card:not([hidden])")
            stroke(page, (1, 2), (6, 2), (6, 5))
            until(lambda: len(numbers_of(run, letter)) > 10)
            page.click("#stop")
            run.ended()
        numbers, _, current_ua = read_delivered(tmp_path)
        # On a busy machine the board drops what is late, and a stop cuts off what is under way.
        delivered = numbers_of(run, letter) & {*numbers[numbers < numbers[-1]].tolist()}
        assert delivered
        for number in delivered:
            expected = run.results[number].sequence.current_ua
            np.testing.assert_array_equal(current_ua[numbers == number], expected)


def test_lists_letters_and_keys(browser, running, profile, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    source = DrawSource(profile)
    with running(source, rate_hz=20) as run, opened(browser, run.address) as page:
        page.wait_for_selector("#draw-card:not([hidden])")
        page.fill("#letter", "T")
        until(lambda: source.message()["changes"] > 1)
        drawn = source.read(0).activation[0]
        assert drawn.any()
        page.click("#keep")
        page.wait_for_selector("#patterns li")
        page.select_option("#library", "sweep right")
        page.wait_for_selector("#patterns li:nth-child(9)")
        page.click("#draw-clear")
        until(lambda: not source.read(0).activation.any())
        page.focus("#sketch")
        for key in ("ArrowUp", "ArrowLeft", "Enter"):
            page.keyboard.press(key)
        until(lambda: source.read(0).activation[0].sum() == 1)
        page.click("#loop")
        page.wait_for_selector("#patterns li.now")
        page.click("#loop")
        until(lambda: source.message()["playing"] is None)
        page.click("#save-json")
        # The file is there before it is whole; the page says when it is.
        until(lambda: "drawing-1.json" in page.text_content("#draw-said"))
        assert len(json.loads((tmp_path / "drawing-1.json").read_text())["steps"]) == 9
        assert not run.stop.event.is_set()
        assert violations(page) == []


def test_what_is_felt_while_pressed_ends_with_the_stroke_of_whoever_steers(
    browser, running, profile
):
    source = DrawSource(profile)
    with running(source, rate_hz=20) as run, opened(browser, run.address) as page:
        page.wait_for_selector("#draw-card:not([hidden])")
        assert run.window.steering.steer(0)
        page.wait_for_selector("#draw-card[inert]")
        before = page.get_attribute("#sketch", "data-level")
        stroke(page, (1, 2), (6, 2))
        page.wait_for_timeout(300)
        assert not source.read(0).activation.any()
        assert page.get_attribute("#sketch", "data-level") == before
        run.window.steering.leave(0)
        page.wait_for_selector("#draw-card:not([inert])")
        page.click("#draw-fleeting")
        box = page.locator("#sketch").bounding_box()
        page.mouse.move(box["x"] + 3.5 * box["width"] / 8, box["y"] + 3.5 * box["height"] / 8)
        page.mouse.down(button="right")
        page.mouse.up(button="right")
        page.mouse.down()
        until(lambda: source.read(0).activation.any())
        page.mouse.up()
        until(lambda: not source.read(0).activation.any())
        # One stroke, and its end: the other button drew nothing.
        assert source.message()["changes"] == 3
