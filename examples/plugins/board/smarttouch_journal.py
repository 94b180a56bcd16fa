"""A board that writes each pulse into a text file: ``journal:run.txt``."""

import threading
from pathlib import Path
from typing import IO

import smarttouch as st
from smarttouch.plugins import Output


class JournalBoard(st.Board):
    """Writes a line for each slot, and ``zero`` where all electrodes would be shorted.

    Parameters
    ----------
    rest : str
        The file, rewritten each time the board is opened.
    limits : SafetyLimits
        Of the finger's profile.
    output : Output, optional
        The board's table in the profile.
    """

    on_a_finger = False
    """A file makes no current. A board that does leaves this out."""

    def __init__(self, rest: str, limits: st.SafetyLimits, output: Output | None = None) -> None:
        super().__init__(
            limits,
            output,
            max_current_ma=limits.current_ma,
            max_slots=0xFFFF,
            time_to_zero_ms=0.0,
            firmware="journal 1.0",
            clock="host",
        )
        if not rest:
            raise st.BoardError("journal: needs a file, for example journal:run.txt")
        self._path = Path(rest)
        self._file: IO[str] | None = None
        self._lock = threading.Lock()
        self._number = 0

    def _open(self) -> None:
        try:
            self._file = self._path.open("w", encoding="utf-8")
        except OSError as error:
            raise st.BoardError(
                f"cannot write {self._path} ({error.strerror}): give another file"
            ) from None
        self._number = 0
        self._write("zero")

    def _send(self, sequence: st.ScanSequence, times: int) -> int:
        lines = [f"scan: {times} x {sequence.period_us} us"]
        for width_us, discharge_us, current_ua in zip(
            sequence.width_us, sequence.discharge_us, sequence.current_ua, strict=True
        ):
            flows = ", ".join(f"{each:+d}" for each in current_ua)
            lines.append(f"  {width_us} us, then {discharge_us} us shorted: {flows} uA")
        self._write(*lines)
        self.acknowledged += 1
        self._number += 1
        return self._number

    def _stop(self) -> None:
        self._write("zero")

    def _close(self) -> None:
        if self._file is not None:
            self._file.close()
            self._file = None

    def _write(self, *lines: str) -> None:
        with self._lock:
            # A stop may have come from another thread: then nothing but zero goes out.
            if lines != ("zero",):
                self._go_on_unless_stopped()
            if self._file is not None:
                print(*lines, sep="\n", file=self._file, flush=True)
