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
# BrlAPI accepts connections before BRLTTY has found the display.
while not (width := api.displaySize[0]):
    time.sleep(0.02)
api.enterTtyModeWithPath([1])
print(json.dumps(width), flush=True)
for line in sys.stdin:
    command, value, *cursor = json.loads(line)
    if command == "write":
        content = brlapi.WriteStruct()
        content.regionBegin, content.regionSize = 1, width
        content.text, content.cursor = value.ljust(width), cursor[0] if cursor else 0
        api.write(content)
        print("true", flush=True)
    else:
        key = api.readKeyWithTimeout(value)
        print(json.dumps(key if key is None else api.expandKeyCode(key)), flush=True)
"""


def require_brltty():
    """Skip the test if BRLTTY or its Python binding is not installed."""
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
    """Translate a text to Braille characters, U+2800 and up, by BRLTTY's own table."""
    return "".join(_nabcc()[each] for each in text)


def _nabcc():
    found = re.findall(r"^char \\X([0-9A-F]{2}) \(([ 1-8]*)\)", _TABLE.read_text(), re.MULTILINE)
    return {
        chr(int(code, 16)): chr(0x2800 + sum(1 << (int(dot) - 1) for dot in dots if dot != " "))
        for code, dots in found
    }


class Brltty:
    """BRLTTY process, which can be started again after `kill`.

    ``device`` is a value of BRLTTY's option ``-d``. ``settings`` is the text of a file such as
    ``/etc/brltty.conf``, in which device, screen driver and BrlAPI's host are replaced.
    """

    def __init__(self, device: str, folder: Path, settings: str) -> None:
        # BrlAPI counts ports from 4101: the host ":4" is TCP port 4105.
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
        """Start BRLTTY without a greeting: BRLTTY 6.5 can crash if a program writes during it."""
        command = ["brltty", "-q", "-n", "-E", "-e", "-t", "en-nabcc", *self._options]
        self.process = subprocess.Popen(command, stderr=subprocess.DEVNULL)

    def kill(self) -> None:
        """Kill BRLTTY, without an orderly shutdown."""
        if self.process is not None:
            self.process.kill()
            self.process.wait()

    @contextlib.contextmanager
    def writer(self) -> Iterator["Writer"]:
        """Yield a program connected through BrlAPI; retries until BrlAPI answers."""
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
        raise RuntimeError(f"BrlAPI does not answer at {self.host}")


class Writer:
    """Program that writes to BRLTTY and receives keys from it, through BrlAPI."""

    def __init__(self, program: subprocess.Popen) -> None:
        self._program = program

    def write(self, text: str, cursor: int = 0) -> None:
        """Write a text to the display; ``cursor`` is a cell counted from 1, or 0 for none."""
        self._ask(["write", text, cursor])

    def key(self, timeout_ms: int = 60_000) -> dict:
        """Wait for the next key and return its code, expanded by BrlAPI."""
        return self._ask(["key", timeout_ms])

    def _ask(self, what):
        self._program.stdin.write(json.dumps(what) + "\n")
        self._program.stdin.flush()
        return json.loads(self._program.stdout.readline())
