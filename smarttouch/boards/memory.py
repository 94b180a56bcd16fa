"""Board that keeps sequences in memory: for offline runs and for programs that inspect them."""

from typing import Any

from smarttouch.boards.board import Board, BoardReport, Capabilities
from smarttouch.boards.host_statistics import HostStatistics
from smarttouch.errors import BoardError
from smarttouch.profile.device import Output
from smarttouch.registry import refuse_rest
from smarttouch.stimulation.safety import SafetyLimits
from smarttouch.stimulation.sequence import ScanSequence


class MemoryBoard(Board):
    """Board without process, line or current: ``memory:``.

    Attributes
    ----------
    sequences : list of ScanSequence
        All sequences since it was opened.
    """

    on_a_finger = False

    def __init__(
        self, rest: str, limits: SafetyLimits, output: Output | None = None, **_: Any
    ) -> None:
        super().__init__(limits, output)
        refuse_rest("memory:", rest, BoardError)
        self.sequences: list[ScanSequence] = []
        kind = "weighted" if output is None else output.kind
        self.capabilities = Capabilities(
            electrodes=limits.electrodes,
            output=kind,
            max_current_ma=limits.current_ma,
            max_slots=0xFFFF,
            time_to_zero_ms=0.0,
            firmware="memory",
            recharges=kind == "weighted",
        )

    def _time(self) -> None:
        """Return the clock of the sequences, as no finger is on this board."""

    def _open(self) -> None:
        self.sequences.clear()
        self._books = HostStatistics(self.capabilities.electrodes)

    def _send(self, sequence: ScanSequence, times: int) -> int:
        self.sequences.append(sequence)
        self._books.add(sequence, times)
        self.acknowledged += 1
        return len(self.sequences)

    def report(self) -> BoardReport:
        return self._books.report()

    def _stop(self) -> None: ...
