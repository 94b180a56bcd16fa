"""Timing of a trial: its pauses, and the time limits for an answer and for the current."""

from dataclasses import dataclass

from smarttouch.errors import ExperimentError


@dataclass(frozen=True)
class TrialTiming:
    """Timing of a trial."""

    gap_s: float = 0.5  # between two intervals
    answer_s: float | None = 10.0  # time limit for an answer; no limit if None
    again: bool = True  # whether a participant may feel a trial once more
    # time limit for the current to reach its level before a trial; no limit if None
    patience_s: float | None = None
    # times that a trial is presented again because its current was lost; no limit if None
    most_spoiled: int | None = None

    def __post_init__(self) -> None:
        if not 0 <= self.gap_s <= 60:
            raise ExperimentError(
                f"a gap of {self.gap_s:g} s must be from 0 to 60 s", about="gap_s"
            )
        if self.answer_s is not None and not 0 < self.answer_s <= 3600:
            raise ExperimentError(
                f"{self.answer_s:g} s for an answer must be above 0, at most 3600 s",
                about="answer_s",
            )
