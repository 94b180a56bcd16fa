"""Faults of boards: one-sentence errors, the fault latch for a board that delivers unsent pulses,
and the host's own counters of delivered pulses (`HostStatistics`)."""

import fcntl
import os
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from smarttouch.base.errors import (
    BoardError,
    BoardFaultError,
    BoardLatchedError,
    SafetyError,
    SilentBoardError,
)
from smarttouch.base.wire.port import open_port
from smarttouch.boards import driver
from smarttouch.boards.link import MessageKind
from smarttouch.boards.open import make_board
from smarttouch.boards.reports import HostStatistics, clear_latch, find_latch, latch
from smarttouch.profile.profile_tables import Output
from smarttouch.stimulation.scan_sequence import ScanSequence

from ..support.checks import raises
from ..support.processes import PROGRAM, Forked
from .emulator_waits import deliver, starter

pytestmark = pytest.mark.realtime


def test_a_busy_port_is_named(make_limits, start_emulator):
    _, port = start_emulator()
    with make_board(f"link:{port}", make_limits()), raises(BoardError, value=port):
        make_board(f"link:{port}", make_limits()).open()


@pytest.mark.parametrize("name", ["/dev/ttyUSB0", "/dev/pts/7"])
def test_programs_that_ask_for_no_lock_are_kept_out_of_devices(monkeypatch, name):
    monkeypatch.setattr("smarttouch.base.wire.port.os.ttyname", lambda _: name)
    master, slave = os.openpty()
    port = open_port(f"/proc/self/fd/{slave}")
    # The ioctl TIOCGEXCL returns whether other programs are locked out.
    exclusive = fcntl.ioctl(port.fileno(), 0x80045440, bytes(4))
    assert exclusive == (b"\1\0\0\0" if "USB" in name else bytes(4))
    port.close()
    for each in (master, slave):
        os.close(each)


def test_another_board_than_the_profiles_is_refused(make_limits, start_emulator):
    _, port = start_emulator("linger=60")
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


def test_a_board_that_stays_on_counts_for_each_run(make_limits, make_sequence, start_emulator):
    _, port = start_emulator()
    for _ in range(2):
        with make_board(f"link:{port}", make_limits()) as board:
            deliver(board, make_sequence(0), make_sequence(1, level_ua=350))
            report = board.report()
        assert (report.sequences, report.slots, report.pulses) == (2, 4, 32)


def test_a_missing_or_a_silent_port_is_reported(make_limits):
    with pytest.raises(BoardError):
        make_board("link:", make_limits()).open()
    master, slave = os.openpty()
    name = os.ttyname(slave)
    with raises(SilentBoardError, value=name):
        make_board(f"link:{name}", make_limits()).open()
    for each in (master, slave):
        os.close(each)


def test_a_board_stopped_by_another_program_is_reported(make_limits, make_sequence):
    with make_board("emulator:", make_limits()) as board:
        board.send(make_sequence(0))
        board.driver._session.send(MessageKind.STOP)

        def send_on():
            for step in range(1, 50):
                board.send(make_sequence(step))
                time.sleep(0.02)

        with pytest.raises(BoardError):
            send_on()


def test_a_program_that_reads_from_the_port_is_named_once(make_limits, make_sequence, monkeypatch):
    read, takes = driver.read_some, [True] * 3
    monkeypatch.setattr(
        driver, "read_some", lambda port: None if takes and takes.pop() else read(port)
    )
    with make_board("emulator:", make_limits()) as board:
        deliver(board, make_sequence(0))
        (note,) = [note for note in board.notes if "another program" in note]
    assert board._line.name in note


FAULTY = str(Path(__file__).with_name("faulty_board.py"))


@pytest.fixture
def start_faulty():
    """Return a function that starts a board with a fault, and returns its port name."""
    with starter() as start:

        def start_one(fault, protocol, electrodes):
            ramp = "&ramp_ms=0" * (protocol == "link")
            url = f"{protocol}?electrodes={electrodes}&linger=5{ramp}"
            process = start([sys.executable, FAULTY, fault, url], start_new_session=True)
            return process.stdout.readline().strip()

        yield start_one


