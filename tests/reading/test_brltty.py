"""A real BRLTTY: texts are delivered dot by dot, keys arrive, restarts are survived."""

import os
import random

import numpy as np
import pytest

from smarttouch.base.afferent import Mode
from smarttouch.braille.cells import POSITION, dots_to_cells
from smarttouch.emulator.emulated_boards import SimulatedDriver
from smarttouch.imaging.array_window import profile_for_reading
from smarttouch.kernels.bank import load_bank
from smarttouch.profile import load_profile
from smarttouch.reading.braille_lines import Presentation
from smarttouch.reading.brltty_connection import Address, BrlttyConnection, DisplayContent
from smarttouch.reading.brltty_source import BrailleDisplaySource
from smarttouch.reading.line_source import LINE_GAP_MM
from smarttouch.running.config import RunConfig
from smarttouch.running.delivered import DeliveredResponses
from smarttouch.running.display import Display
from smarttouch.running.runner import Runner
from tests.reading.real_brltty import Brltty, cells_of, free_port, require_brltty, wait_until

from ..whole import WHOLE

HANGS_S = 60
ROUTE = 1 << 16
WIDTH = 6
TEXTS = int(os.environ.get("SMARTTOUCH_TEXTS", "100" if WHOLE else "20"))
RISING = 12
"""Texts felt before, until intensity is up."""
PERIODS_A_CELL = 3
PROFILE = profile_for_reading(load_profile("electric-mouse"))
CELLS_A_S = PROFILE.pulse.rate_hz / PERIODS_A_CELL


@pytest.fixture
def brltty(tmp_path):
    """Return BRLTTY, not yet started, and a connection that it will look for."""
    require_brltty()
    address = Address("127.0.0.1", free_port(), True)
    connection = BrlttyConnection(address, WIDTH).open()
    real = Brltty(f"client:{address}", tmp_path)
    yield real, connection
    real.kill()
    connection.close()


def shown(connection):
    """Return what is shown; nothing while there is no connection."""
    return connection.shown or DisplayContent()


def put(writer, connection, text, there, cursor=0):
    """Write a text until it is shown: just after its start BRLTTY can lose what is written."""
    for _ in range(HANGS_S):
        writer.write(text, cursor)
        if wait_until(there, 1.0):
            return
    raise AssertionError(text, connection.shown)


class Dictation(BrailleDisplaySource):
    """Has the next text written as soon as one has been felt."""

    def __init__(self, connection, writer, texts):
        super().__init__(connection, PROFILE, Presentation.CELL, 1.0)
        self._steps_a_s = CELLS_A_S
        self._writer, self._texts = writer, iter(texts)
        self._text, self._count = "", -1
        self.lines = {}
        """Line on the sheet of poses of each text, by its number."""

    def read(self, time_ns):
        if self.at_end:
            text = next(self._texts, None)
            if text is None:
                return None
            self._text, self._count = text, self._count + 1
            put(self._writer, self.connection, text, lambda: self._shows(text))
        return super().read(time_ns)

    def _take(self, shown):
        anew = shown.number != self._shown.number
        super()._take(shown)
        # BRLTTY may show its own message before the first, and a text twice.
        if anew and shown.text == self._text:
            self._go_to(0)
            self.lines[self._count] = self._jumps

    def _shows(self, text):
        shown = self.connection.shown
        # The text comes before its cells.
        return shown is not None and shown.text == text and shown.number > self._shown.number


@pytest.mark.timeout(600)
def test_texts_come_back_from_the_delivered_dots(brltty):
    real, connection = brltty
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
        source = Dictation(connection, writer, texts)
        config = RunConfig(mode=Mode.RA, scan="points")
        Runner(
            source, display, config, listeners=[answers.watch], load_kernels=lambda _: bank
        ).run()
        assert isinstance(display.board.driver, SimulatedDriver)
        answers.deliver(*display.board.driver.take_pulses())
    felt = delivered(answers, source.layout)
    assert len(source.lines) == len(texts)
    for number, text in list(enumerate(texts))[RISING:]:
        assert felt[source.lines[number]][: len(text)] == cells_of(text)


def delivered(answers, layout):
    """Return the cells of each line that were delivered, by its number."""
    line_mm = layout.rows * layout.pitch_mm[1] + LINE_GAP_MM
    cell_mm = layout.columns * layout.pitch_mm[0]
    lines = {}
    for pose, answer in answers:
        line, cell = round(pose.y_mm / line_mm), round(pose.x_mm / cell_mm - 0.5)
        active = lines.setdefault(line, np.zeros((WIDTH + 1, len(answer)), bool))
        active[cell] |= answer > 0.5
    margin, top = (layout.columns - layout.dot_x - 1) // 2, (layout.rows - layout.height) // 2
    column, row = POSITION.T
    place = (top + row * layout.dot_y) * layout.columns + margin + column * layout.dot_x
    for active in lines.values():
        assert active.sum() == active[:, place].sum()
    return {line: dots_to_cells(active[:, place]) for line, active in lines.items()}


def test_keys_arrive_at_the_program(brltty):
    real, connection = brltty
    real.start()
    source = BrailleDisplaySource(connection, PROFILE, Presentation.CELL)
    with real.writer() as writer:
        put(writer, connection, "hello", lambda: shown(connection).text == "hello")
        source.read(0)
        source.keys["]"]()
        source.read(1)
        for key, command in (("right", 24), ("left", 23), ("n", 2), ("p", 1), ("h", 29)):
            source.keys[key]()
            assert writer.key()["command"] == command, key
        source.keys["\n"]()
        routed = writer.key()
        assert (routed["command"], routed["argument"]) == (ROUTE, 1)


def test_the_cursor_is_found(brltty):
    real, connection = brltty
    real.start()
    with real.writer() as writer:
        put(writer, connection, "hello", lambda: shown(connection).cursor == 2, cursor=3)
        put(writer, connection, "hello", lambda: shown(connection).cursor == 4, cursor=5)


def test_it_survives_restarts_of_brltty(brltty):
    real, connection = brltty
    for _ in range(10 if WHOLE else 3):
        real.start()
        assert wait_until(lambda: connection.shown is not None, HANGS_S)
        real.kill()
        assert wait_until(lambda: connection.shown is None, HANGS_S)
