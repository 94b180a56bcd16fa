"""Driver that starts the emulator and connects to it as to any board on a serial line."""

import os
import select
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from smarttouch.boards.emulator import second
from smarttouch.boards.link import LinkBoard
from smarttouch.errors import BoardError, LineLostError
from smarttouch.profile.device import Output
from smarttouch.registry import refuse_rest
from smarttouch.stimulation.safety import SafetyLimits

_STARTS_WITHIN_S = 30.0  # time limit of the start, long enough for a busy computer
_ENDS_WITHIN_S = 3.0
_SPEAKS_WITHIN_S = 5.0  # longest silence: it may wait for a processor


class EmulatorBoard(LinkBoard):
    """Board emulated by a process of its own, which runs as long as it is open: ``emulator:``.
    ``books`` is an existing folder for its delivery log, and ``events`` of the finger are as
    ``smarttouch board emulate`` takes them."""

    on_a_finger = False
    device = None

    def __init__(
        self,
        rest: str,
        limits: SafetyLimits,
        output: Output | None = None,
        books: Path | None = None,
        events: Sequence[str] = (),
    ) -> None:
        super().__init__("", limits, output)
        refuse_rest("emulator:", rest, BoardError)
        self._line.answer_s = self._line.silence_s = _SPEAKS_WITHIN_S
        kind = "weighted" if output is None else output.kind
        options = f"--electrodes={limits.electrodes} --output={kind} --linger=0.2 --port-only"
        options += f" --ramp-ms={second.RAMP_MS}"
        self._command = [sys.executable, "-m", "smarttouch.emulator", "board", "link"]
        self._command += options.split()
        self._command += [f"--event={event}" for event in events]
        if books is not None:
            self.keep_books(books)

    def keep_books(self, folder: Path) -> None:
        """Set the existing folder of its delivery log, from the next opening on."""
        self._command.append(f"--books={folder}")

    @property
    def process_id(self) -> int:
        return self._process.pid

    def _recover(self, lost: LineLostError) -> None:
        if self._process.poll() is not None:
            raise lost
        super()._recover(lost)

    def _open(self) -> None:
        # A session of its own: the terminal's Ctrl-C must not reach the board.
        self._process = subprocess.Popen(
            self._command, stdout=subprocess.PIPE, start_new_session=True
        )
        try:
            self._line.name = self._port_of_process()
            super()._open()
        except BaseException:
            # No host will come.
            self._process.terminate()
            self._end()
            raise

    def _port_of_process(self) -> str:
        """Return the name of the process's port, as soon as it is printed."""
        assert self._process.stdout is not None
        deadline, said = time.monotonic() + _STARTS_WITHIN_S, b""
        with self._process.stdout as output:
            while not said.endswith(b"\n"):
                if time.monotonic() > deadline:
                    raise BoardError(
                        f"the emulator has not started within {_STARTS_WITHIN_S:g} s: this "
                        "computer is too busy, try again",
                        about="emulator",
                    )
                if not select.select([output], [], [], 0)[0]:
                    self._pause(0.01)
                    continue
                if not (piece := os.read(output.fileno(), 256)):
                    message = f"the emulator did not start (exit {self._process.wait()})"
                    raise BoardError(message, about="emulator")
                said += piece
        return said.decode().strip()

    def _close(self) -> None:
        super()._close()
        self._end()

    def _end(self) -> None:
        if self._halted:
            # Its own time limit would take longer.
            self._process.terminate()
        try:
            self._process.wait(_ENDS_WITHIN_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
