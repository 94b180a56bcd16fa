"""The pointer over a window: what can be known of it without a display."""

import sys
from types import ModuleType

import pytest

from smarttouch.base.errors import SourceError
from smarttouch.instruments.hand_motion import open_motion
from smarttouch.instruments.textures import Grating
from smarttouch.instruments.window_motion import PAD_MM, Pointer, fit

from ..raising import raises
from ..waiting import until


def test_what_is_shown_is_as_large_as_it_is_or_smaller():
    assert fit((100, 50), 0.25, (1920, 1080)) == ((400, 200), 0.25)
    (wide, high), mm_per_px = fit((1000, 50), 0.25, (1920, 1080))
    assert wide == pytest.approx(0.8 * 1920, abs=1)
    assert (wide * mm_per_px, high * mm_per_px) == pytest.approx((1000, 50), rel=0.02)


def test_pixels_become_millimeters():
    pointer = Pointer((400, 200), 0.25)
    assert pointer.place_mm == (50, 25)
    pointer.place_px = (40, 100)
    assert pointer.place_mm == (10, 25)


class FakeTk(ModuleType):
    """A display of 96 dots an inch; its main loop plays what the test has written down."""

    TclError = type("TclError", (Exception,), {})
    missing = False

    def __init__(self):
        super().__init__("tkinter")
        self.script, self.waiting, self.gone, self.size = [], [], False, None
        outer = self

        class Root:
            def __init__(self):
                if outer.missing:
                    raise FakeTk.TclError("no display name")

            def winfo_screenwidth(self):
                return 1920

            def winfo_screenheight(self):
                return 1080

            def winfo_fpixels(self, length):
                assert length == "1m"
                return 4.0

            def title(self, words):
                outer.words = words

            def resizable(self, *_):
                pass

            def after(self, _ms, call, *arguments):
                outer.waiting.append((call, arguments))

            def destroy(self):
                outer.gone = True

            def mainloop(self):
                for each in outer.script:
                    each()
                while outer.waiting and not outer.gone:
                    call, arguments = outer.waiting.pop()
                    call(*arguments)

        class Label:
            def __init__(self, *_, **__):
                pass

            def pack(self):
                pass

            def bind(self, name, handler):
                assert name == "<Motion>"
                outer.moved = handler

        self.Tk, self.Label = Root, Label
        self.PhotoImage = lambda master, data: data


@pytest.fixture
def display(monkeypatch):
    fake = FakeTk()
    monkeypatch.setitem(sys.modules, "tkinter", fake)
    return fake


def test_the_pointer_is_the_hand(display):
    with open_motion("window:", texture=Grating(4.0)) as motion:
        assert motion.read(0) == (0, 0)
        assert motion.origin_mm == (PAD_MM[0] / 2, PAD_MM[1] / 2)
        event = type("Event", (), {"x": 340, "y": 180})
        display.moved(event)
        assert motion.read(1) == (10, -5)
        assert motion.resolution_mm == 0.25
        assert "0.250 mm" in motion.title
        assert "4 mm" in display.words
    assert display.gone
    assert motion.read(2) is None


def test_a_closed_window_ends_the_motion(display):
    display.script = [lambda: setattr(display, "gone", True)]
    with open_motion("window:") as motion:
        until(lambda: not motion._open)
        assert motion.read(0) is None


def test_without_a_display_or_tk_it_says_so(display, monkeypatch):
    display.missing = True
    with raises(SourceError, names="display"):
        open_motion("window:")
    monkeypatch.setitem(sys.modules, "tkinter", None)
    with raises(SourceError):
        open_motion("window:")


def test_it_takes_nothing_after_the_colon():
    with raises(SourceError, value=("window:", "x")):
        open_motion("window:x")
