"""Fixtures that run the installed program as a user does."""

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

from ..boards.emulator_waits import starter
from ..support.checks import assert_says
from ..support.processes import PROGRAM, Forked, emulator

PRESSED = ("--force", "fixed:1")
"""Options for a board that drives a finger but does not measure its force."""


def says(kind=SmartTouchError, *names, **attributes):
    """Return a check that an error has exactly this type and these attributes.

    The message of the error must contain all ``names``, which can be numbers with units.
    """

    def check(error):
        assert type(error) is kind, repr(error)
        assert_says(error, **attributes)
        assert [name for name in names if name not in str(error)] == [], error

    return check


class Done(SimpleNamespace):
    """Result of running the program in this process: exit code, output and error."""

    def fine(self):
        """Check that the exit code is 0; return this `Done`."""
        assert self.returncode == 0, self.stderr
        return self

    def flawless(self):
        """Check that the exit code is 0 and that stderr is empty; return this `Done`."""
        assert self.fine().stderr == ""
        return self

    @property
    def figures(self):
        """Content of the file that option ``--json`` names."""
        return json.loads(self.json_path.read_text())


def refused(done):
    """Check that the program exited with 2 and one line on stderr; return the error."""
    assert done.returncode == 2, done.stdout
    assert done.stderr.startswith("smarttouch: ")
    assert done.stderr.count("\n") == 1
    return done.error


def panels(path, count):
    """Return the panels of a ``--felt`` picture from top to bottom, as darkness (black is 255)."""
    with Image.open(path) as sheet:
        ink = 255.0 - np.asarray(sheet.convert("L"), float)
    # Each panel has a title of 28 pixels above it. The picture has margins of 24 pixels.
    step = (len(ink) - 24) // count
    tops = range(52, len(ink) - 24, step)
    return [ink[top : top + step - 52, 24:-24] for top in tops]


@pytest.fixture(autouse=True)
def own_runs(tmp_path, monkeypatch):
    """Let `smarttouch stop` find only the runs of this test."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))


@pytest.fixture
def program(tmp_path):
    """Return a function that runs the program in an empty folder, by `Forked` unless ``real``."""

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
    """Return a function that runs the program in this process, which is faster; see `Done`.

    A first argument with several words is split as by a shell.
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
    """Return a function that runs a command and returns the content of its ``--json`` file."""
    return lambda words: program_here(f"{words} --json f.json").fine().figures


@pytest.fixture
def start_program(tmp_path):
    """Return a function that starts the program: by `Forked`, or as a new process if ``real``."""
    streams = dict.fromkeys(("stdout", "stderr"), subprocess.PIPE)
    with starter() as start:
        yield lambda *arguments, real=False: start(
            [PROGRAM, *map(str, arguments)], subprocess.Popen if real else Forked, cwd=tmp_path,
            env={**os.environ, "PYTHONUNBUFFERED": "1"}, **streams,
        )  # fmt: skip


@pytest.fixture
def start_at_a_terminal(tmp_path):
    """Return a function that starts the program at a terminal and returns process and keyboard."""
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
    """Return a function that starts an emulator and returns its process, port and log folder."""
    with starter() as start:

        def start_one(electrodes=64, protocol="link", *more):
            books = tempfile.mkdtemp(prefix="books", dir=tmp_path)
            if not any(option.startswith("linger=") for option in more):
                more = ("linger=30", *more)
            options = (f"electrodes={electrodes}", f"books={books}", *more)
            process = start(emulator(protocol, *options))
            return process, process.stdout.readline().strip(), Path(books)

        yield start_one
