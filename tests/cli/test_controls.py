"""Tests of keys that steer or end a run, and of a terminal that is lost or stopped."""

import contextlib
import json
import os
import select
import subprocess
import time

import numpy as np
import pytest

from smarttouch.base.afferent import Mode
from smarttouch.profile import load_profile
from smarttouch.profile.settled_levels import levels_file
from smarttouch.running.recording_reader import RecordedRun

from ..boards.emulator_waits import until
from ..support.processes import PROGRAM, Forked

RUN = ("live", "--seconds", "60", "--json", "run.json", "--record", "run.mcap")


def wait_for(process, words):
    """Read the output of a run up to a line that ends in these words."""
    assert any(line.rstrip().endswith(words) for line in iter(process.stdout.readline, ""))


def wait_for_the_run(process):
    """Wait until a run prints its mode, which it does when it begins."""
    wait_for(process, ": mode RA")


def ended(process, folder):
    _, err = process.communicate(timeout=60)
    assert (process.returncode, err) == (0, "")
    figures = json.loads((folder / "run.json").read_text())
    assert figures["emulator_violations"] == 0
    return figures


def test_keys_turn_intensity_and_end_the_run(start_at_a_terminal, tmp_path):
    process, keys = start_at_a_terminal(*RUN, "--intensity", "0.1")
    wait_for_the_run(process)
    for key, words in (
        (b"+", "intensity 0.15"), (b"\x1b[A", "intensity 0.20"), (b"-", "intensity 0.15"),
        (b" ", "paused"), (b" ", "resumed"), (b"m", "mode SAI"), (b"0", "intensity 0.00"),
    ):  # fmt: skip
        os.write(keys, key)
        wait_for(process, words)
    os.write(keys, b"q")
    assert ended(process, tmp_path)["ended"] == "key q"
    words = [words for _, words in RecordedRun(tmp_path / "run.mcap").events]
    assert words.pop().startswith("dose: ")
    assert words.pop().startswith("counted by the board")
    assert words == [
        "intensity 0.10", "mode RA", "intensity 0.15", "intensity 0.20", "intensity 0.15", "paused",
        "resumed", "mode SAI", "intensity 0.00", "key q",
    ]  # fmt: skip


def test_the_last_comfortable_level_is_reached_by_a_key(
    start_at_a_terminal, start_emulator, tmp_path
):
    """On a finger a run begins at zero; key L ramps intensity up to the last comfortable level."""
    _, port, _ = start_emulator()
    log = levels_file(profile := load_profile("electric-mouse"))
    log.parent.mkdir(parents=True)
    current_ma = 0.45 * float(profile.full_ma.max())
    log.write_text(
        f'{{"time": "2026-01-02T03:04:05Z", "mode": "RA", "level": 0.45, "force_n": 0.8, '
        f'"current_ma": {current_ma}, "kohm": null}}\n'
    )
    board = ("--board", f"link:{port}", "--force", "fixed:1", "--intensity", "0.6")
    process, keys = start_at_a_terminal(*RUN, *board)
    wait_for(process, "intensity 0.00")
    wait_for_the_run(process)
    os.write(keys, b"L")
    wait_for(process, "intensity 0.45")
    time.sleep(2)
    os.write(keys, b"q")
    _, err = process.communicate(timeout=60)
    assert process.returncode == 0
    assert "level 0.45 was comfortable last time in mode RA: press L to rise to it" in err
    steps = [recorded.step for recorded in RecordedRun(tmp_path / "run.mcap").steps()]
    flowing = [step.sequence.intensity for step in steps]
    assert flowing[0] == 0
    # On a busy computer, late sequences restart the ramp at zero.
    assert 0.1 < max(flowing) <= 0.45
    assert np.diff(flowing).max() < 0.1
    for profile_name, status in (("electric-mouse", 0), ("kajimoto-61", 2)):
        show = [PROGRAM, "profiles", "show", profile_name, "--levels", "drift.png"]
        assert subprocess.run(show, cwd=tmp_path, capture_output=True).returncode == status
    assert (tmp_path / "drift.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("end", ["Esc", "terminal"])
def test_a_run_ends_in_order(start_at_a_terminal, tmp_path, end):
    process, keys = start_at_a_terminal(*RUN)
    wait_for_the_run(process)
    if end == "Esc":
        os.write(keys, b"\x1b")
    else:
        os.dup2(os.open(os.devnull, os.O_RDONLY), keys)
    reason = ended(process, tmp_path)["ended"]
    assert reason == ("key Esc" if end == "Esc" else "the terminal is gone")


def test_a_stopped_terminal_delays_the_screen_and_neither_the_run_nor_its_keys(tmp_path):
    """Ctrl-S freezes the screen, but keys and frames continue; Ctrl-Q shows the end of the run."""
    ours, terminal = os.openpty()
    with Forked(
        [PROGRAM, *RUN], cwd=tmp_path, stdin=terminal, stdout=terminal, stderr=subprocess.PIPE,
        text=True, env={**os.environ, "TERM": "xterm"},
    ) as process:  # fmt: skip
        os.close(terminal)
        drawn = b""
        while b"pressure" not in drawn:
            drawn += os.read(ours, 1 << 16)
        os.write(ours, b"\x13")
        while select.select([ours], [], [], 0.5)[0]:
            os.read(ours, 1 << 16)
        os.write(ours, b"m")
        assert not select.select([ours], [], [], 1.0)[0], "the screen changed after Ctrl-S"
        os.write(ours, b"q")
        until(lambda: (tmp_path / "run.json").exists())
        os.write(ours, b"\x11")
        shown = b""
        with contextlib.suppress(OSError):
            while data := os.read(ours, 1 << 16):
                shown += data
        os.close(ours)
        figures = ended(process, tmp_path)
    assert b"key q" in shown
    assert figures["ended"] == "key q"
    # Mode SAI lasted for 1 s at least. This is 50 steps, or fewer on a busy computer.
    modes = [each.step.mode for each in RecordedRun(tmp_path / "run.mcap").steps()]
    assert modes.count(Mode.SAI) > 10
