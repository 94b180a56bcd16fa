"""A real BRLTTY: texts are delivered dot by dot, keys arrive, restarts are survived."""

import os
import random
import re
from pathlib import Path

import pytest

from smarttouch.base.afferent import Mode
from smarttouch.emulator.emulated_boards import SimulatedDriver
from smarttouch.imaging.array_window import profile_for_reading
from smarttouch.imaging.line_picture import LinePicture
from smarttouch.kernels.bank import load_bank
from smarttouch.profile import load_profile
from smarttouch.reading.brltty import BrailleDisplaySource, DisplayContent
from smarttouch.reading.line_source import LINE_GAP_MM
from smarttouch.running.config import RunConfig
from smarttouch.running.delivered import DeliveredResponses
from smarttouch.running.display import Display
from smarttouch.running.runner import Runner
from tests.reading.real_brltty import Brltty, cells_of, free_port, require_brltty, wait_until

from ..whole import WHOLE
from .delivered_cells import decode

HANGS_S = 60
ROUTE = 1 << 16
WIDTH = 6
TEXTS = int(os.environ.get("SMARTTOUCH_TEXTS", "100" if WHOLE else "20"))
RISING = 12
"""Texts felt before, until intensity is up."""
PROFILE = profile_for_reading(load_profile("electric-mouse"))
PAGE = Path(__file__).parents[2] / "docs" / "how-to" / "braille-display.md"


@pytest.fixture
def brltty(tmp_path):
    """Return BRLTTY, not yet started, and a source that it will look for.

    Its settings are those that the documentation asks readers to write.
    """
    require_brltty()
    (settings,) = re.findall(
        r"^```text\n(braille-driver.*?)^```$", PAGE.read_text("utf-8"), re.MULTILINE | re.DOTALL
    )
    source = Dictation(str(free_port()))
    real = Brltty(f"client:{':'.join(map(str, source.address))}", tmp_path, settings)
    yield real, source
    real.kill()
    source.close()


class Dictation(BrailleDisplaySource):
    """Has the next text written as soon as one has been felt."""

    def __init__(self, address):
        # One pulse for each place.
        speed_mm_s = PROFILE.pulse.rate_hz * PROFILE.electrodes.cell_mm[0]
        super().__init__(address, PROFILE, cells=WIDTH, speed_mm_s=speed_mm_s)
        self.writer, self.texts = None, iter(())
        self._text, self._count = "", -1
        self.lines = {}
        """Line on the sheet of poses of each text, by its number."""

    def put(self, text, there, cursor=0):
        """Write a text until it is shown: just after its start BRLTTY can lose what is written."""
        for _ in range(HANGS_S):
            self.writer.write(text, cursor)
            if wait_until(there, 1.0):
                return
        raise AssertionError(text, self.shown)

    def read(self, time_ns):
        if self._step() - self.layout.margin >= self._dots.shape[1]:
            text = next(self.texts, None)
            if text is None:
                return None
            self._text, self._count = text, self._count + 1
            self.put(text, lambda: self._shows(text))
        return super().read(time_ns)

    def _take(self, shown):
        anew = shown.number != self._taken.number
        super()._take(shown)
        # BRLTTY may show its own message before the first, and a text twice.
        if anew and shown.text == self._text:
            self._go_to(0)
            self.lines[self._count] = self._jumps

    def _shows(self, text):
        # The text comes before its cells.
        shown = self.shown
        return shown is not None and shown.text == text and shown.number > self._taken.number


@pytest.mark.timeout(600)
def test_texts_come_back_from_the_delivered_dots(brltty):
    real, source = brltty
    real.start()
    draw = random.Random(1)
    texts = ["up", "so"] * (RISING // 2)
    while len(texts) < RISING + TEXTS:
        length = draw.randint(1, WIDTH)
        text = "".join(chr(draw.randint(33, 126)) for _ in range(length))
        if text != texts[-1]:
            texts.append(text)
    bank = load_bank(PROFILE)
    answers = DeliveredResponses(PROFILE, bank, Mode.RA.afferents)
    with real.writer() as writer, Display("simulated:", PROFILE) as display:
        source.writer, source.texts = writer, iter(texts)
        config = RunConfig(mode=Mode.RA, scan="points")
        Runner(
            source, display, config, listeners=[answers.watch], load_kernels=lambda _: bank
        ).run()
        assert isinstance(display.board.driver, SimulatedDriver)
        answers.deliver(*display.board.driver.take_pulses())
    layout = source.layout
    line_mm = layout.rows * layout.pitch_mm[1] + LINE_GAP_MM
    pictures = {}
    for pose, answer in answers:
        empty = LinePicture(PROFILE.electrodes, (WIDTH + 2) * layout.cell * layout.pitch_mm[0])
        pictures.setdefault(round(pose.y_mm / line_mm), empty).add(pose.x_mm, answer)
    assert len(source.lines) == len(texts)
    for number, text in list(enumerate(texts))[RISING:]:
        assert decode(pictures[source.lines[number]], layout, len(text)) == cells_of(text)


def test_keys_arrive_at_the_program_and_restarts_are_survived(brltty):
    real, source = brltty

    def shown():
        return source.shown or DisplayContent()

    for _ in range(5 if WHOLE else 2):
        real.start()
        with real.writer() as source.writer:
            source.put("hello", lambda: shown().text == "hello")
            source.keys["r"]()
            super(Dictation, source).read(0)
            source.keys["]"]()
            super(Dictation, source).read(1)
            for key, command in (("right", 24), ("left", 23), ("n", 2), ("p", 1), ("h", 29)):
                source.keys[key]()
                assert source.writer.key()["command"] == command, key
            source.keys["\n"]()
            routed = source.writer.key()
            assert (routed["command"], routed["argument"]) == (ROUTE, 1)
            source.put("hello", lambda: shown().cursor == 4, cursor=5)
        real.kill()
        assert wait_until(lambda: source.shown is None, HANGS_S)
