"""Thresholds of the electrodes of one board on one finger: the whole procedure."""

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import partial

from smarttouch.boards.board import Board
from smarttouch.calibrate.found import filled, sentence
from smarttouch.calibrate.limits import REACTION_S, Thresholds
from smarttouch.calibrate.profile_file import ProfileFile
from smarttouch.calibrate.progress import Progress
from smarttouch.calibrate.session import ThresholdSession, simulated_finger
from smarttouch.calibrate.stimulus import measuring_profile
from smarttouch.clock import MonotonicClock
from smarttouch.errors import CalibrationError
from smarttouch.events import Advice, BoardRestarted, Event, FingerLifted
from smarttouch.kernels.single import single_bank
from smarttouch.psychophysics.source import ExperimentSource
from smarttouch.psychophysics.subject import Subject
from smarttouch.psychophysics.timing import TrialTiming
from smarttouch.psychophysics.trial import Trial
from smarttouch.running.config import RunConfig
from smarttouch.running.display import Display
from smarttouch.running.listener import Listener, RunContext
from smarttouch.running.runner import Runner
from smarttouch.running.step import StepResult
from smarttouch.stopping import StopRequest

STOP_KEYS = ("q", "Q", "\x1b", "\x03", "\x04", "")
"""Keys that end it at once; the empty one is a terminal that is gone."""
_PATIENCE_S = 10.0
_MOST_SPOILED = 10
"""Times that current may be lost at one electrode, by the board or a lifted finger."""
_LOOK_S = 0.5
"""Between two decisions of the simulated subject."""


@dataclass(frozen=True, kw_only=True)
class ThresholdProcedure:
    """Measurement of thresholds: its board, its electrodes and its method."""

    start: str  # profile that the file began as
    file: ProfileFile  # where it goes
    board_url: str
    sites: Sequence[int]
    # adaptive, repeats, seed: see `ThresholdSession`
    adaptive: bool = False
    repeats: int = 3
    seed: int = 0
    # a simulated subject answers, on the board ``simulated:``, without waiting
    simulate: bool = False

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
        progress: Progress,  # keeps each as it is done
        # hands every key to a function while a block runs; an empty one is a terminal that is gone
        keys: Callable[[Callable[[str], None]], AbstractContextManager[None]],
        say: Callable[[str], None],  # shows a line
        stop: StopRequest,
        # opens a board for a block
        opened: Callable[[Board, StopRequest], AbstractContextManager[Board]],
        force: str | None = None,  # URL of the finger's force; see `Runner`
    ) -> None:
        """Measure electrode after electrode."""
        profile, measuring = self.file.profile, measuring_profile(self.file.profile)
        # A simulated subject feels simulated currents, and does not wait.
        display = Display("simulated:" if self.simulate else self.board_url, measuring)
        session = ThresholdSession(
            profile, display.board, self.sites, progress,
            adaptive=self.adaptive, repeats=self.repeats, seed=self.seed,
            show=lambda site, found: say(_describe(site, found)),
        )  # fmt: skip
        source = ExperimentSource(
            session,
            measuring,
            TrialTiming(
                answer_s=None,
                again=False,
                patience_s=_PATIENCE_S if self.simulate else None,
                most_spoiled=_MOST_SPOILED,
            ),
            measuring.force.full_n,
            None if self.simulate else MonotonicClock(),
        )
        listeners: list[Listener] = [_Prompts(source, say)]
        if self.simulate:
            tops_ma = [float(each) for each in measuring.full_ma]
            finger = simulated_finger(profile, measuring, tops_ma, self.seed)
            listeners = [Subject(source, finger, _LOOK_S, REACTION_S)]

        def on_key(key: str) -> None:
            if key in STOP_KEYS:
                stop.ask(f"key {key!r}")
            else:
                source.press(key)

        with keys(on_key):
            Runner(
                source,
                display,
                RunConfig(scan="points", seed=self.seed),
                force=force,
                listeners=listeners,
                # Current is what the procedure asks for.
                first_level=1.0,
                stop=stop,
                load_kernels=single_bank,
                opened=partial(opened, display.board),
            ).run()
        if not session.over:
            raise self.stopped(progress)

    def stopped(self, progress: Progress) -> CalibrationError:
        """Return the error that it was stopped."""
        left = len(set(self.sites) - set(progress.found))
        return CalibrationError(
            f"stopped, all electrodes are off: {left} of {len(self.sites)} electrodes are left, "
            "the same command goes on there",
            about="thresholds",
        )

    def put_down(self, progress: Progress) -> str:
        """Set what was found in the profile's file, not written yet; return it in a sentence."""
        threshold_ma, comfort_ma = filled(self.file.profile, progress.found)
        self.file.set("perception.threshold_ma", threshold_ma)
        self.file.set("perception.comfort_ma", comfort_ma)
        return sentence(progress.found, adaptive=self.adaptive)


class _Prompts(Listener):
    """Shows a person each question once, and what the board's user should know."""

    def __init__(self, source: ExperimentSource, say: Callable[[str], None]) -> None:
        super().__init__()
        self._source, self._say = source, say
        self._shown: Trial | None = None
        self._presses, self._full_n = True, 0.0

    def start(self, run: RunContext) -> None:
        self._full_n = run.profile.force.full_n
        self._say(
            f"Current rises to {run.profile.full_ma.max():.2f} mA at most. Press a key when you "
            "feel it, and again when it is strong enough; q or Esc stops at once."
        )

    def step(self, result: StepResult) -> None:
        trial = self._source.rising or self._source.asking
        if trial is not None and trial is not self._shown:
            self._say(trial.question)
        self._shown = trial
        presses = result.input.force_n >= self._full_n
        if self._presses and not presses:
            self._say("press the finger firmly on the electrodes")
        self._presses = presses

    def event(self, event: Event) -> None:
        if isinstance(event, Advice | BoardRestarted | FingerLifted):
            self._say(str(event))


def _describe(site: int, found: Thresholds) -> str:
    said = f"threshold {found.threshold_ma:.2f} mA, comfortable to {found.comfort_ma:.2f} mA"
    said = said if found.felt else "not felt up to the ceiling"
    room = "" if found.usable or not found.felt else " (no room between them: not used)"
    return f"electrode {site}: {said}{room}"
