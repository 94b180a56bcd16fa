"""A real BRLTTY: its texts are shown cell by cell, keys arrive, restarts are survived."""

import re
from pathlib import Path

import pytest

from smarttouch.profile import load_profile
from smarttouch.reading.brltty import BrailleDisplaySource, DisplayContent
from tests.reading.real_brltty import Brltty, cells_of, free_port, require_brltty, wait_until

from ..support.full import WHOLE

HANGS_S = 60
ROUTE = 1 << 16
PRINTABLE = "".join(map(chr, range(33, 127)))
PAGE = Path(__file__).parents[2] / "docs" / "how-to" / "read.md"


@pytest.fixture
def brltty(tmp_path):
    """Return BRLTTY, not yet started, and a source that it will look for.

    Its settings are those that the documentation asks readers to write.
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
        """Write a text until it is shown: just after its start BRLTTY can lose what is written."""
        for _ in range(HANGS_S):
            writer.write(text, cursor)
            if wait_until(lambda: (source.shown or DisplayContent()).text == text, 1.0):
                return source.shown
        raise AssertionError(text, source.shown)

    for _ in range(5 if WHOLE else 2):
        real.start()
        with real.writer() as writer:
            for start in range(0, len(PRINTABLE), 20):
                text = PRINTABLE[start : start + 20]
                assert put(writer, text).cells.rstrip("⠀") == cells_of(text)
            assert wait_until(lambda: put(writer, "hello", cursor=5).cursor == 4, HANGS_S)
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
        assert wait_until(lambda: source.shown is None, HANGS_S)
