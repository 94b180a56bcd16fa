"""Source for BRLTTY: messages, cells under the finger, and restarts of a real BRLTTY."""

import re
import socket
import time
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import SourceError
from smarttouch.braille.cells import dots_to_cells
from smarttouch.profile import load_profile
from smarttouch.reading.braille_lines import cell_layout
from smarttouch.reading.brltty_display import (
    MOST_CELLS,
    REST_S,
    BrailleDisplaySource,
    DisplayContent,
    parse_message,
)

from ..support.full import WHOLE
from ..support.runs import until
from .real_brltty import Brltty, cells_of, free_port, require_brltty

PROFILE = load_profile("electric-mouse")
CELLS = st.text(st.characters(min_codepoint=0x2800, max_codepoint=0x28FF), min_size=1, max_size=40)


def said(cells, text=""):
    """Return the messages by which BRLTTY sends cells and their text."""
    dots = [
        "".join(str(dot + 1) for dot in range(8) if ord(cell) >> dot & 1) or " " for cell in cells
    ]
    quoted = text.replace("\\", "\\\\").replace('"', '\\"')
    return f'Visual "{quoted}"\r\nBraille "{"|".join(dots)}"\r\n'.encode()


@given(CELLS, st.text('ab "\\ä€', max_size=9))
def test_messages_are_texts_and_cells(cells, text):
    visual, braille = said(cells, text).splitlines(keepends=True)
    assert parse_message(visual) == ("Visual", text.rstrip())
    assert parse_message(braille) == ("Braille", cells)


@pytest.mark.parametrize(
    "line",
    [b'Braille "19"', b'Braille "21"', b'Braille "a"', b"Braille", b"cells 20", b"\xff",
     b'Braille "' + b"|" * MOST_CELLS + b'"'],
)  # fmt: skip
def test_what_is_no_message_is_dropped(line):
    assert parse_message(line + b"\r\n") == ("", "")


def test_a_display_is_found_and_lost_and_found_again():
    source = BrailleDisplaySource(str(free_port()), PROFILE, cells=7)
    with pytest.raises(SourceError, match="give another port"):
        BrailleDisplaySource(str(source.address[1]), PROFILE)
    for number in (1, 2):
        with socket.create_connection(source.address) as line:
            assert line.recv(99) == b"cells 7\r\n"
            for byte in b"x" * 20_000 + b"\n" + said("⠓⠊", "hi"):
                line.send(bytes([byte]))
            until(lambda: source.shown is not None)
            shown = source.shown
            assert (shown.cells, shown.text, shown.number) == ("⠓⠊", "hi", number)
            source.read(number)
            assert source.title.endswith(": hi")
            source.send("home")
            assert line.recv(99) == b"home\r\n"
        until(lambda: source.shown is None)
        assert source.read(number).stale
        source.send("home")
    source.close()
    with pytest.raises(OSError, match="refused"):
        socket.create_connection(source.address)


class Scripted(BrailleDisplaySource):
    """Source whose content a test sets, and which records the commands to BRLTTY."""

    def __init__(self, speed_mm_s):
        super().__init__(str(free_port()), PROFILE, speed_mm_s=speed_mm_s)
        self.sent = []

    def send(self, command):
        self.sent.append(command)

    def show(self, cells):
        number = self.shown.number if self.shown else 0
        self.shown = DisplayContent(cells, number=number + 1)


class Finger:
    """Scripted source whose line moves by one cell per second of a simulated clock."""

    def __init__(self):
        layout = cell_layout(PROFILE, eight=True)
        self.source = Scripted(layout.cell * layout.pitch_mm[0])
        self.show, self.layout = self.source.show, self.source.layout
        self._time_ns = 0

    def after(self, seconds=0.0):
        """Advance the clock and return the stimulus."""
        self._time_ns += round(seconds * 1e9)
        return self.source.read(self._time_ns)

    def window(self, seconds=0.0):
        """Advance the clock and return which electrodes are active; all classes must agree."""
        activation = self.after(seconds).activation
        np.testing.assert_array_equal(activation, np.tile(activation[:1], (len(Afferent), 1)))
        return activation[0].reshape(8, 8) > 0

    def cell(self, seconds=0.0):
        """Advance the clock and return the cell in the middle of the array."""
        window, layout = self.window(seconds), self.layout
        top = (layout.rows - layout.height) // 2
        rows = top + layout.dot_y * np.array([0, 1, 2, 0, 1, 2, 3, 3])
        columns = layout.margin + layout.dot_x * np.array([0, 0, 0, 1, 1, 1, 0, 1])
        return dots_to_cells(window[rows, columns][None])


@pytest.fixture
def finger():
    made = Finger()
    yield made
    made.source.close()


def test_a_line_moves_through_electrode_by_electrode(finger):
    finger.show("⠓⠊⠞⠀⠀")
    first, cell = finger.window(), finger.layout.cell
    windows = [finger.window(REST_S)]
    windows += [finger.window(1 / cell) for _ in range(4 * cell)]
    np.testing.assert_array_equal(first, windows[0])
    for before, now in pairwise(windows):
        np.testing.assert_array_equal(now[:, :-1], before[:, 1:])
    assert not windows[-1].any()


