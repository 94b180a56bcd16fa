"""The recipe for a second display: two BRLTTYs side by side, each with a program of its own."""

import re
from pathlib import Path

import pytest

from smarttouch.reading.brltty_connection import Address, BrlttyConnection

from .real_brltty import Brltty, free_port, require_brltty, wait_until

PAGE = Path(__file__).parents[2] / "docs" / "how-to" / "braille-display.md"
WIDTH = 10


def recipe():
    """Return the settings file that the page asks readers to write."""
    (found,) = re.findall(
        r"^```text\n(braille-driver.*?)^```$", PAGE.read_text("utf-8"), re.MULTILINE | re.DOTALL
    )
    return found


@pytest.fixture
def display():
    """A place where a BRLTTY finds a display, made as often as it is called."""
    opened = []

    def one():
        address = Address("127.0.0.1", free_port(), True)
        opened.append(BrlttyConnection(address, WIDTH).open())
        return f"client:{address}", opened[-1]

    yield one
    for each in opened:
        each.close()


def test_a_finger_beside_a_display(display, tmp_path):
    require_brltty()
    (own_device, own), (finger_device, finger) = display(), display()
    folders = [tmp_path / name for name in ("own", "finger", "again")]
    for folder in folders:
        folder.mkdir()
    first = Brltty(own_device, folders[0])
    second = Brltty(finger_device, folders[1], "screen-driver no", recipe())
    again = Brltty(finger_device, folders[2], "screen-driver no", recipe())
    again.pid_file = first.pid_file
    try:
        first.start()
        assert wait_until(first.pid_file.exists, 30)
        # What happens without the recipe: one with the same PID file refuses to start.
        again.start()
        assert again.process.wait(30) != 0
        second.start()
        with first.writer() as reader, second.writer() as other:

            def both(texts=("on paper", "on skin")):
                reader.write(texts[0])
                other.write(texts[1])
                return [shown.text.rstrip() for each in (own, finger) if (shown := each.shown)] == [
                    *texts
                ]

            assert wait_until(both, 60), (own.shown, finger.shown)
            # One that ends leaves the other as it was.
            second.kill()
            assert wait_until(lambda: finger.shown is None, 30)
            reader.write("still here")
            assert wait_until(lambda: own.shown.text.rstrip() == "still here", 30)
    finally:
        for each in (first, second, again):
            each.kill()
