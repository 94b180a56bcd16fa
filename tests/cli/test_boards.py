"""Boards from the command line: found, looked at, measured, tried, stopped, and run."""

import os
import signal
import subprocess
import time

import pytest

from smarttouch.base.errors import BoardError
from smarttouch.boards.link.protocol import HostSession, MessageKind
from smarttouch.emulator.firmware import STATE_FILE, read_slots, read_state

from ..boards.fresh import fresh_state, until
from ..forks import PROGRAM, Forked
from .conftest import PRESSED, refused, says

pytestmark = pytest.mark.usefixtures("patient_boards")

FULL = "--force fixed:1 --intensity 1"
KITS = {
    "kajimoto61": (61, "kajimoto61"),
    "etactilekit": (32, "etactilekit"),
    "etactilekit over TCP": (32, "etactilekit", "tcp"),
}


@pytest.fixture
def kit(request, start_emulator):
    """The URL of an emulated board, and its books."""
    electrodes, protocol, *more = {"link": (64, "link"), **KITS}[request.param]
    _, port, books = start_emulator(electrodes, protocol, *more)
    return f"{protocol}:{port}", books


@pytest.fixture(autouse=True)
def _no_boot(monkeypatch):
    """Emulators need no time to boot: drivers in this process do not wait for it."""
    monkeypatch.setattr("smarttouch.boards.kits.current_scale.BOOT_S", 0.0)


def on(*names):
    return pytest.mark.parametrize("kit", names, indirect=True)


def state_of(books):
    """Return what a board's books say once it is at zero."""
    until(lambda: fresh_state(books)["state"] == "shorted")
    return read_state(books)


@pytest.mark.realtime
@on(*KITS)
def test_live_end_to_end_ends_in_zero(program_here, kit):
    url, books = kit
    done = program_here(f"live --board {url} {FULL} --seconds 1.7 --json run.json").fine()
    # That one goes on by itself if its line breaks, and who runs it is warned.
    assert done.stderr.count("\n") == url.startswith("etactilekit")
    figures = done.figures
    assert "1.7 s" in figures["ended"]
    assert figures["frames"] > 2
    assert 0 < figures["acknowledged"] <= figures["frames"]
    assert figures["pulses"] <= figures["pulses_at_most"]
    assert (figures["reported_by"], figures["restarts"]) == ("host", 0)
    state = state_of(books)
    assert (state["state"], state["unsafe"]) == ("shorted", 0)
    assert state["slots"] > 5
    assert state["max_current_ma"] <= figures["max_current_ma"] + 0.04
    assert state_of(books)["slots"] == state["slots"]


@on("link")
def test_packets_that_come_twice_are_reported(program_here, monkeypatch, kit):
    encode = HostSession.encode

    def twice(session, kind, *more):
        return encode(session, kind, *more) * (1 + (kind == MessageKind.SEQUENCE))

    monkeypatch.setattr(HostSession, "encode", twice)
    live = f"live --board {kit[0]} --force fixed:1 --intensity 0 --seconds 1"
    done = program_here(f"{live} --json run.json").fine()
    figures = done.figures
    assert figures["packets_refused_by_host"] == 0
    assert figures["packets_refused_by_board"] >= figures["acknowledged"] > 10
    assert state_of(kit[1])["old_packets"] >= figures["packets_refused_by_board"]


@on("kajimoto61", "etactilekit")
def test_a_signal_ends_in_zero(start_program, kit):
    url, books = kit
    how = signal.SIGTERM if url.startswith("kajimoto61") else signal.SIGINT
    running = start_program("live", "--board", url, *PRESSED, "--intensity", "1")
    wait_for_pulses(books)
    running.send_signal(how)
    running.communicate(timeout=60)
    assert running.returncode == 0
    state = state_of(books)
    assert (state["state"], state["unsafe"]) == ("shorted", 0)


def wait_for_pulses(books):
    until(lambda: read_state(books)["slots"])


@on("kajimoto61", "etactilekit")
def test_a_killed_host(start_program, kit):
    """The host-clocked board is at zero by itself, the other by its watchdog."""
    url, books = kit
    running = start_program("devices", "test", url, *PRESSED, "--seconds", 30, "--current-ma", 0.5)
    wait_for_pulses(books)
    # By then its current has risen, and nothing changes any more.
    time.sleep(0.5)
    running.kill()
    running.wait()
    time.sleep(0.3)
    before = state_of(books)
    after = state_of(books)
    assert after["unsafe"] == 0
    assert after["slots"] == before["slots"]


def test_info_of_the_newest_kit_has_how_long_it_goes_on(program_here, start_emulator):
    _, port, _ = start_emulator(32, "etactilekit", "firmware=newest")
    # On a busy computer it may pass for the one before it: then once more.
    for _ in range(10):
        done = program_here("devices show", f"etactilekit:{port}").fine()
        if "newest" in done.stdout:
            break
    assert "newest" in done.stdout
    assert "520 ms" in done.stdout


@on("kajimoto61", "etactilekit", "link")
def test_info(program_here, kit):
    done = program_here("devices show", kit[0]).fine()
    told = {line[:14].strip(): line[14:].split() for line in done.stdout.splitlines()}
    electrodes, profile = {
        "kajimoto61": ("61,", "kajimoto-61:"),
        "etactilekit": ("32,", "etactilekit-32:"),
        "link": ("64,", "electric-mouse:"),
    }[kit[0].partition(":")[0]]
    assert (told["electrodes"][0], told["profile"][0]) == (electrodes, profile)
    assert told["firmware"]
    assert "mA" in told["current"]
    assert state_of(kit[1])["slots"] == 0


