"""Thresholds of the electrodes of one board on one finger: the whole procedure."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from smarttouch.boards.board import Board
from smarttouch.boards.open import make_board
from smarttouch.calibrate.found import filled, sentence
from smarttouch.calibrate.limits import Thresholds
from smarttouch.calibrate.profile_file import ProfileFile
from smarttouch.calibrate.progress import Progress
from smarttouch.calibrate.session import (
    Person,
    StoppedError,
    Subject,
    ThresholdSession,
    simulated_subjects,
)
from smarttouch.calibrate.stimulus import ceiling_ma, measuring_limits
from smarttouch.errors import BoardStoppedError, CalibrationError


@dataclass(frozen=True, kw_only=True)
class ThresholdProcedure:
    """Measurement of thresholds: its board, its electrodes and its method.

    Attributes
    ----------
    start : str
        Profile that the file began as.
    file : ProfileFile
        Where it goes.
    board_url : str
    sites : sequence of int
    adaptive, repeats, seed
        See `ThresholdSession`.
    simulate : bool
        A simulated subject answers, without waiting.
    """

    start: str
    file: ProfileFile
    board_url: str
    sites: Sequence[int]
    adaptive: bool = False
    repeats: int = 3
    seed: int = 0
    simulate: bool = False

    def make_board(self) -> Board:
        """Return the board, not opened yet, under the limits of measurements."""
        profile = self.file.profile
        # A simulated subject does not wait, and the emulator's clock would refuse to be hurried.
        hurried = self.simulate and self.board_url == "emulator:"
        url = "simulated:" if hurried else self.board_url
        return make_board(url, measuring_limits(profile), profile.output)

    def progress(self) -> Progress:
        """Return how far it came before, with the same settings."""
        profile = self.file.profile
        return Progress(
            self.file.beside("thresholds.json"),
            {
                "profile": self.start, "electrodes": len(profile.electrodes),
                "board": self.board_url.partition(":")[0],
                "pulse_us": profile.pulse.width_us, "adaptive": self.adaptive,
                "repeats": self.repeats, "simulate": self.simulate,
            },
        )  # fmt: skip

    def measure(
        self,
        board: Board,
        progress: Progress,
        next_key: Callable[[float], str | None],
        say: Callable[[str], None],
        must_stop: Callable[[], bool],
    ) -> None:
        """Measure electrode after electrode on an open board.

        Parameters
        ----------
        board : Board
        progress : Progress
            Keeps each as it is done.
        next_key, say, must_stop : callable
            See `Person`.
        """
        profile = self.file.profile
        tops = [ceiling_ma(profile, site, board) for site in range(len(profile.electrodes))]
        subject: Subject
        if self.simulate:
            subject = simulated_subjects(profile, tops, self.seed)
        else:
            subject = Person(next_key, say, must_stop)
            if board.capabilities.time_to_zero_ms is None:
                say("This board goes on if its line breaks: keep its switch in reach.")
            say(
                f"Current rises to {max(tops):.2f} mA at most. Press a key when you feel it, and "
                "again when it is strong enough; q or Esc stops at once."
            )
        session = ThresholdSession(
            board, profile, subject, self.adaptive, self.repeats, self.seed, self.simulate,
            must_stop,
        )  # fmt: skip
        session.run(self.sites, progress, lambda site, found: say(_describe(site, found)))

    def stopped(self, progress: Progress) -> CalibrationError:
        """Return the error that it was stopped."""
        left = len(set(self.sites) - set(progress.found))
        return CalibrationError(
            f"stopped, all electrodes are off: {left} of {len(self.sites)} electrodes are left, "
            "the same command goes on there",
            about="thresholds",
            problem="stopped",
            value=left,
        )

    def put_down(self, progress: Progress) -> str:
        """Set what was found in the profile's file, not written yet; return it in a sentence."""
        threshold_ma, comfort_ma = filled(self.file.profile, progress.found)
        self.file.set("perception.threshold_ma", threshold_ma)
        self.file.set("perception.comfort_ma", comfort_ma)
        return sentence(progress.found, adaptive=self.adaptive)


STOPPED = (StoppedError, BoardStoppedError)
"""Errors that `ThresholdProcedure.measure` raises when it is stopped."""


def _describe(site: int, found: Thresholds) -> str:
    said = f"threshold {found.threshold_ma:.2f} mA, comfortable to {found.comfort_ma:.2f} mA"
    said = said if found.felt else "not felt up to the ceiling"
    room = "" if found.usable or not found.felt else " (no room between them: not used)"
    return f"electrode {site}: {said}{room}"
