"""Board that keeps sequences in memory: for offline runs and for programs that inspect them."""

from typing import Any

from smarttouch.boards.board import Board
from smarttouch.errors import BoardError
from smarttouch.profile.device import Output
from smarttouch.registry import refuse_rest
from smarttouch.stimulation.safety import SafetyLimits
from smarttouch.stimulation.sequence import ScanSequence


class MemoryBoard(Board):
    """Board without process, line or current, which keeps all ``sequences`` since it was opened:
    ``memory:``."""

    on_a_finger = False

    def __init__(
        self, rest: str, limits: SafetyLimits, output: Output | None = None, **_: Any
    ) -> None:
        super().__init__(
            limits,
            output,
            max_current_ma=limits.current_ma,
            max_slots=0xFFFF,
            time_to_zero_ms=0.0,
            firmware="memory",
            recharges=output is None or output.kind == "weighted",
        )
        refuse_rest("memory:", rest, BoardError)
        self.sequences: list[ScanSequence] = []

    def _time(self) -> None:
        """Return None: time is what sequences state, as no finger is on this board."""

    def _open(self) -> None:
        self.sequences.clear()

    def _send(self, sequence: ScanSequence, times: int) -> int:
        self.sequences.append(sequence)
        self.acknowledged += 1
        return len(self.sequences)

    def _stop(self) -> None: ...
