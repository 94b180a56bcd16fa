"""Whatever breaks, the electrodes end at zero and the user gets one sentence."""

import fcntl
import os
import signal
import time
from dataclasses import replace

import numpy as np
import pytest

from smarttouch.base.errors import BoardError, SafetyError, SilentBoardError
from smarttouch.base.wire.port import open_port
from smarttouch.boards import line
from smarttouch.boards.link.protocol import MessageKind
from smarttouch.boards.open import make_board
from smarttouch.profile.device import Output
from smarttouch.stimulation.scan_sequence import ScanSequence
from tests.boards.fresh import deliver

from ..support.checks import raises

pytestmark = pytest.mark.realtime


def send_on(board, make_sequence, pause_s=0.02):
    for step in range(1, 50):
        board.send(make_sequence(step))
        time.sleep(pause_s)


def test_a_killed_board_is_reported_at_the_next_send(make_limits, make_sequence):
    with make_board("emulator:", make_limits()) as board:
        deliver(board, make_sequence(0))
        os.kill(board.driver.process.process_id, signal.SIGKILL)
        with raises(BoardError, value="/dev/") as error:
            send_on(board, make_sequence)
        assert board.acknowledged == 1
        assert f"{board.capabilities.time_to_zero_ms:g} ms" in str(error.value)


def test_a_busy_port_is_named(make_limits, start_emulator):
    _, port = start_emulator()
    with make_board(f"link:{port}", make_limits()), raises(BoardError, value=port):
        make_board(f"link:{port}", make_limits()).open()


@pytest.mark.parametrize("name", ["/dev/ttyUSB0", "/dev/pts/7"])
def test_programs_that_ask_for_no_lock_are_kept_out_of_devices(monkeypatch, name):
    monkeypatch.setattr("smarttouch.base.wire.port.os.ttyname", lambda _: name)
    master, slave = os.openpty()
    port = open_port(f"/proc/self/fd/{slave}")
    # TIOCGEXCL
    exclusive = fcntl.ioctl(port.fileno(), 0x80045440, bytes(4))
    assert exclusive == (b"\1\0\0\0" if "USB" in name else bytes(4))
    port.close()
    for each in (master, slave):
        os.close(each)


@pytest.mark.parametrize(("port", "value"), [("/dev/nowhere", "/dev/nowhere"), ("", None)])
def test_a_missing_port_is_named(make_limits, port, value):
    with raises(BoardError, value=value):
        make_board(f"link:{port}", make_limits()).open()


def test_another_board_than_the_profiles_is_refused(make_limits, start_emulator):
    _, port = start_emulator()
    with raises(BoardError, names="electrodes", value=9, allowed=8):
        make_board(f"link:{port}", make_limits(9)).open()
    with raises(BoardError, value="three-state", allowed="weighted"):
        make_board(f"link:{port}", make_limits(), Output(kind="three-state")).open()


def test_what_a_board_cannot_deliver_is_named(make_limits):
    none = np.zeros(0, np.uint16)

    def silent(electrodes):
        current_ua = np.zeros((0, electrodes), np.int16)
        return ScanSequence(current_ua, none, none, none, 20_000, 0.0, 0)

    with make_board("simulated:", make_limits()) as board:
        with raises(SafetyError, limit="times"):
            board.send(silent(8), 0)
        with raises(BoardError, value=65_536):
            board.send(silent(8), 65_536)
        with raises(SafetyError, value=9, allowed=8):
            board.send(silent(9))
    with make_board("memory:", make_limits(), Output(kind="three-state")) as board:
        phase = {"recharge_ua": np.zeros(8, np.int16), "recharge_us": 200}
        with raises(BoardError, names="recharge"):
            board.send(replace(silent(8), **phase))


def test_a_silent_port_is_reported(make_limits):
    master, slave = os.openpty()
    name = os.ttyname(slave)
    try:
        with raises(SilentBoardError, value=name):
            make_board(f"link:{name}", make_limits()).open()
    finally:
        os.close(master)
        os.close(slave)


def test_a_board_stopped_by_another_program_is_reported(make_limits, make_sequence):
    with make_board("emulator:", make_limits()) as board:
        board.send(make_sequence(0))
        board.driver._packets.send(MessageKind.STOP)
        with raises(BoardError):
            send_on(board, make_sequence)


def test_a_program_that_reads_from_the_port_is_named_once(make_limits, make_sequence, monkeypatch):
    read, takes = line.read_some, [True] * 3
    monkeypatch.setattr(
        line, "read_some", lambda port: None if takes and takes.pop() else read(port)
    )
    with make_board("emulator:", make_limits()) as board:
        deliver(board, make_sequence(0))
        (note,) = [note for note in board.notes if "another program" in note]
    assert board._line.name in note
