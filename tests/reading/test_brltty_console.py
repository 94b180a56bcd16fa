"""A console program's output under the fingertip: BRLTTY reads a terminal of tmux."""

import ctypes
import shutil
import subprocess
import threading
import time

import pytest

from smarttouch.imaging.array_window import profile_for_reading
from smarttouch.profile import load_profile
from smarttouch.reading.brltty_connection import Address, BrlttyConnection
from smarttouch.reading.brltty_source import BrailleDisplaySource

from .real_brltty import Brltty, cells_of, free_port, require_brltty, wait_until

COLUMNS, ROWS, WIDTH = 40, 6, 10
KEY, SIZE = 0xBACD072F - (1 << 32), 4 + 2 * 66 * 132
"""Of the shared memory in which BRLTTY's driver "sc" looks for a screen."""
NEW, OURS_ALONE = 0o3000, 0o700


class Console:
    """A terminal whose screen is copied to where BRLTTY finds it."""

    def __init__(self, name: str) -> None:
        self._name, self._over = name, threading.Event()
        self._libc = ctypes.CDLL(None)
        self._libc.shmat.restype = ctypes.c_void_p
        self._memory = self._libc.shmget(KEY, SIZE, NEW | OURS_ALONE)
        if self._memory < 0:
            pytest.skip("another screen is being read")
        place = self._libc.shmat(self._memory, None, 0)
        self._screen = (ctypes.c_ubyte * SIZE).from_address(place)
        self.tmux("new-session", "-d", "-x", COLUMNS, "-y", ROWS, "PS1='$ ' sh")
        self.tmux("set", "-g", "status", "off")
        self._thread = threading.Thread(target=self._copy, daemon=True)
        self._thread.start()

    def tmux(self, *arguments: object) -> str:
        command = ["tmux", "-L", self._name, "-f", "/dev/null", *map(str, arguments)]
        return subprocess.run(command, capture_output=True, text=True, check=False).stdout

    def _copy(self) -> None:
        while not self._over.wait(0.1):
            lines = (self.tmux("capture-pane", "-p").split("\n") + [""] * ROWS)[:ROWS]
            where = self.tmux("display-message", "-p", "#{cursor_x} #{cursor_y}").split()
            text = "".join(line.ljust(COLUMNS)[:COLUMNS] for line in lines).encode(
                "latin-1", "replace"
            )
            shown = bytes([COLUMNS, ROWS, *map(int, where or (0, 0))]) + text + b"\x07" * len(text)
            self._screen[: len(shown)] = list(shown)

    def wait_for(self, beginning: str) -> None:
        """Wait until the screen begins with a text."""
        for _ in range(300):
            if bytes(self._screen[4:]).startswith(beginning.encode()):
                return
            time.sleep(0.1)
        raise AssertionError(bytes(self._screen[4:]))

    def close(self) -> None:
        self._over.set()
        self._thread.join()
        self.tmux("kill-server")
        self._libc.shmctl(self._memory, 0, None)


def test_what_a_program_prints_is_read_by_panning(tmp_path):
    require_brltty()
    if shutil.which("tmux") is None:
        pytest.skip("tmux is not installed")
    address = Address("127.0.0.1", free_port(), True)
    console = Console(tmp_path.name)
    connection = BrlttyConnection(address, WIDTH).open()
    real = Brltty(f"client:{address}", tmp_path, "sc")
    source = BrailleDisplaySource(connection, profile_for_reading(load_profile("electric-mouse")))
    try:
        console.wait_for("$ ")
        console.tmux("send-keys", "clear; echo a line that is longer", "Enter")
        console.wait_for("a line that is longer".ljust(COLUMNS) + "$ ")
        real.start()

        def shows(text, cells):
            shown = connection.shown
            return shown is not None and (shown.text.rstrip(), shown.cells.rstrip("\u2800")) == (
                text,
                cells,
            )

        # The cursor is dots 7 and 8.
        prompt = "$", cells_of("$") + "\u2800⣀"
        wanted = [("", prompt)]
        for key, text in (("p", "a line tha"), ("right", "t is longe"), ("right", "r")):
            wanted.append((key, (text, cells_of(text))))
        for key, (text, cells) in [*wanted, ("h", prompt)]:
            if key:
                source.keys[key]()
            there = wait_until(lambda text=text, cells=cells: shows(text, cells), 30)
            assert there, connection.shown
    finally:
        real.kill()
        source.close()
        console.close()
