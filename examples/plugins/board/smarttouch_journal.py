"""Board that writes each pulse to a text file: ``journal:run.txt``."""

from pathlib import Path
from typing import IO

import smarttouch as st
from smarttouch.plugins import Capabilities, Line, Output, ProvedSequence


class JournalDriver(st.Driver):
    """Driver that writes a line for each slot, and a line ``zero`` when electrodes are set to zero.

    Parameters
    ----------
    rest : str
        Name of the file, which is overwritten each time the board is opened.
    limits : SafetyLimits
        Limits from the profile of the finger.
    output : Output, optional
        Table ``output`` of the profile.
    """

    def __init__(self, rest: str, limits: st.SafetyLimits, output: Output | None = None) -> None:
        if not rest:
            raise st.BoardError("journal: has no file: write for example journal:run.txt")
        self._path = Path(rest)
        self._kind = "weighted" if output is None else output.kind
        self._file: IO[str] | None = None

    def open(self, line: Line, limits: st.SafetyLimits) -> Capabilities:
        self._line = line
        try:
            self._file = self._path.open("w", encoding="utf-8")
        except OSError as error:
            raise st.BoardError(
                f"cannot write {self._path} ({error.strerror}): give another file"
            ) from None
        self.zero()
        return Capabilities(
            limits.electrodes, self._kind, max_current_ma=limits.current_ma, max_slots=0xFFFF,
            time_to_zero_ms=0.0, firmware="journal 1.0",
        )  # fmt: skip

    def write(self, proved: ProvedSequence) -> None:
        sequence = proved.sequence
        lines = [f"scan: {proved.times} x {sequence.period_us} us"]
        for width_us, discharge_us, current_ua in zip(
            sequence.width_us, sequence.discharge_us, sequence.current_ua, strict=True
        ):
            flows = ", ".join(f"{each:+d}" for each in current_ua)
            lines.append(f"  {width_us} us, then {discharge_us} us shorted: {flows} uA")
        # `Board.stop` waits for the end of this block. After a stop, `current` raises an error.
        with self._line.current(proved):
            print(*lines, sep="\n", file=self._file, flush=True)

    def zero(self) -> None:
        with self._line.current():
            print("zero", file=self._file, flush=True)

    def close(self) -> None:
        if self._file is not None:
            self._file.close()
            self._file = None
