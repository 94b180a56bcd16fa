"""Starts the emulator and speaks to it as to any board on a serial line."""

import subprocess
import sys
from pathlib import Path
from typing import Any

from smarttouch.boards.link import LinkBoard
from smarttouch.errors import BoardError
from smarttouch.scan.safety import SafetyLimits

_ENDS_WITHIN_S = 3.0


def open_emulator(
    rest: str,
    limits: SafetyLimits,
    *,
    output: str = "weighted",
    books: Path | None = None,
    **_: Any,
) -> "EmulatorBoard":
    """Make the driver for ``emulator:``."""
    if rest:
        raise BoardError(f"emulator: takes nothing after the colon, not {rest!r}")
    return EmulatorBoard(limits, output, books)


class EmulatorBoard(LinkBoard):
    """A board in a process of its own, as long as it is open.

    Parameters
    ----------
    limits : SafetyLimits
        Of the finger's profile.
    output : str
        What the emulated board can do.
    books : Path, optional
        Existing folder in which it keeps its books.
    """

    def __init__(self, limits: SafetyLimits, output: str, books: Path | None = None) -> None:
        super().__init__("", limits, output)
        self._command = [
            sys.executable,
            "-m",
            "smarttouch.boards.emulator",
            f"--electrodes={limits.electrodes}",
            f"--output={output}",
            "--linger=0.2",
        ]
        if books is not None:
            self._command.append(f"--books={books}")

    @property
    def process_id(self) -> int:
        return self._process.pid

    def _open(self) -> None:
        # A session of its own: the terminal's Ctrl-C must not reach the board.
        self._process = subprocess.Popen(
            self._command, stdout=subprocess.PIPE, text=True, start_new_session=True
        )
        assert self._process.stdout is not None
        with self._process.stdout as output:
            self._port_name = output.readline().strip()
        if not self._port_name:
            raise BoardError(f"the emulator did not start (exit {self._process.wait()})")
        try:
            super()._open()
        except BaseException:
            self._end()
            raise

    def _close(self) -> None:
        super()._close()
        self._end()

    def _end(self) -> None:
        try:
            self._process.wait(_ENDS_WITHIN_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
