"""The firmware on a Cortex-M3 that QEMU plays: what is sent is delivered, silence is zero."""

import contextlib
import socket
import time

import numpy as np
import pytest

from firmware.tests.cortex_m3 import ELECTRODES
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


@pytest.fixture
def machine(start_cortex_m3):
    """Return the name of a port to the firmware, and its record of pulses so far."""
    machine = start_cortex_m3(counts=True)
    return f"link:{machine.name}", machine.pulses


class OverSocket:
    """A board at the other end of a socket, as `Talk` knows boards."""

    def __init__(self, line):
        self._line = line
        line.settimeout(10)

    def feed(self, data, _now_us):
        self._line.sendall(data)
        answer = b""
        while not answer.endswith(b"\0"):
            answer += self._line.recv(65536)
        return answer, []


@pytest.mark.realtime
def test_noise_is_nothing_and_silence_is_zero_within_100_ms(machine):
    port, pulses = machine
    number = int(port.rpartition(":")[2])
    rng = np.random.default_rng(0)
    with socket.create_connection(("127.0.0.1", number)) as line:
        line.sendall(rng.bytes(5000) + b"\0")
        talk = Talk(OverSocket(line))
        sequence = scan(300, 0.25)
        # A busy machine may be silent for 100 ms before the sequence, too: then once more.
        for _ in range(20):
            talk.begin(LIMITS)
            # The last that this host says.
            talk.send(sequence, 1, times=1000)
            time.sleep(0.6)
            if len(told := pulses()):
                break
    assert len(told) >= 4
    np.testing.assert_array_equal(
        told["current_ua"], np.tile(sequence.current_ua[0], (len(told), 1))
    )
    _check_times(told, 150)
    # The first slot begins when the sequence has come, which is the last sign of life.
    assert np.ptp(told["start_us"].astype(np.int64)) <= 100_000


@pytest.mark.long
def test_a_board_that_stands_still_is_reset(start_cortex_m3):
    """Its watchdog begins another life, shorted, which knows of no session."""
    machine = start_cortex_m3(stands_after=5, counts=True)
    port = int(machine.name.rpartition(":")[2])

    def starts():
        records = machine.records()
        return np.flatnonzero(records["number"] == int.from_bytes(b"star", "little"))

    with socket.create_connection(("127.0.0.1", port)) as line:
        talk = Talk(OverSocket(line)).begin(LIMITS)
        # Whether it answers or not: first until it stands still, then of the session before.
        line.settimeout(1)
        for number in (1, 2):
            with contextlib.suppress(TimeoutError):
                talk.send(scan(30, 0.1), number, times=1000)
            until(lambda: len(starts()) > 1)
        time.sleep(0.1)
    second = starts()[1]
    width_us = machine.records()["width_us"]
    assert (width_us[:second] > 0).sum() == 5
    assert (width_us[second:] == 0).all()


def _check_times(told, least_us):
    """Within a sequence a slot begins no earlier than width and discharge after the one before."""
    same = told["number"][1:] == told["number"][:-1]
    apart_us = np.diff(told["start_us"].astype(np.int64))
    assert (apart_us[same] >= least_us).all()
    assert (told["width_us"] == 100).all()
