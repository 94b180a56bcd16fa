"""Tests of boards from the command line: ``devices``, ``live``, ``stop``, ``calibrate scale``."""

import os
import re
import signal
import subprocess
import time

import pytest

from smarttouch.emulator.firmware_base import STATE_FILE, read_slots, read_state

from ..boards.emulator_waits import fresh_state, until
from ..support.full import sample
from ..support.processes import PROGRAM, Forked
from .conftest import refused, says

FULL = "--force fixed:1 --intensity 1"
KITS = {
    "kajimoto61": (61, "kajimoto61"),
    "etactilekit": (32, "etactilekit"),
    "etactilekit over TCP": (32, "etactilekit", "tcp"),
}


@pytest.fixture
def kit(request, start_emulator):
    """Return the URL of an emulated board, and the folder of its delivery log."""
    electrodes, protocol, *more = {"link": (64, "link"), **KITS}[request.param]
    _, port, books = start_emulator(electrodes, protocol, *more)
    return f"{protocol}:{port}", books


@pytest.fixture(autouse=True)
def _no_boot(monkeypatch):
    """Let drivers in this process skip the wait for a boot, which emulators do not need."""
    monkeypatch.setattr("smarttouch.boards.kits.BOOT_S", 0.0)


def on(*names):
    """Parametrize a test with emulated boards, which need real time."""
    kits = [pytest.param(name, marks=pytest.mark.realtime) for name in names]
    return pytest.mark.parametrize("kit", kits, indirect=True)


def state_of(books):
    """Wait until an emulated board is at zero; return the state in its delivery log."""
    until(lambda: fresh_state(books)["state"] == "shorted")
    return read_state(books)


@on(*sample(KITS, 3))
def test_live_end_to_end_ends_in_zero(program_here, kit):
    url, books = kit

    def run_on_time():
        """Run; return the result, or None if the program was paused or the board restarted."""
        run = program_here(f"live --board {url} {FULL} --seconds 1.7 --json run.json")
        if "was paused" in run.stderr or run.fine().figures["restarts"]:
            return None
        return run

    done = until(run_on_time)
    # The user is warned that an etactilekit board does not stop if its connection is lost.
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


@on("etactilekit")
def test_a_walk_through_the_electrodes(program_here, kit):
    url, books = kit

    def walks():
        """Walk; return whether the board delivered pulses of all electrodes in order."""
        before = len(read_slots(books))
        done = program_here(
            f"devices test {url} --force fixed:1 --seconds 0.08 --current-ma 0.3"
        ).fine()
        assert "at zero" in done.stdout
        state = state_of(books)
        assert (state["state"], state["unsafe"]) == ("shorted", 0)
        assert state["max_current_ma"] <= 0.33
        return list(dict.fromkeys(read_slots(books)["site"][before:].tolist())) == list(range(32))

    # On a busy computer, a restart of intensity may leave an electrode no time for a pulse.
    until(walks)


@pytest.mark.parametrize(("force", "said"), [("1", ""), ("0", " no pulse: 3.")])
def test_a_walk_names_the_electrodes_that_were_sent_no_pulse(program_here, force, said):
    done = program_here(
        f"devices test memory: --force fixed:{force} --seconds 0.3 --current-ma 0.3 --electrode 3"
    ).fine()
    assert said in done.stdout
    assert ("no pulse" in done.stdout) == bool(said)


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
        assert walking.stdout.readline().startswith("All electrodes are at zero")
        assert walking.wait(60) == 0
    os.close(keyboard)


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


def test_what_is_there_is_listed_and_nothing_is_opened(program_here):
    done = program_here("devices").fine()
    assert "kajimoto61:" in done.stdout


@pytest.mark.realtime
@pytest.mark.parametrize(("name", "how"), sample([
    ("link", signal.SIGTERM), ("kajimoto61", signal.SIGINT), ("etactilekit", signal.SIGINT),
], 3))  # fmt: skip
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


@pytest.mark.realtime
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


def table(output):
    return dict(re.split(r" {2,}", line.strip(), maxsplit=1) for line in output.splitlines())


def test_a_page_is_shown(program_here):
    shown = program_here("devices show text:touch --seconds 0.2").fine()
    rows = table(shown.stdout)
    assert rows["source"]
    assert re.findall(r"\d+", rows["read"]) == ["21", "100"]
    assert rows["size"].startswith("64 x 64, ")
    assert re.search(r"\b0\.\d+ N", rows["force"])


@pytest.mark.parametrize("command", [
    ("live",), ("live", "texture:"), ("read", "text:a"),
    ("live", "vibration:tone:30Hz,8um+press:0.5N"),
    ("experiment", "run", "free", "--seconds", "1"), ("devices", "test", "--seconds", "1"),
])  # fmt: skip
def test_no_command_drives_a_real_board_that_nobody_controls(program_here, command):
    board = ("link:/dev/nowhere",) if command[0] == "devices" else ("--board", "link:/dev/nowhere")
    about = "keyboard" if command[0] == "devices" else "intensity"
    says(names=about)(refused(program_here(*command, *board)))


@pytest.mark.parametrize(
    "command",
    sample([
        ("live",), ("read", "text:a"), ("live", "texture:"),
        ("live", "vibration:tone:30Hz,8um+press:0.5N"),
        ("experiment", "run", "detection"),
        ("experiment", "run", "free", "--seconds", "1", "--profile", "kajimoto-61"),
        ("devices", "test", "--seconds", "1", "--current-ma", "0.5"),
        ("calibrate", "thresholds", "--output", "mine.toml", "--electrodes", "5"),
    ]),
    ids=" ".join,
)  # fmt: skip
def test_no_command_drives_a_real_board_whose_finger_nobody_measures(
    start_at_a_terminal, start_emulator, command
):
    _, port, books = start_emulator(61, "kajimoto61")
    url = f"kajimoto61:{port}"
    board = (url,) if command[0] == "devices" else ("--board", url)
    process, _ = start_at_a_terminal(*command, *board)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 2
    assert "--force" in errors
    assert fresh_state(books)["max_current_ma"] == 0
