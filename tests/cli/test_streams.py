"""Tests of closed or full streams, control characters in output, and unusual file names."""

import json
import os
import re
import shlex
import subprocess
from pathlib import Path

import pytest

from smarttouch.base.files import data_folder
from smarttouch.running.recording_reader import RecordedRun
from smarttouch.running.replay_check import check_recording

from ..support.full import sample
from ..support.processes import PROGRAM, Forked

SHORT = "live text:i --profile smarttouch-4x4 --seconds 0.2 --board simulated:"
EVIL = "a\x1b]0;owned\x07\x1b[31m\x9b5m\u202eb"
OBEYED = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]")


@pytest.fixture
def shell(tmp_path):
    """Return a function that runs a shell line, in which `smarttouch` is the tested program."""

    def run(line, **environment):
        line = f'smarttouch() {{ {shlex.quote(str(PROGRAM))} "$@"; }}; {line}'
        return subprocess.run(
            ["bash", "-c", line], cwd=tmp_path, capture_output=True, stdin=subprocess.DEVNULL,
            timeout=100, check=False, env={**os.environ, **environment},
        )  # fmt: skip

    return run


def refused(code, said):
    """Check for exit code 2 and one line on stderr; return this line."""
    assert (code, said[:12], said.count(b"\n")) == (2, b"smarttouch: ", 1), said
    return said.decode()


@pytest.mark.parametrize("closed", sample(["<&- >&- 2>&-", ">&-"]))
def test_closed_streams_lead_nowhere(shell, tmp_path, closed):
    done = shell(f"smarttouch {SHORT} --json f.json --record r.mcap {closed}")
    assert (done.returncode, done.stderr) == (0, b"")
    assert RecordedRun(tmp_path / "r.mcap").whole
    assert check_recording(tmp_path / "r.mcap").exact


@pytest.mark.parametrize("closed", sample([">&-", "<&- >&- 2>&-"]))
def test_errors_are_printed_where_that_stream_is_open(shell, closed):
    done = shell(f"smarttouch devices show link:/dev/nothing {closed}")
    assert done.returncode == 2
    assert (b"/dev/nothing" in done.stderr) == ("2>&-" not in closed)
    assert b"Traceback" not in done.stderr


@pytest.mark.parametrize("command", [
    "profiles", "--help", SHORT, "braille hello",
])  # fmt: skip
def test_a_full_disk_behind_standard_output(tmp_path, command):
    # One command runs in a new process, to test the exit of the interpreter as well.
    start = subprocess.Popen if command == "profiles" else Forked
    with (
        Path("/dev/full").open("w") as full,
        start(
            [PROGRAM, *command.split()], cwd=tmp_path,
            stdin=subprocess.DEVNULL, stdout=full, stderr=subprocess.PIPE,
        ) as process,
    ):  # fmt: skip
        said = process.communicate(timeout=100)[1]
    assert "standard output" in refused(process.returncode, said)


def test_errors_that_cannot_be_printed_change_nothing():
    command = [PROGRAM, *["live", "--intensity", "1", "--board", "link:/dev/nothing"]]
    with (
        Path("/dev/full").open("w") as full,
        Forked(command, stdout=subprocess.PIPE, stderr=full) as process,
    ):
        said = process.communicate(timeout=100)[0]
    assert (process.returncode, said) == (2, b"")


def test_whoever_reads_has_gone(shell):
    done = shell("smarttouch braille --tables | true; echo ${PIPESTATUS[0]}")
    assert done.stdout.strip() in (b"0", b"1")
    assert done.stderr == b""


def evil_profile(folder, name):
    text = (data_folder("calibration") / "smarttouch-4x4.toml").read_text(encoding="utf-8")
    title = json.dumps(EVIL + " [bold]:smile:[/nothing]")
    path = folder / name
    path.write_text(re.sub("(?m)^title = .*$", lambda _: f"title = {title}", text))
    return path


def shown(done):
    """Check that a run printed no control characters and no traceback; return its output."""
    text = done.stdout + done.stderr
    assert not OBEYED.search(text), OBEYED.search(text)
    assert "Traceback" not in text
    assert "internal error" not in text
    return text


@pytest.mark.parametrize("command", [
    "devices show simulated: --profile {}.toml", "design 1 --profile {}.toml",
    "live --board {}:x", "live --{}", "{}", "replay {}",
])  # fmt: skip
def test_control_characters_in_names_are_not_obeyed(program_here, tmp_path, command):
    evil_profile(tmp_path, EVIL + ".toml")
    text = shown(program_here(*(each.format(EVIL) for each in command.split(" "))))
    assert "owned" in text


def test_names_with_newlines_bytes_and_length(program_here, tmp_path):
    names = (b"a\nb.png", b"\xff\xfe.png", "é ".encode() * 60 + b".png", b"x" * 5000 + b".png")
    for name in map(os.fsdecode, names[:-1]):
        (tmp_path / name).write_bytes(b"\0 no picture")
    for name in map(os.fsdecode, names):
        for command in (("live", f"page:{name}"), ("read", name), ("replay", name)):
            done = program_here(*command)
            assert done.returncode == 2
            assert done.stderr.startswith("smarttouch: ")
            assert done.stderr.count("\n") == 1
            done.stderr.encode()
