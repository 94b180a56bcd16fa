"""A real BRLTTY with a program that writes to it through BrlAPI."""

import contextlib
import json
import re
import shutil
import socket
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

_PYTHON = "/usr/bin/python3"
_TABLE = Path("/etc/brltty/Text/en-nabcc.ttb")
_WRITER = """
import json, sys, time, brlapi
api = brlapi.Connection(host=sys.argv[1].encode())
# BrlAPI answers before the display has been found.
while not (width := api.displaySize[0]):
    time.sleep(0.02)
api.enterTtyModeWithPath([1])
print(json.dumps(width), flush=True)
for line in sys.stdin:
    asked, value, *cursor = json.loads(line)
    if asked == "write":
        told = brlapi.WriteStruct()
        told.regionBegin, told.regionSize = 1, width
        told.text, told.cursor = value.ljust(width), cursor[0] if cursor else 0
        api.write(told)
        print("true", flush=True)
    else:
        key = api.readKeyWithTimeout(value)
        print(json.dumps(key if key is None else api.expandKeyCode(key)), flush=True)
"""


def require_brltty():
    """Skip where BRLTTY or its Python binding is not installed."""
    if shutil.which("brltty") is None or not _TABLE.exists():
        pytest.skip("brltty is not installed")
    found = subprocess.run([_PYTHON, "-c", "import brlapi"], capture_output=True, check=False)
    if found.returncode:
        pytest.skip("python3-brlapi is not installed")


def free_port():
    """Return a free TCP port of this machine."""
    with socket.create_server(("127.0.0.1", 0)) as one:
        return one.getsockname()[1]


def cells_of(text):
    """Return the cells of a text by BRLTTY's own table, U+2800 and up."""
    return "".join(_nabcc()[each] for each in text)


def _nabcc():
    found = re.findall(r"^char \\X([0-9A-F]{2}) \(([ 1-8]*)\)", _TABLE.read_text(), re.MULTILINE)
    return {
        chr(int(code, 16)): chr(0x2800 + sum(1 << (int(dot) - 1) for dot in dots if dot != " "))
        for code, dots in found
    }


class Brltty:
    """BRLTTY, restarted as often as needed: ``device`` is as behind its option ``-d``.

    Of its settings, a file such as ``/etc/brltty.conf``, only the device, the screen and BrlAPI's
    host are replaced.
    """

    def __init__(self, device: str, folder: Path, settings: str) -> None:
        # BrlAPI's host ":4" is port 4101 + 4.
        self.host = f":{free_port() - 4101}"
        path = folder / "brltty.conf"
        path.write_text(
            f"{re.sub('(?m)^(braille-device|screen-driver|api-parameters) .*', '', settings)}\n"
            f"braille-device {device}\nscreen-driver no\n"
            f"api-parameters auth=none,host={self.host}\n"
        )
        self._options = ["-f", str(path), "-P", str(folder / "brltty.pid")]
        self.process: subprocess.Popen | None = None

    def start(self) -> None:
        """Start it, without the greeting, which a writing program can crash (BRLTTY 6.5)."""
        command = ["brltty", "-q", "-n", "-E", "-e", "-t", "en-nabcc", *self._options]
        self.process = subprocess.Popen(command, stderr=subprocess.DEVNULL)

    def kill(self) -> None:
        """End it without a chance to say so."""
        if self.process is not None:
            self.process.kill()
            self.process.wait()

    @contextlib.contextmanager
    def writer(self) -> Iterator["Writer"]:
        """Connect a program through BrlAPI, as soon as it answers."""
        for _ in range(600):
            program = subprocess.Popen(
                [_PYTHON, "-c", _WRITER, self.host], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL, text=True,
            )  # fmt: skip
            with program:
                if program.stdout.readline():
                    yield Writer(program)
                    program.kill()
                    return
        raise RuntimeError("BrlAPI does not answer")


class Writer:
    """A program at BrlAPI."""

    def __init__(self, program: subprocess.Popen) -> None:
        self._program = program

    def write(self, text: str, cursor: int = 0) -> None:
        """Put a text on the display, with a cursor under a cell counted from 1."""
        self._ask(["write", text, cursor])

    def key(self, timeout_ms: int = 60_000) -> dict:
        """Return the next key."""
        return self._ask(["key", timeout_ms])

    def _ask(self, what):
        self._program.stdin.write(json.dumps(what) + "\n")
        self._program.stdin.flush()
        return json.loads(self._program.stdout.readline())
