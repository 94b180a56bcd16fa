"""Recordings of sessions with a board, replayed as tests of its driver."""

import contextlib
import json
import os
import subprocess
from pathlib import Path

import pytest

import smarttouch as st
from smarttouch.base.errors import BoardError, LineLostError
from smarttouch.boards.open import make_board
from smarttouch.stimulation.safety_gate import SafetyLimits
from smarttouch.testing import replayed

from ..support.checks import raises
from ..support.processes import PROGRAM, Forked
from .emulator_waits import deliver
from .test_kajimoto61 import anodic

pytestmark = pytest.mark.realtime

PROFILES = {"kajimoto61": "kajimoto-61", "etactilekit": "etactilekit-32", "link": "electric-mouse"}


@pytest.fixture(autouse=True)
def _no_boot(monkeypatch):
    """Emulators need no time to boot."""
    monkeypatch.setattr("smarttouch.boards.kits.BOOT_S", 0.0)


def session(kind, port, options="", pulses=(400,)):
    """Open and close a board; send pulses in between if it is a kajimoto61."""
    profile = st.load_profile(PROFILES[kind])
    limits = SafetyLimits.of(profile)
    with make_board(f"{kind}:{port}{options}", limits, profile.output) as board:
        # Wait: while no sequence is sent, the driver of an eTactileKit loads zeros into the board.
        board._stopped.wait(0.3)
        for step, level_ua in enumerate(pulses) if kind == "kajimoto61" else ():
            deliver(board, anodic({}, 2 * step), anodic({3: level_ua, 5: level_ua}, 2 * step + 1))
    return board


@pytest.fixture
def recorded(start_emulator, tmp_path):
    """Return a function that records a session with an emulated board, and returns the file."""

    def run(kind, attempts=3):
        path = tmp_path / f"{kind}{attempts}.jsonl"
        electrodes = len(st.load_profile(PROFILES[kind]).electrodes)
        _, port = start_emulator(electrodes=electrodes, protocol=kind)
        try:
            session(kind, port, f"?record={path}")
        except LineLostError:
            # On a busy computer the emulator may answer too late.
            if attempts == 1:
                raise
            return run(kind, attempts - 1)
        return path

    return run


def events(path):
    return [json.loads(line) for line in path.read_text().splitlines()]


@pytest.mark.parametrize("kind", ["kajimoto61", "etactilekit"])
def test_a_recorded_session_is_a_test_of_the_driver(recorded, kind):
    path = recorded(kind)
    lines = events(path)
    assert lines[0]["event"] == "opened"
    times = [line["time_ns"] for line in lines]
    assert times == sorted(times)
    kinds = {line["event"] for line in lines}
    assert kinds == {"opened", "sent"} | ({"received"} if kind == "etactilekit" else set())
    with replayed(path) as port:
        session(kind, port)


def test_bytes_that_differ_are_named_with_their_position(recorded):
    path = recorded("kajimoto61")
    sent = b"".join(bytes.fromhex(line["hex"]) for line in events(path) if line["event"] == "sent")
    # `anodic` rounds 400 µA to 360 µA. The driver sends 9 steps of 39.06 µA, or 352 µA.
    position = sent.index(9)
    with raises(BoardError, names=(f"byte {position} ", "0b", "09")), replayed(path) as port:
        session("kajimoto61", port, pulses=(440,))
    # The host writes one byte more, or one byte less, than was recorded.
    for written, position, got, was in (
        (sent + b"\x07", len(sent), "07", "none"), (sent[:-1], len(sent) - 1, "none", "00")
    ):  # fmt: skip
        names = (f"byte {position} from the host is {got}, but {was}",)
        with raises(BoardError, names=names), replayed(path) as port:
            host = os.open(port, os.O_RDWR | os.O_NOCTTY)
            os.write(host, written)
            os.close(host)


@pytest.mark.parametrize(("pulses", "status"), [((400,), 0), ((440,), 2)])
def test_the_program_serves_a_recording_until_the_host_is_gone(recorded, pulses, status):
    path = recorded("kajimoto61")
    command = [PROGRAM, "devices", "emulate", str(path)]
    with Forked(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as device:
        # If bytes differ from the recording, the emulator ends and its port disappears.
        with contextlib.suppress(*[BoardError] * (status == 2)):
            session("kajimoto61", device.stdout.readline().strip(), pulses=pulses)
        assert device.wait() == status
        assert ("byte 189 from the host is 0b" in device.stderr.read()) == (status == 2)


def test_a_link_board_cannot_be_replayed(recorded):
    """Each session of a link board has a random number, so that its bytes always differ."""
    path = recorded("link")
    with (
        raises(BoardError, names=("from the host is",)), replayed(path) as port,
        pytest.raises(BoardError),
    ):  # fmt: skip
        session("link", port)


def test_a_file_that_exists_and_a_board_without_a_port_are_refused(tmp_path):
    limits = SafetyLimits.of(st.load_profile("electric-mouse"))
    path = tmp_path / "notes.txt"
    path.write_text("mine")
    with raises(BoardError, names=(str(path),)):
        make_board(f"link:/dev/x?record={path}", limits)
    with raises(BoardError, names=("board must have a port",)):
        make_board(f"simulated:?record={tmp_path / 'new'}", limits)
    assert path.read_text() == "mine"
    with raises(BoardError, names=("not a recorded device",)), replayed(path):
        pass


def test_a_full_disk_ends_the_recording_and_not_the_run(start_emulator, tmp_path, monkeypatch):
    def full(*_, **__):
        return Path("/dev/full").open("a")

    monkeypatch.setattr("smarttouch.boards.driver.open", full, raising=False)
    _, port = start_emulator(electrodes=61, protocol="kajimoto61")
    board = session("kajimoto61", port, f"?record={tmp_path / 'new'}")
    assert board.report().slots == 2
    assert [note for note in board.notes if "No space left" in note]
