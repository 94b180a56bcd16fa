"""A run is steered by keys, and ended by them, by another process, and by losing the terminal."""

import json
import os
import signal
import time

import pytest
from PIL import Image

from smarttouch.recording.reader import Recording

RUN = ("live", "--seconds", "60", "--json", "run.json", "--record", "run.mcap")


def wait_for_the_run(process, folder):
    """The recording begins when the board is open."""
    while process.poll() is None and not (folder / "run.mcap").exists():
        time.sleep(0.02)


def ended(process, folder):
    out, err = process.communicate(timeout=30)
    assert (process.returncode, err) == (0, "")
    assert "all electrodes off" in out
    figures = json.loads((folder / "run.json").read_text())
    assert figures["emulator_violations"] == 0
    return figures


def test_keys_turn_intensity_and_end_the_run(start_at_a_terminal, tmp_path):
    process, keys = start_at_a_terminal(*RUN, "--intensity", "0.1")
    wait_for_the_run(process, tmp_path)
    for key in (b"+", b"\x1b[A", b"-", b" ", b" ", b"m", b"0"):
        time.sleep(0.1)
        os.write(keys, key)
    time.sleep(0.3)
    os.write(keys, b"q")
    assert ended(process, tmp_path)["ended"] == "key q"
    words = [words for _, words in Recording(tmp_path / "run.mcap").events()]
    assert words.pop().startswith("dose ")
    assert words.pop().startswith("by the board's account")
    assert words == [
        "intensity 0.10",
        "mode RA",
        "intensity 0.15",
        "intensity 0.20",
        "intensity 0.15",
        "paused",
        "goes on",
        "mode SAI",
        "intensity 0.00",
        "key q",
    ]


@pytest.mark.parametrize("end", ["Esc", "terminal", "SIGHUP"])
def test_a_run_ends_in_order(start_at_a_terminal, tmp_path, end):
    process, keys = start_at_a_terminal(*RUN)
    wait_for_the_run(process, tmp_path)
    if end == "SIGHUP":
        process.send_signal(signal.SIGHUP)
    elif end == "Esc":
        os.write(keys, b"\x1b")
    else:
        os.dup2(os.open(os.devnull, os.O_RDONLY), keys)
    reason = ended(process, tmp_path)["ended"]
    assert reason == {"Esc": "key Esc", "SIGHUP": "SIGHUP"}.get(end, "the terminal is gone")


def test_another_process_stops_all_runs(start_at_a_terminal, program, tmp_path):
    first, _ = start_at_a_terminal(*RUN)
    wait_for_the_run(first, tmp_path)
    (tmp_path / "state" / "left behind").mkdir()
    stopped = program("stop")
    assert (stopped.returncode, stopped.stdout) == (0, "1 stopped.\n")
    assert ended(first, tmp_path)["ended"] == "SIGTERM"
    assert program("stop").stdout == "Nothing runs.\n"


def test_a_run_that_was_killed_is_no_run(start_at_a_terminal, program, tmp_path):
    process, _ = start_at_a_terminal(*RUN)
    process.kill()
    process.wait()
    assert list((tmp_path / "state").rglob("*.run"))
    assert program("stop").stdout == "Nothing runs.\n"
    assert not list((tmp_path / "state").rglob("*.run"))


def test_nobody_knows_the_force(program_here, tmp_path):
    (tmp_path / "frames").mkdir()

    Image.new("L", (64, 64), 255).save(tmp_path / "frames" / "1.png")
    result = program_here("live", "--sensor", "frames:frames", "--board", "memory:")
    assert result.returncode == 2
    assert "give --force, for example hx711:PORT" in result.stderr


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("--mode", "color"), "choose RA or SAI or PC or natural"),
        (("--intensity", "1.2"), "--intensity 1.2 must be from 0 to 1"),
        (("--softness", "nan"), "--softness nan must be from 0 to 1"),
        (("--size", "640"), "give width and height as 640x480"),
        (("--exposure", "3"), "page: does not take exposure"),
        (("--mode", "natural", "--rate", "50"), "set pulse.ra_rate_hz and pulse.sai_rate_hz"),
        (("--force", "cell:"), "unknown force 'cell:'"),
    ],
)
def test_what_cannot_be_asked_for(program_here, arguments, says):
    result = program_here("live", *arguments)
    assert result.returncode == 2
    assert says in result.stderr
    assert result.stderr.count("\n") == 1
