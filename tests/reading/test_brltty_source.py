"""Cells under the finger, with a clock and a connection that the test sets."""

from itertools import pairwise

import numpy as np
import pytest

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import ReadingError, SourceError
from smarttouch.braille.cells import dots_to_cells
from smarttouch.profile import load_profile
from smarttouch.reading.braille_lines import Presentation
from smarttouch.reading.brltty_connection import DisplayContent
from smarttouch.reading.brltty_source import REST_S, BrailleDisplaySource, open_brltty

from ..raising import raises

PROFILE = load_profile("electric-mouse")
ARRAY = (8, 8)


class ScriptedDisplay:
    """Stands in for a connection: shows what a test says, and keeps the commands."""

    address = "nowhere"

    def __init__(self):
        self.shown = None
        self.sent = []
        self.send = self.sent.append

    def show(self, cells):
        number = self.shown.number if self.shown else 0
        self.shown = DisplayContent(cells, number=number + 1)

    def close(self):
        """Have nothing to close."""


class Finger:
    """A source with its clock."""

    def __init__(self, presentation=Presentation.CELL, cells_a_s=1.0, **options):
        self.line = ScriptedDisplay()
        plain = BrailleDisplaySource(self.line, PROFILE)
        speed_mm_s = cells_a_s * plain.layout.cell_mm
        self.source = BrailleDisplaySource(self.line, PROFILE, presentation, speed_mm_s, **options)
        self._time_ns = 0

    def after(self, seconds=0.0):
        """Return the stimulus so many seconds later."""
        self._time_ns += round(seconds * 1e9)
        return self.source.read(self._time_ns)

    def cell(self, seconds=0.0):
        """Return the cell in the middle of the array so many seconds later; blank if none."""
        window = self.window(self.after(seconds))
        layout, margin = self.source.layout, self.source.layout.margin
        top = (layout.rows - layout.height) // 2
        rows = top + layout.dot_y * np.array([0, 1, 2, 0, 1, 2, 3, 3])
        columns = margin + layout.dot_x * np.array([0, 0, 0, 1, 1, 1, 0, 1])
        assert window.sum() == window[rows, columns].sum()
        return dots_to_cells(window[rows, columns][None])

    @staticmethod
    def window(stimulus):
        """Return which electrodes are active, alike for every class."""
        activation = stimulus.activation
        np.testing.assert_array_equal(activation, np.tile(activation[:1], (len(Afferent), 1)))
        return activation[0].reshape(ARRAY) > 0


def test_without_brltty_nothing_is_felt():
    finger = Finger()
    assert finger.after().stale
    finger.line.show("⠓")
    assert not finger.after(0.02).stale
    finger.line.shown = None
    assert finger.after(0.02).stale


def test_cells_come_one_by_one_with_a_gap_before_each():
    finger = Finger()
    finger.line.show("⠓⠓⣊⠀⠞⠀⠀")
    assert finger.cell() == "⠀"
    felt = [finger.cell(1.0 if index else 0.5) for index in range(6)]
    assert "".join(felt) == "⠓⠓⣊⠀⠞⠀"
    assert finger.source.at_end
    assert finger.cell(0.5) == "⠀"


def test_a_line_moves_through_electrode_by_electrode():
    finger = Finger(Presentation.LINE)
    finger.line.show("⠓⠊⠞")
    layout = finger.source.layout
    first = finger.window(finger.after())
    windows = [finger.window(finger.after(REST_S))]
    for _ in range(4 * layout.cell):
        windows.append(finger.window(finger.after(1 / layout.cell)))
    np.testing.assert_array_equal(first, windows[0])
    for before, now in pairwise(windows):
        np.testing.assert_array_equal(now[:, :-1], before[:, 1:])
    assert not windows[-1].any()
    assert finger.source.at_end


def test_what_was_typed_is_felt_and_not_the_line_again():
    finger = Finger()
    finger.line.show("⠓⠊⣀⠀")
    finger.cell(0.5)
    finger.cell(9.0)
    finger.line.show("⠓⠊⠞⣀")
    finger.cell()
    assert finger.cell(0.5) == "⠞"
    assert finger.cell(1.0) == "⣀"


def test_the_cursor_is_followed_but_not_its_blinking():
    finger = Finger()
    finger.line.show("⠓⠊⠞⣀")
    finger.cell(0.5)
    finger.line.show("⣓⠊⠞⠀")
    finger.cell()
    assert finger.cell(0.5) == "⣓"
    assert finger.cell(1.0) == "⠊"
    for cells in ("⠓⠊⠞⠀", "⣓⠊⠞⠀"):
        finger.line.show(cells)
        finger.cell()
    assert finger.cell(1.0) == "⠞"


def test_keys_move_the_finger_and_command_brltty():
    finger = Finger()
    finger.line.show("⠓⠊⠞⠎")
    finger.cell(0.5)
    keys = finger.source.keys
    for key, place in (("]", "⠊"), ("]", "⠞"), ("[", "⠊"), ("r", "⠓"), ("[", "⠓")):
        keys[key]()
        finger.cell()
        assert finger.cell(0.5) == place
    finger.cell(2.0)
    for key in ("right", "left", "n", "p", "h", "\n", "\r"):
        keys[key]()
    assert finger.line.sent == ["fwinrt", "fwinlt", "lndn", "lnup", "home", "route 2", "route 2"]
    keys[" "]()
    assert [finger.cell(5.0) for _ in range(2)] == ["⠞", "⠞"]
    keys[" "]()
    finger.cell()
    assert finger.cell(1.0) == "⠎"


def test_the_window_moves_on_by_itself_once():
    finger = Finger(pan=True)
    finger.line.show("⠓⠊")
    finger.after()
    for _ in range(30):
        finger.after(0.1)
    assert finger.line.sent == ["fwinrt"]
    finger.line.show("⠞⠎")
    for _ in range(30):
        finger.after(0.1)
    assert finger.line.sent == ["fwinrt"] * 2


def test_a_lost_line_stays_where_it_was():
    finger = Finger()
    finger.line.show("⠓⠊⠞")
    finger.cell()
    assert finger.cell(0.5) == "⠓"
    shown, finger.line.shown = finger.line.shown, None
    finger.after(60.0)
    finger.line.shown = shown
    assert finger.cell(1.0) == "⠊"


def test_updates_that_were_never_read_are_counted():
    finger = Finger()
    for cells in ("⠓", "⠊", "⠞"):
        finger.line.show(cells)
    numbers = {finger.after(0.02).number for _ in range(50)}
    assert finger.source.dropped_frames == 2
    assert finger.source.frames == len(numbers) + 2


@pytest.mark.parametrize("url", ["listen:1?show=page", "listen:0", "127.0.0.1:1?cells=0"])
def test_what_cannot_be_opened(url):
    rest, _, option = url.partition("?")
    name, _, value = option.partition("=")
    options = {name: int(value) if value.isdigit() else value} if name else {}
    with pytest.raises(SourceError):
        open_brltty(rest, PROFILE, **options)


def test_an_array_too_small_for_cells():
    BrailleDisplaySource(ScriptedDisplay(), load_profile("smarttouch-4x4"))
    with raises(ReadingError, names="profile"):
        open_brltty("listen:1", load_profile("line-7"))


@pytest.mark.parametrize("speed_mm_s", [0.0, 1e5, float("nan")])
def test_impossible_speeds(speed_mm_s):
    with raises(SourceError):
        BrailleDisplaySource(ScriptedDisplay(), PROFILE, speed_mm_s=speed_mm_s)
