"""Tests that another user of the computer can neither steer a run nor read its files."""

import json
import os
import re
import shutil
import stat
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path
from urllib.parse import urlsplit

import pytest

from smarttouch.base.errors import RecordingError
from smarttouch.running.recording_reader import RecordedRun

from ..support.full import sample
from .test_window import page_of

INTRUDER = r"""
import glob, http.client, json, os, re, socket, sys

def content(path):
    try:
        with open(path, "rb") as file:
            return file.read()
    except OSError:
        return b""

port, door, folder = int(sys.argv[1]), sys.argv[2], sys.argv[3]
place = f"127.0.0.1:{port}"
processes = b"\0".join(map(content, glob.glob("/proc/[0-9]*/cmdline")))
said = processes + b"\0".join(map(content, glob.glob("/proc/[0-9]*/environ")))
led_to = re.findall(rb"file://(/\S+?window\.html)", processes)
files = [*led_to, *(os.fsencode(os.path.join(at, name))
                    for at, _, names in os.walk(folder) for name in names)]
contents = {os.path.basename(os.fsdecode(each)): content(each) for each in files}
said += b"\0".join(contents.values())
secrets = re.findall(rf"http://{place}/([^/\s\"]+)/".encode(), said)
guess = secrets[0].decode() if secrets else "guess"

def ask(method, path, **headers):
    line = http.client.HTTPConnection("127.0.0.1", port, timeout=20)
    line.request(method, path, headers={"Origin": f"http://{place}", **headers})
    return line.getresponse().status

upgrade = {"Connection": "Upgrade", "Upgrade": "websocket", "Sec-WebSocket-Version": "13",
           "Sec-WebSocket-Key": "AAAAAAAAAAAAAAAAAAAAAA=="}
with socket.socket(socket.AF_UNIX) as line:
    connected = line.connect_ex(door) == 0
print(json.dumps({
    "browser": len(led_to), "secrets": len(secrets),
    "read": sorted(name for name, data in contents.items() if data),
    "page": ask("GET", f"/{guess}/live.html"), "socket": ask("GET", f"/{guess}/socket", **upgrade),
    "root": ask("GET", "/"), "stop": ask("POST", "/stop"), "connected": connected,
}))
"""
BROWSER = '#!/bin/sh\n: > "$0.opened"\nwhile [ ! -e "$0.closed" ]; do sleep 0.05; done\n'


@pytest.fixture
def open_folder():
    """Yield a folder that all users can read."""
    folder = Path(tempfile.mkdtemp(prefix="smarttouch-test-", dir="/tmp"))
    folder.chmod(0o755)
    yield folder
    shutil.rmtree(folder)


def has_steps(path):
    """Return whether a recording, which can be unfinished, has a step."""
    try:
        return next(RecordedRun(path).steps(), None) is not None
    except RecordingError:
        # The file is missing, or its header is still incomplete.
        return False


def test_another_account_gets_in_by_no_door(start_program, other_account, open_folder, monkeypatch):
    browser, path, door = (open_folder / each for each in ("browser", "run.mcap", "door"))
    browser.write_text(BROWSER)
    browser.chmod(0o755)
    monkeypatch.setenv("BROWSER", str(browser))
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setenv("TMPDIR", str(open_folder))
    before = os.umask(0)
    try:
        run = start_program(
            "live", f"socket:{door}", "--board", "simulated:", "--window",
            "--record", path, real=True,
        )  # fmt: skip
    finally:
        os.umask(before)
    pages = ExitStack()
    try:
        address = re.match("window: (http://[^ ]+) ", run.stderr.readline())[1]
        port = urlsplit(address).port
        # The fake browser never loads the page. The run begins when this socket connects.
        pages.enter_context(page_of(address))
        while not (has_steps(path) and (open_folder / "browser.opened").exists()):
            assert run.poll() is None
            time.sleep(0.02)
        with other_account("-c", INTRUDER, port, door, open_folder) as intruder:
            out, err = intruder.communicate(timeout=100)
        assert err == ""
        assert json.loads(out) == {
            "browser": 1, "secrets": 0, "read": ["browser"],
            "page": 403, "socket": 403, "root": 403, "stop": 403, "connected": False,
        }  # fmt: skip
        # Control: when the user of the run starts the same script, it finds secrets and files.
        given = [sys.executable, "-c", INTRUDER, str(port), str(door), str(open_folder)]
        ours = json.loads(subprocess.check_output(given, text=True))
        assert ours["secrets"] > 0
        assert {"window.html", "run.mcap"} <= set(ours["read"])
        assert (ours["page"], ours["socket"], ours["stop"], ours["connected"]) == (200, 101, 403, 1)
        assert stat.S_IMODE(path.stat().st_mode) == 0o600
        assert run.poll() is None
    finally:
        pages.close()
        (open_folder / "browser.closed").touch()
        run.terminate()
        run.communicate(timeout=60)
    steps = list(RecordedRun(path).steps())
    assert steps
    assert not any(each.step.sequence.current_ua.any() for each in steps)


LIVE = ("live", "text:oo", "--board", "simulated:", "--seconds", "0.3")
COMMANDS = {
    "run": (
        (*LIVE, "--record", "run.mcap", "--json", "run.json"),
    ),
    "felt": ((*LIVE, "--felt", "felt.png"),),
    "vibrations": ((*LIVE, "--set", "vibrators=out.wav"),),
    "experiment": (
        ("experiment", "run", "frequency?standards=30&train_s=0.15&repetitions=1&gap_s=0.1",
         "--simulate", "model", "--output", "a.csv"),
    ),
    "profile": (
        ("profiles", "new", "--grid", "4x4", "--pitch", "1.4", "mine.toml"),
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", sample(COMMANDS))
def test_files_and_folders_of_a_command(program_here, tmp_path, monkeypatch, name):
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    # The check at the end skips the folder ``state``, so make this folder with any mode.
    (tmp_path / "state").mkdir()
    (tmp_path / "pictures").mkdir(mode=0o700)
    before = os.umask(0)
    try:
        for command in COMMANDS[name]:
            program_here(*command).fine()
    finally:
        os.umask(before)
    modes = {
        str(each.relative_to(tmp_path)): f"{stat.S_IMODE(each.stat().st_mode):o}"
        for each in tmp_path.rglob("*")
        if "state" not in each.parts
    }
    assert len(modes) > len(COMMANDS[name])
    assert {path: mode for path, mode in modes.items() if mode not in ("600", "700")} == {}