def test_the_line_lies_where_the_finger_feels_it(finger):
    assert finger.source.sheet is None
    numbers = set()
    for cells in ("⠓⠊⠞", "⠇⠊⠞"):
        finger.show(cells)
        pose, window = finger.after(REST_S).pose, finger.window()
        sheet = finger.source.sheet
        across, down = finger.layout.pitch_mm
        corner = np.array([pose.x_mm - 4 * across, pose.y_mm - 4 * down]) - sheet.corner_mm
        left, top = np.rint(corner / sheet.page.mm_per_pixel).astype(int)
        assert top == 0
        seen = sheet.page.grey[:, max(left, 0) :: 4][::4] == 0
        np.testing.assert_array_equal(
            seen[:, : 8 - max(-left // 4, 0)], window[:, max(-left // 4, 0) :]
        )
        numbers.add(sheet.number)
    assert len(numbers) == 2


def test_without_brltty_nothing_is_felt_and_a_lost_line_stays_where_it_was(finger):
    assert finger.after().stale
    finger.show("⠓⠊⠞")
    assert not finger.after(0.02).stale
    assert finger.cell(REST_S) == "⠓"
    shown, finger.source.shown = finger.source.shown, None
    assert finger.after(60.0).stale
    finger.source.shown = shown
    assert finger.cell(1.0) == "⠊"


def test_what_was_typed_is_felt_and_not_the_line_again(finger):
    finger.show("⠓⠊⣀⠀")
    finger.cell(9.0)
    finger.show("⠓⠊⠞⣀")
    assert finger.cell() == "⠞"
    assert finger.cell(REST_S + 1.0) == "⣀"
    finger.show("⠓⠊⣀⠀")  # a character was deleted, so the cursor is in the third cell
    assert finger.cell(9.0) == "⣀"
    finger.show("⠓⠊⣀⠙")  # a change after the cursor was not typed: the line starts over
    assert finger.cell() == "⠓"


def test_the_cursor_is_followed_but_not_its_blinking(finger):
    finger.show("⠓⠊⠞⣀")
    finger.cell()
    finger.show("⣓⠊⠞⠀")
    assert finger.cell() == "⣓"
    assert finger.cell(REST_S + 1.0) == "⠊"
    for cells in ("⠓⠊⠞⠀", "⣓⠊⠞⠀"):
        finger.show(cells)
        finger.cell()
    assert finger.cell(1.0) == "⠞"


def test_keys_move_the_finger_and_command_brltty(finger):
    finger.show("⠓⠊⠞⠎")
    finger.cell()
    keys = finger.source.keys
    for key, place in (("]", "⠊"), ("]", "⠞"), ("[", "⠊"), ("r", "⠓"), ("[", "⠓")):
        keys[key]()
        assert finger.cell() == place
    finger.cell(REST_S + 2.0)
    for key in ("right", "left", "n", "p", "h", "\n", "\r"):
        keys[key]()
    assert finger.source.sent == ["fwinrt", "fwinlt", "lndn", "lnup", "home", "route 2", "route 2"]
    keys[" "]()
    assert [finger.cell(5.0) for _ in range(2)] == ["⠞", "⠞"]
    keys[" "]()
    assert finger.cell(1.0) == "⠎"


def test_updates_that_were_never_read_are_counted(finger):
    for cells in ("⠓", "⠊", "⠞"):
        finger.show(cells)
    numbers = {finger.after(0.02).number for _ in range(50)}
    assert finger.source.dropped_frames == 2
    assert finger.source.frames == len(numbers) + 2


@pytest.mark.parametrize(("address", "options"), [
    ("0", {}), ("65536", {}), ("x", {}), ("listen:1?", {}), ("::1:x", {}), ("1", {"cells": 0}),
    ("1", {"cells": 256}), ("1", {"speed_mm_s": 0.0}), ("1", {"speed_mm_s": float("nan")}),
])  # fmt: skip
def test_what_cannot_be_opened(address, options):
    with pytest.raises(SourceError, match=re.escape(address) if not options else None):
        BrailleDisplaySource(address, PROFILE, **options)


ROUTE = 1 << 16
PRINTABLE = "".join(map(chr, range(33, 127)))
PAGE = Path(__file__).parents[2] / "docs" / "how-to" / "read.md"


@pytest.fixture
def brltty(tmp_path):
    """Return a BRLTTY that is not started yet, and the source to which it will connect.

    BRLTTY has the settings that `docs/how-to/read.md` tells readers to write.
    """
    require_brltty()
    (settings,) = re.findall(
        r"^```text\n(braille-driver.*?)^```$", PAGE.read_text("utf-8"), re.MULTILINE | re.DOTALL
    )
    source = BrailleDisplaySource(str(free_port()), load_profile("electric-mouse"))
    real = Brltty(f"client:{':'.join(map(str, source.address))}", tmp_path, settings)
    yield real, source
    real.kill()
    source.close()


@pytest.mark.timeout(600)
def test_texts_are_shown_keys_arrive_and_restarts_are_survived(brltty):
    real, source = brltty

    def put(writer, text, cursor=0):
        """Repeat a text until the source shows it: BRLTTY can lose text right after it starts."""

        def is_shown():
            writer.write(text, cursor)
            time.sleep(0.1)
            return (source.shown or DisplayContent()).text == text

        until(is_shown)
        return source.shown

    for _ in range(5 if WHOLE else 2):
        real.start()
        with real.writer() as writer:
            for start in range(0, len(PRINTABLE), 20):
                text = PRINTABLE[start : start + 20]
                assert put(writer, text).cells.rstrip("⠀") == cells_of(text)
            until(lambda: put(writer, "hello", cursor=5).cursor == 4)
            source.keys["r"]()
            source.read(0)
            source.keys["]"]()
            source.read(1)
            for key, command in (("right", 24), ("left", 23), ("n", 2), ("p", 1), ("h", 29)):
                source.keys[key]()
                assert writer.key()["command"] == command, key
            source.keys["\n"]()
            routed = writer.key()
            assert routed["command"] == ROUTE
            assert routed["argument"] == source.cell
        real.kill()
        until(lambda: source.shown is None)