def test_measuring_finds_bad_electrodes(program_here, start_emulator):
    events = ("event=0 open 5", "event=0 short 9")
    _, port, _ = start_emulator(32, "etactilekit", *events)
    done = program_here(f"devices measure etactilekit:{port} --json found.json").fine()
    found = done.figures
    assert found["masked"] == [5, 9]
    assert "masked = [5, 9]" in done.stdout
    assert found["impedance_kohm"][5] is None


def test_measuring_without_a_finger_is_reported(program_here, start_emulator):
    _, port, _ = start_emulator(16, "link", "output=three-state", "event=0 lift")
    small = f"link:{port} --profile smarttouch-4x4"
    found = program_here(f"devices measure {small} --json found.json").fine().figures
    assert found["condition"] == ["open"] * 16
    assert found["impedance_kohm"] == [None] * 16


@on("etactilekit")
def test_a_walk_through_the_electrodes(program_here, kit):
    url, books = kit
    done = program_here(
        f"devices test {url} --force fixed:1 --seconds 0.15 --current-ma 0.3"
    ).fine()
    assert "32 of 32 electrodes" in done.stdout
    state = state_of(books)
    assert (state["state"], state["unsafe"]) == ("shorted", 0)
    assert state["max_current_ma"] <= 0.33
    slots = read_slots(books)
    assert list(dict.fromkeys(slots["site"].tolist())) == list(range(32))


def test_a_key_goes_on_to_the_next_electrode_and_q_ends_it():
    keyboard, there = os.openpty()
    with Forked(
        [PROGRAM, "devices", "test", "memory:"], stdin=there, stdout=subprocess.PIPE, text=True
    ) as walking:
        os.close(there)
        for number, key in enumerate("nnq"):
            line = walking.stdout.readline()
            assert line.startswith(f"electrode {number}:")
            assert "0.5 mA" in line
            time.sleep(0.1)
            os.write(keyboard, key.encode())
        assert walking.stdout.readline().startswith("3 of 64 electrodes")
        assert walking.wait(60) == 0
    os.close(keyboard)


def test_one_electrode_alone(program_here):
    done = program_here("devices test memory: --electrode 3 --seconds 0.05").fine()
    assert [line.split(":")[0] for line in done.stdout.splitlines()[:-1]] == ["electrode 3"]
    assert done.stdout.splitlines()[-1].startswith("1 of 1 electrodes")


@on("etactilekit")
def test_stop(program_here, kit):
    program_here("stop", kit[0]).fine()
    state = state_of(kit[1])
    assert (state["state"], state["slots"]) == ("shorted", 0)


@on("kajimoto61")
def test_the_scale_from_a_resistor(program_here, kit):
    done = program_here("calibrate scale", kit[0], "--volts", 1.1, "--ohm", 1000).fine()
    assert "1.100 mA" in done.stdout
    assert "ua_per_count = 2.686" in done.stdout
    assert fresh_state(kit[1])["slots"] == 0


def test_a_scale_is_not_measured_out_of_its_band_step_by_step(program_here, tmp_path):
    from smarttouch.base.files import data_folder

    text = (data_folder("calibration") / "kajimoto-61.toml").read_text(encoding="utf-8")
    path = tmp_path / "own.toml"
    path.write_text(text.replace("[output]", "[output]\nua_per_count = 3.0"), encoding="utf-8")
    measure = ("calibrate", "scale", "kajimoto61:x", "--profile", path, "--volts")
    done = program_here(*measure, 1.2)
    assert done.stdout == ""
    says(BoardError, "ua_per_count = 3.6")(refused(done))
    done = program_here(*measure, 0.9).fine()
    assert "ua_per_count = 2.7" in done.stdout


def test_what_is_there_is_listed_and_nothing_is_opened(program_here):
    done = program_here("devices").fine()
    assert "kajimoto61:" in done.stdout


@pytest.mark.parametrize(("name", "how"), [
    ("link", signal.SIGTERM), ("kajimoto61", signal.SIGINT), ("etactilekit", signal.SIGINT),
])  # fmt: skip
def test_an_emulator_is_played_until_it_is_ended(program_here, start_program, tmp_path, name, how):
    books = tmp_path / "books"
    books.mkdir()
    real = name == "link"
    playing = start_program("devices", "emulate", f"{name}?books={books}", real=real)
    lines = [playing.stdout.readline() for _ in range(3)]
    url = lines[2].split()[3]
    assert url.startswith(f"{name}:/dev/")
    program_here("devices show", url).fine()
    playing.send_signal(how)
    assert playing.wait(60) == 0
    state = state_of(books)
    assert (state["state"], state["reason"]) == ("shorted", "signal")


def test_an_emulator_that_is_killed_leaves_no_board_behind(start_program, tmp_path):
    playing = start_program("devices", "emulate", f"link?books={tmp_path}", real=True)
    assert playing.stdout.readline()

    def written():
        return (tmp_path / STATE_FILE).stat().st_mtime_ns

    before = written()
    until(lambda: written() != before)
    playing.kill()
    playing.wait()
    before = written()
    time.sleep(0.3)
    assert written() == before