def drive(board, make_sequence, count=4, **fields):
    """Send sequences and wait for each; then close the board during a repetition."""
    with board:
        for step in range(count):
            board.send(make_sequence(step, **fields))
            board.drain()
            time.sleep(0.02)
        board.report()
        # Closing cuts this repetition short. It is not a fault if fewer pulses flow than were sent.
        board.send(make_sequence(count, **fields), times=50)


@pytest.mark.parametrize("fault", ["twice", "violation", "strong", "after zero", "volts"])
def test_a_link_board_is_latched(fault, start_faulty, make_limits, make_sequence):
    port = start_faulty(fault, "link", 8)
    board, again = (make_board(f"link:{port}", make_limits()) for _ in range(2))
    with pytest.raises(BoardFaultError) as found:
        drive(board, make_sequence)
    with pytest.raises(BoardLatchedError) as refused:
        again.open()
    record = clear_latch(again.device)
    assert f"on {record}; have the board checked" in str(refused.value)
    assert str(found.value).startswith(f"{record.split(': ', 1)[1]}: ")
    assert find_latch(again.device) is None
    # The same program cannot open a faulty board again, not even with the latch cleared.
    with pytest.raises(BoardFaultError):
        board.open()


def test_an_output_beside_the_pattern_latches_a_kit(start_faulty, make_limits, make_sequence):
    port = start_faulty("beside", "etactilekit", 8)
    output = Output(kind="one-against-all", ua_per_count=9.99)
    board = make_board(f"etactilekit:{port}", make_limits(), output)
    with pytest.raises(BoardFaultError):
        drive(board, make_sequence, 6, slots=2, period_us=50_000)
    assert find_latch(board.device) is not None


def test_a_record_outlives_its_process_and_is_private():
    latch("USB 1234:5678 A1", "a fault")
    latch("USB 1234:5678 A1", "a later one")
    (record,) = Path(os.environ["XDG_STATE_HOME"]).rglob("*.json")
    assert record.stat().st_mode & 0o077 == 0
    assert find_latch("USB 1234:5678 A1").endswith(": a fault")
    record.write_text("nonsense")
    assert find_latch("USB 1234:5678 A1") is not None, "an unreadable record counts as a fault"
    assert find_latch("USB 1234:5678 A2") is None


def test_the_command_line_refuses_and_clears(start_emulator):
    _, port = start_emulator("linger=30", electrodes=64)
    latch(str(Path(port).resolve()), "a fault")

    def run(*arguments):
        command, pipe = [PROGRAM, "devices", *arguments, f"link:{port}"], subprocess.PIPE
        with Forked(command, stdout=pipe, stderr=pipe, text=True) as program:
            out, _ = program.communicate()
        return program.returncode, out

    assert run("show")[0] == 2
    assert "a fault" in run("clear")[1]
    assert run("show")[0] == 0
    assert "a fault" not in run("clear")[1]


def test_a_range_of_scans_is_a_range_of_pulses(make_sequence):
    books = HostStatistics(8)
    sequence = make_sequence()
    books.add(sequence, 0)
    assert (books.report.sequences, books.report.pulses) == (1, 0)
    books.add(sequence, 3, again=True)
    books.add(sequence, 1, again=True, most=2)
    report = books.report
    assert (report.sequences, report.slots, report.pulses, report.most_pulses) == (1, 16, 128, 160)
    assert report.max_current_ma == pytest.approx(0.7)
    # The fifth pass is uncertain, so the absolute charges of its slots add up: 0.07 + 3 * 0.01 µC.
    exact = HostStatistics(8)
    exact.add(sequence, 4)
    assert exact.report.most_pulses == 128
    assert report.max_net_charge_uc == pytest.approx(exact.report.max_net_charge_uc + 0.1)
