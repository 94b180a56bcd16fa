"""Drivers can send only sequences that the gate has proved, and no current after a stop."""

import dataclasses
import threading
from types import SimpleNamespace

import numpy as np
import pytest

from smarttouch.base.errors import BoardError, BoardStoppedError, SafetyError
from smarttouch.boards.board import Board
from smarttouch.boards.driver import Driver
from smarttouch.boards.reports import Capabilities
from smarttouch.stimulation.safety_gate import ProvedSequence, SafetyLimits
from smarttouch.stimulation.scan_sequence import ScanSequence

from ..support.checks import raises

LATE_NS = 60 * 10**9  # longer than any pause of the computer, so that no sequence is late


def allowed():
    return SafetyLimits(8, 3.0, 200, 0.5, 100, 0.6, 0.5, 2.43)


class Theirs(Driver):
    """Driver of another package, which calls ``act`` in `write`."""

    def __init__(self, act=lambda driver, proved: None):
        self.act, self.flows, self.zeros, self.proved = act, [], 0, []
        self.most_ma = 5.0

    def open(self, line, limits):
        self.line, self.limits = line, limits
        return Capabilities(8, "weighted", self.most_ma, 256, time_to_zero_ms=0.0, firmware="")

    def write(self, proved):
        self.proved.append(proved)
        self.act(self, proved)
        self.drive(proved)

    def drive(self, proved):
        with self.line.current(proved):
            self.flows.append(int(abs(proved.sequence.current_ua).max(initial=0)))

    def zero(self):
        with self.line.current():
            self.zeros += 1


def board_of(driver):
    return Board(driver, allowed(), late_ns=LATE_NS, on_a_finger=False)


def sequence(step, level_ua=0):
    row = np.array([[level_ua, -level_ua, 0, 0, 0, 0, 0, 0]], np.int16)[: level_ua > 0]
    one = np.ones(len(row), np.uint16)
    return ScanSequence(row, one * 100, one * 50, one, 20_000, 0.1 * (level_ua > 0), step * 10**9)


def test_only_the_gate_makes_what_can_be_sent():
    made = [
        lambda proved: ProvedSequence(proved.sequence, 1, 1, 0, LATE_NS, 1),
        lambda proved: dataclasses.replace(proved, sequence=sequence(9, 5000)),
        lambda proved: dataclasses.replace(proved, write_before_ns=2**62),
    ]
    for make in made:
        with board_of(driver := Theirs()) as board:
            board.send(sequence(0))
            with raises(SafetyError, limit="gate"):
                make(driver.proved[0])


def look_alike(proved):
    """Return an object with the fields of a proved sequence, but more current in ``sequence``."""
    names = [field.name for field in dataclasses.fields(proved)]
    fields = {name: getattr(proved, name) for name in names}
    return SimpleNamespace(**fields | {"sequence": sequence(1, 5000)})


@pytest.mark.parametrize("foreign", [
    lambda _: sequence(1, 5000), lambda _: object.__new__(ProvedSequence), look_alike,
], ids=["sequence", "empty", "look-alike"])  # fmt: skip
def test_nothing_else_is_driven(foreign):
    with board_of(driver := Theirs()) as board:
        board.send(sequence(0))
        with pytest.raises((BoardError, AttributeError)):
            driver.drive(foreign(driver.proved[0]))
    assert driver.flows == [0]


def test_limits_that_a_driver_widens_are_its_own():
    def widen(driver, _):
        for name in ("current_ma", "full_ma"):
            object.__setattr__(driver.limits, name, 5.0)
        vars(driver.limits)["current_ua"] = np.full(8, 5000.0)

    with board_of(driver := Theirs(widen)) as board:
        board.send(sequence(0))
        with raises(SafetyError, limit="current_ma"):
            board.send(sequence(1, 3500))
    assert driver.flows == [0]


def test_no_driver_gets_more_than_its_board_can_make():
    """A current that exceeds the board's range (for example one byte) could wrap around."""
    driver = Theirs()
    driver.most_ma = 0.2
    with board_of(driver) as board:
        board.send(sequence(0))
        board.send(sequence(1, 200))
        with raises(BoardError, value=0.201, allowed=0.2):
            board.send(sequence(2, 201))
    assert driver.flows == [0, 200]


@pytest.mark.parametrize("thread", [False, True])
def test_after_a_stop_only_zero_is_written(thread):
    """After a stop, all threads refuse current, even for sequences proved before the stop."""
    raised = []

    def send_on(driver):
        for what in (driver.proved[0], None):
            try:
                with driver.line.current(what):
                    driver.flows.append("after the stop")
            except BoardStoppedError as error:
                raised.append(error)

    with board_of(driver := Theirs()) as board:
        board.send(sequence(0))
        board.stop()
        if thread:
            other = threading.Thread(target=send_on, args=(driver,))
            other.start()
            other.join()
        else:
            send_on(driver)
        with pytest.raises(BoardStoppedError):
            board.send(sequence(1))
    assert (driver.flows, len(raised), driver.zeros) == ([0], 2, 2)


def test_a_stop_within_a_write_ends_in_zero_after_it():
    """A signal handler can stop a board in the middle of a write."""
    with board_of(driver := Theirs()) as board:
        board.send(sequence(0))
        with driver.line.current(driver.proved[0]):
            board.stop()
            before = driver.zeros
        assert driver.zeros == before + 1


def test_what_was_proved_before_a_board_was_opened_again_is_not_sent():
    with board_of(driver := Theirs()) as board:
        board.send(sequence(0))
        board.close()
        board.open()
        with pytest.raises(BoardStoppedError):
            driver.drive(driver.proved[0])
    assert driver.flows == [0]


def test_what_is_written_in_two_parts_counts_once():
    board = board_of(Theirs(lambda driver, proved: driver.drive(proved)))
    with board:
        board.send(sequence(0))
        board.send(sequence(1, 100))
        report = board.report()
        assert (board.acknowledged, report.sequences, report.slots) == (2, 2, 1)
        assert board.driver.flows == [0, 0, 100, 100]
