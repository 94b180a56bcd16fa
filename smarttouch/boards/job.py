"""Sequence on its way to a board without acknowledgments."""

from dataclasses import dataclass

from smarttouch.stimulation.sequence import ScanSequence


@dataclass(frozen=True, eq=False)
class Job:
    """Sequence on its way to the board."""

    number: int
    sequence: ScanSequence
    data: bytes
    times: int
    due_ns: int = 0  # planned start, by the board's clock
