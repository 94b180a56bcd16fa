"""The firmware on a Cortex-M3 that QEMU plays: what is sent is delivered, silence is zero."""

import contextlib
import time

import numpy as np
import pytest

from firmware.tests.qemu import ELECTRODES
from firmware.tests.rig import Talk
from smarttouch.stimulation.safety_gate import SafetyLimits
from smarttouch.stimulation.scan_sequence import ScanSequence
from tests.support.runs import until

LIMITS = SafetyLimits(ELECTRODES, 3.0, 200, 0.5, 100, 0.6, 0.5, 2.4)


def scan(level_ua, intensity):
    """Return four slots from one electrode to another."""
    current = np.zeros((4, ELECTRODES), np.int16)
    current[:, :2] = level_ua, -level_ua
    column = np.ones(4, np.uint16)
    return ScanSequence(current, 100 * column, 50 * column, 0 * column, 10_000, intensity, 0)


@pytest.mark.realtime
def test_noise_is_nothing_and_silence_is_zero_within_100_ms(start_cortex_m3):
    machine, rng = start_cortex_m3(counts=True), np.random.default_rng(0)
    with machine.connected() as board:
        board.line.sendall(rng.bytes(5000) + b"\0")
        talk, sequence = Talk(board), scan(300, 0.25)
        # A busy machine may be silent for 100 ms before the sequence, too: then once more.
        for _ in range(20):
            talk.begin(LIMITS)
            # The last that this host says.
            talk.send(sequence, 1, times=1000)
            time.sleep(0.6)
            if len(told := machine.pulses()):
                break
    assert len(told) >= 4
    np.testing.assert_array_equal(
        told["current_ua"], np.tile(sequence.current_ua[0], (len(told), 1))
    )
    assert (told["width_us"] == 100).all()
    # Within a sequence a slot begins no earlier than width and discharge after the one before.
    same = told["number"][1:] == told["number"][:-1]
    start_us = told["start_us"].astype(np.int64)
    assert (np.diff(start_us)[same] >= 150).all()
    # The first slot begins when the sequence has come, which is the last sign of life.
    assert np.ptp(start_us) <= 100_000


@pytest.mark.long
def test_a_board_that_stands_still_is_reset(start_cortex_m3):
    """Its watchdog begins another life, shorted, which knows of no session."""
    machine = start_cortex_m3(stands_after=5, counts=True)

    def starts():
        records = machine.records()
        return np.flatnonzero(records["number"] == int.from_bytes(b"star", "little"))

    with machine.connected() as board:
        talk = Talk(board).begin(LIMITS)
        # Whether it answers or not: first until it stands still, then of the session before.
        board.line.settimeout(1)
        for number in (1, 2):
            with contextlib.suppress(TimeoutError):
                talk.send(scan(30, 0.1), number, times=1000)
            until(lambda: len(starts()) > 1)
        time.sleep(0.1)
    second = starts()[1]
    width_us = machine.records()["width_us"]
    assert (width_us[:second] > 0).sum() == 5
    assert (width_us[second:] == 0).all()
