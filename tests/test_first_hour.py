"""The first hour of docs/tutorial, step by step, as a reader would go through it."""

import os
import re
import subprocess
import sys
from pathlib import Path

from .forks import PROGRAM, Forked

PAGE = Path(__file__).parent.parent / "docs" / "tutorial" / "first-hour.md"
PARTS = re.compile(r"Save this as `([\w.]+)`|^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
NOT_HERE = ("python3 -m venv", ". .venv", "pip install", "mkdir")
"""Steps that the environment of this test stands for."""


def run(line, folder):
    """Run a line of the page by the Python of this test; the program as a fork."""
    words = re.findall(r'"[^"]*"|\S+', line)
    program, *rest = (word.strip('"') for word in words)
    starts = {"python": [sys.executable], "smarttouch": [PROGRAM]}
    with Forked(
        [*starts.get(program, [sys.executable, "-m", program]), *rest],
        cwd=folder,
        env=os.environ | {"XDG_CACHE_HOME": str(folder / "cache"), "MPLBACKEND": "agg"},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        told = process.communicate(timeout=300)
    return subprocess.CompletedProcess(process.args, process.returncode, *told)


def test_every_step_works(tmp_path):
    name, done = "", []
    for named, language, text in PARTS.findall(PAGE.read_text("utf-8")):
        if named:
            name = named
        elif language == "python":
            (tmp_path / name).write_text(text, encoding="utf-8")
            if name == "touch.py":
                assert run("python touch.py", tmp_path).returncode == 0
        else:
            for line in text.splitlines():
                command = line.removeprefix("$ ")
                if not command.startswith(NOT_HERE):
                    ended = run(command, tmp_path)
                    assert ended.returncode == 0, (command, ended.stdout, ended.stderr)
                    done.append(command)
    assert len(done) >= 6
    assert (tmp_path / "felt.png").stat().st_size > 5_000
    assert (tmp_path / "hello.mcap").stat().st_size > 10_000
