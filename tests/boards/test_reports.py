"""A board that delivers what was not sent is latched; the host's own account of what is scanned."""

import subprocess
import sys
import time
from pathlib import Path

import pytest

from smarttouch.base.errors import BoardFaultError, BoardLatchedError
from smarttouch.boards.open import make_board
from smarttouch.boards.reports import HostStatistics, clear_latch, find_latch, latch
from smarttouch.profile.device import Output

from ..support.processes import PROGRAM, Forked
from .fresh import starter

pytestmark = pytest.mark.usefixtures("patient_boards")

FAULTY = str(Path(__file__).with_name("faulty_board.py"))


@pytest.fixture(autouse=True)
def own_state(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))


@pytest.fixture
def start_faulty():
    """Return a starter of boards with a fault; it returns their port."""
    with starter() as start:

        def start_one(fault, protocol, electrodes):
            ramp = "&ramp_ms=0" * (protocol == "link")
            url = f"{protocol}?electrodes={electrodes}&linger=5{ramp}"
            process = start([sys.executable, FAULTY, fault, url], start_new_session=True)
            return process.stdout.readline().strip()

        yield start_one


def deliver(board, make_sequence, count=4, **fields):
    """Send some sequences and wait for each."""
    with board:
        for step in range(count):
            board.send(make_sequence(step, **fields))
            board.drain()
            time.sleep(0.02)
        board.report()
        # Cut by the end: what comes after it is no more than was sent.
        board.send(make_sequence(count, **fields), times=50)


@pytest.mark.parametrize("fault", ["twice", "violation", "strong", "after zero", "volts"])
def test_a_link_board_is_latched(fault, start_faulty, make_limits, make_sequence):
    port = start_faulty(fault, "link", 8)
    with pytest.raises(BoardFaultError) as found:
        deliver(make_board(f"link:{port}", make_limits()), make_sequence)
    again = make_board(f"link:{port}", make_limits())
    with pytest.raises(BoardLatchedError) as refused:
        again.open()
    record = clear_latch(again.device)
    assert f"since {record}; have it checked" in str(refused.value)
    assert str(found.value).startswith(f"{record.split(': ', 1)[1]}: ")
    assert find_latch(again.device) is None


def test_an_output_beside_the_pattern_latches_a_kit(start_faulty, make_limits, make_sequence):
    port = start_faulty("beside", "etactilekit", 8)
    output = Output(kind="one-against-all", ua_per_count=9.99)
    board = make_board(f"etactilekit:{port}", make_limits(), output)
    with pytest.raises(BoardFaultError):
        deliver(board, make_sequence, 6, slots=2, period_us=50_000)
    assert find_latch(board.device) is not None


def test_a_record_outlives_its_process_and_is_private(tmp_path, make_limits):
    latch("USB 1234:5678 A1", "a fault")
    latch("USB 1234:5678 A1", "a later one")
    (record,) = tmp_path.rglob("*.json")
    assert record.stat().st_mode & 0o077 == 0
    assert find_latch("USB 1234:5678 A1").endswith(": a fault")
    record.write_text("nonsense")
    assert find_latch("USB 1234:5678 A1") is not None, "a record that cannot be read is a fault"
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
    # What may have flowed counts too: four slots of .07 µC on one electrode at worst.
    exact = HostStatistics(8)
    exact.add(sequence, 4)
    assert exact.report.most_pulses == 128
    assert report.max_net_charge_uc == pytest.approx(exact.report.max_net_charge_uc + 0.28)
