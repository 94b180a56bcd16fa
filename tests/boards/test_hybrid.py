"""Electrodes and vibrators as one board: each gets its own, and both end together."""

import wave
from dataclasses import replace

import numpy as np
import pytest

from smarttouch.base.errors import (
    BoardClosedError,
    BoardError,
    BoardRestartedError,
    BoardStoppedError,
    SafetyError,
)
from smarttouch.boards.open import make_board
from smarttouch.boards.reports import classify
from smarttouch.boards.vibrators.vibrator_board import HybridBoard, VibratorBoard
from smarttouch.profile.device import Output

from ..raising import raises
from . import test_contract

SECOND = test_contract.SECOND
AMPLITUDE = 0.125
"""Of the vibration: below the intensity, and exact as a float32."""


class Vibrated(test_contract.Contract):
    """The contract over the electrodes of a hybrid, with its vibrators beside them."""

    @pytest.fixture
    def make_board(self, url, limits, tmp_path):
        def make(kind=self.kinds[0]):
            self.board = make_board(url, limits, Output(kind=kind))
            self.shaking = VibratorBoard(f"{tmp_path / 'out.wav'}?grid=1x1", limits)
            return HybridBoard(self.board, self.shaking)

        return make

    def sequence(self, step, *arguments, **options):
        sent = super().sequence(step, *arguments, **options)
        return replace(sent, vibration=np.full(sent.electrodes, AMPLITUDE * (step > 0), np.float32))

    def read(self):
        with wave.open(str(self.folder / "out.wav")) as file:
            rate_hz, count = file.getframerate(), file.getnframes()
            return np.frombuffer(file.readframes(count), "<i2") / 32767, rate_hz

    def assert_silent(self):
        super().assert_silent()
        assert self.read()[0][-1] == 0

    def test_each_gets_its_own(self, make_board):
        with make_board() as board:
            for step in range(4):
                board.send(self.sequence(step))
            assert board.shaking.report().slots == 0
            assert board.report().slots == 12
        samples, rate_hz = self.read()
        loud = [np.abs(samples[step * rate_hz :][: rate_hz // 100]).max() for step in range(4)]
        assert loud == pytest.approx([0] + [AMPLITUDE] * 3, rel=0.01)

    def test_a_recharge_phase_is_for_the_electrodes(self, make_board):
        with make_board() as board:
            board.send(self.sequence(0))
            sent = replace(
                self.sequence(1),
                recharge_ua=np.array([-9] + [0] * (self.electrodes - 2) + [9], np.int16),
                recharge_us=100,
            )
            board.send(sent)
            assert self.board.capabilities.recharges
            assert board.report().slots == 4

    def test_it_offers_vibration_and_leaves_the_rest_to_the_electrodes(self, make_board):
        with make_board() as board:
            assert board.capabilities == replace(self.board.capabilities, vibrates=True)
            assert board.timing is self.board.timing
            assert board.simulated_time is self.board.simulated_time
            for name in ("acknowledged", "refused", "replaced", "force_n", "lifted"):
                value = object()
                setattr(self.board, name, value)
                assert getattr(board, name) is value
            board.lifted = False
            assert self.board.lifted is False
            volts = [(self.sequence(0), np.zeros(1, np.float32))]
            self.board.take_volts = lambda: volts
            assert board.take_volts() is volts

    def test_each_note_comes_once(self, make_board):
        board = make_board()
        for part, words in ((self.board, "one"), (self.shaking, "two"), (board, "three")):
            part.notes.append(words)
        assert board.notes == ["one", "two", "three"]

    def test_a_fault_of_the_electrodes_ends_both(self, make_board):
        with make_board() as board:
            board.send(self.sequence(0))
            board.send(self.sequence(1))
            self.board._send = fail_with(BoardError("the line broke"))
            with raises(BoardError, names="line"):
                board.send(self.sequence(2))
            for part in (board, self.shaking):
                with raises(BoardStoppedError, names="board"):
                    part.send(self.sequence(3))
            samples, rate_hz = self.read()
        assert len(samples) < 1.02 * rate_hz
        assert samples[-1] == 0

    def test_a_fault_of_the_vibrators_ends_both(self, make_board):
        with make_board() as board:
            board.send(self.sequence(0))
            board.send(self.sequence(1))
            self.shaking._send = fail_with(BoardError("the sound device is gone"))
            with raises(BoardError):
                board.send(self.sequence(2))
            for part in (board, self.board):
                with raises(BoardStoppedError, names="board"):
                    part.send(replace(self.sequence(3), vibration=None))

    def test_electrodes_that_are_back_begin_at_zero_and_so_do_vibrators(self, make_board):
        with make_board() as board:
            board.send(self.sequence(0))
            board.send(self.sequence(1), times=50)
            sends = self.board._send
            self.board._send = fail_with(BoardRestartedError("lost, and was started anew"))
            with pytest.raises(BoardRestartedError):
                board.send(self.sequence(2))
            self.board._send = sends
            with raises(
                SafetyError, limit="ramp_s", value=pytest.approx(self.intensity), allowed=0
            ):
                board.send(self.sequence(3))
            board.send(replace(self.sequence(0), time_ns=4 * SECOND))
            board.send(self.sequence(5))
        samples, rate_hz = self.read()
        assert np.abs(samples[5 * rate_hz :]).max() == pytest.approx(AMPLITUDE, rel=0.01)
        # They were at rest as soon as the electrodes were lost.
        assert not samples[round(1.02 * rate_hz) : 5 * rate_hz].any()

    @pytest.mark.parametrize("fails", ["open", "close"])
    def test_vibrators_that_fail_leave_the_electrodes_closed(self, make_board, fails):
        board = make_board()
        if fails == "close":
            board.open()
        setattr(self.shaking, f"_{fails}", fail_with(BoardError("gone")))
        with raises(BoardError):
            getattr(board, fails)()
        with raises(BoardClosedError, names="board"):
            self.board.send(self.sequence(0))

    def test_it_measures_without_shaking(self, make_board):
        found = classify(np.full(self.electrodes, 50.0), 0.1)
        with make_board() as board:
            board.send(self.sequence(0))
            board.send(self.sequence(1), times=50)
            self.board._measure = lambda: found
            assert board.measure() is found
            samples, rate_hz = self.read()
            assert np.abs(samples[rate_hz:]).max() > 0.8 * AMPLITUDE
            assert len(samples) < 1.02 * rate_hz
            assert samples[-1] == 0

    def test_vibration_beyond_the_intensity_never_leaves(self, make_board):
        with make_board() as board:
            board.send(self.sequence(0))
            too_much = replace(self.sequence(1), vibration=np.full(8, 0.21, np.float32))
            with raises(SafetyError, limit="vibration", value=pytest.approx(0.21)):
                board.send(too_much)
            board.send(self.sequence(1))
            assert board.shaking.report().sequences == 2


class TestOverMemory(Vibrated, test_contract.TestMemory):
    def test_a_newer_sequence_ends_a_repetition(self, make_board):
        with make_board() as board:
            board.send(self.sequence(0), times=1000)
            board.send(self.sequence(1))
            assert len(self.board.sequences) == 2
        # A second later, of the ten that the repetition would have lasted.
        samples, rate_hz = self.read()
        assert len(samples) < 1.02 * rate_hz


@test_contract.without_repeating(
    "test_each_gets_its_own", "test_a_recharge_phase_is_for_the_electrodes",
    test_contract.AT_ANY_LINE, test_contract.SENT,
)  # fmt: skip
class TestOverSimulated(Vibrated, test_contract.TestSimulated): ...


def fail_with(error):
    def fail(*_):
        raise error

    return fail
