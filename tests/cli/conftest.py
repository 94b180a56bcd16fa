"""The installed program, run as a user runs it."""

import contextlib
import io
import json
import os
import pty
import shlex
import subprocess
import sys
import tempfile
import termios
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image

from smarttouch import cli
from smarttouch.base.errors import SmartTouchError

from ..boards.fresh import starter
from ..support.checks import assert_says
from ..support.processes import PROGRAM, Forked, emulator

PRESSED = ("--force", "fixed:1")
"""Where nothing measures force on a board that a finger may be on."""


def says(kind=SmartTouchError, *names, **attributes):
    """Return a check that an error is of just this type, with these names and attributes.

    Names, and numbers with their units, are looked for in what it says.
    """

    def check(error):
        assert type(error) is kind, repr(error)
        assert_says(error, **attributes)
        assert [name for name in names if name not in str(error)] == [], error

    return check


class Done(SimpleNamespace):
    """How a run in this process ended: `returncode`, `stdout`, `stderr`, its `error`."""

    def fine(self):
        """Check that it ended well; return it."""
        assert self.returncode == 0, self.stderr
        return self

    def flawless(self):
        """Check that it ended well and warned of nothing; return it."""
        assert self.fine().stderr == ""
        return self

    @property
    def figures(self):
        """What it wrote to the file that ``--json`` names."""
        return json.loads(self.json_path.read_text())


def refused(done):
    """Check that a run in this process ended with one sentence; return the error behind it."""
    assert done.returncode == 2, done.stdout
    assert done.stderr.startswith("smarttouch: ")
    assert done.stderr.count("\n") == 1
    return done.error


def panels(path, count):
    """Return the panels of a picture of what was felt as ink, from the top."""
    with Image.open(path) as sheet:
        ink = 255.0 - np.asarray(sheet.convert("L"), float)
    # 28 pixels of words above each, and 24 of margin below and above.
    step = (len(ink) - 24) // count
    tops = range(52, len(ink) - 24, step)
    return [ink[top : top + step - 52, 24:-24] for top in tops]


@pytest.fixture(autouse=True)
def own_runs(tmp_path, monkeypatch):
    """Let `smarttouch stop` find the runs of this test, and of no other."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))


@pytest.fixture
def program(tmp_path):
    """Return a runner of the program in an empty folder; a fork of it, if it is not to be real."""

    def run(*arguments, given="", real=False, timeout=100):
        with (subprocess.Popen if real else Forked)(
            [PROGRAM, *map(str, arguments)],
            cwd=tmp_path,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        ) as process:
            try:
                told = process.communicate(given, timeout)
            finally:
                process.kill()
        return subprocess.CompletedProcess(process.args, process.returncode, *told)

    return run


@pytest.fixture
def program_here(tmp_path, monkeypatch):
    """Return a runner of the program in this process, which is much sooner: see `Done`.

    Its first argument may be several, as a shell splits them.
    """
    tell = cli._outcome

    def run(*arguments):
        out, err, code = io.StringIO(), io.StringIO(), 0
        errors = [None]
        arguments = [*shlex.split(arguments[0]), *map(str, arguments[1:])]
        with monkeypatch.context() as patch:
            patch.chdir(tmp_path)
            patch.setattr(cli, "_outcome", lambda error: errors.append(error) or tell(error))
            patch.setattr(sys, "argv", ["smarttouch", *arguments])
            patch.setattr(sys, "stdin", io.StringIO())
            with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
                try:
                    cli.main()
                except SystemExit as ended:
                    code = ended.code or 0
        words = " ".join(arguments).replace("--json=", "--json ").split()
        path = tmp_path / words[words.index("--json") + 1] if "--json" in words else None
        return Done(
            returncode=code, stdout=out.getvalue(), stderr=err.getvalue(), error=errors[-1],
            json_path=path,
        )  # fmt: skip

    return run


@pytest.fixture
def figures_of(program_here):
    """Return a runner of a command that gives its figures."""
    return lambda words: program_here(f"{words} --json f.json").fine().figures


@pytest.fixture
def start_program(tmp_path):
    """Return a starter of the program: of a fork, if it is not to be a real start."""
    streams = dict.fromkeys(("stdout", "stderr"), subprocess.PIPE)
    with starter() as start:
        yield lambda *arguments, real=False: start(
            [PROGRAM, *map(str, arguments)], subprocess.Popen if real else Forked, cwd=tmp_path,
            env={**os.environ, "PYTHONUNBUFFERED": "1"}, **streams,
        )  # fmt: skip


@pytest.fixture
def start_at_a_terminal(tmp_path):
    """Return a starter of a run with a keyboard: its process, once it takes keys, and they."""
    running = []

    def start(*arguments):
        keys, terminal = pty.openpty()
        process = Forked(
            [PROGRAM, *map(str, arguments)], cwd=tmp_path, stdin=terminal, stdout=subprocess.PIPE,
            stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        os.close(terminal)
        running.append((process, keys))
        while process.poll() is None and termios.tcgetattr(keys)[3] & termios.ICANON:
            time.sleep(0.02)
        return process, keys

    yield start
    for process, keys in running:
        process.kill()
        process.communicate()
        with contextlib.suppress(OSError):
            os.close(keys)


@pytest.fixture
def start_emulator(tmp_path):
    """Return a starter of board emulators: their process, port and books."""
    with starter() as start:

        def start_one(electrodes=64, protocol="link", *more):
            books = tempfile.mkdtemp(prefix="books", dir=tmp_path)
            if not any(option.startswith("linger=") for option in more):
                more = ("linger=30", *more)
            options = (f"electrodes={electrodes}", f"books={books}", *more)
            process = start(emulator(protocol, *options))
            return process, process.stdout.readline().strip(), Path(books)

        yield start_one
