"""Thresholds of the electrodes of one board on one finger: the whole procedure and its result."""

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass

import numpy as np

from smarttouch.base.errors import CalibrationError
from smarttouch.base.events import Advice, BoardRestarted, Event, FingerLifted
from smarttouch.base.stopping import StopRequest
from smarttouch.experiments.calibration.profile_file import ProfileFile
from smarttouch.experiments.calibration.threshold_procedures import (
    REACTION_S,
    Thresholds,
    measuring_profile,
)
from smarttouch.experiments.calibration.threshold_session import (
    Progress,
    ThresholdSession,
    simulated_finger,
)
from smarttouch.experiments.psychophysics.experiment_source import ExperimentSource
from smarttouch.experiments.psychophysics.simulated_subject import Subject
from smarttouch.experiments.psychophysics.trials import Trial, TrialTiming
from smarttouch.kernels.bank import single_bank
from smarttouch.profile import Profile
from smarttouch.running.config import RunConfig
from smarttouch.running.display import Display
from smarttouch.running.runner import Runner
from smarttouch.running.step import Listener, RunContext, StepResult

Found = Mapping[int, Thresholds]
Keys = Callable[[Callable[[str], None]], AbstractContextManager[None]]
"""Hands every key to a function while a block runs; an empty one is a terminal that is gone."""


def filled(profile: Profile, found: Found) -> tuple[list[float], list[float]]:
    """Return thresholds and comfortable maxima of all electrodes, mA.

    Electrodes not measured, not felt, or without room between the two keep their values.
    """
    usable = {site: each for site, each in found.items() if each.usable}
    if not usable:
        raise CalibrationError(
            "no electrode was felt and then strong enough: check contact with "
            "'smarttouch calibrate contact', and explain the task"
        )
    threshold, comfort = profile.threshold_ma.astype(float), profile.full_ma.astype(float)
    for site, each in usable.items():
        threshold[site], comfort[site] = each.threshold_ma, each.comfort_ma
    # Down, so that no rounding takes comfort above a limit; what was single precision, to it.
    return (
        [round(float(each), 3) for each in threshold],
        [math.floor(1000 * float(each) + 1e-3) / 1000 for each in comfort],
    )


def sentence(found: Found) -> str:
    """Return the sentence for the profile."""
    usable = [each for each in found.values() if each.usable]
    threshold = np.array([each.threshold_ma for each in usable])
    comfort = np.array([each.comfort_ma for each in usable])
    spread = float(np.median([each.spread for each in usable]))
    kept = sorted(site for site, each in found.items() if not each.usable)
    return (
        f"{len(usable)} electrodes by rising current, threshold {np.median(threshold):.2f} mA "
        f"({threshold.min():.2f} to {threshold.max():.2f}), comfortable up to "
        f"{np.median(comfort):.2f} mA ({comfort.min():.2f} to {comfort.max():.2f}), spread of a "
        f"threshold {spread:.1%}, {sum(each.runs for each in found.values())} runs, "
        f"{sum(each.false_presses for each in found.values())} false presses"
        + (f"; not usable, kept as they were: {kept}" if kept else "")
    )


STOP_KEYS = ("q", "Q", "\x1b", "\x03", "\x04", "")
"""Keys that end it at once; the empty one is a terminal that is gone."""
_PATIENCE_S = 10.0
_MOST_SPOILED = 10
"""Times that current may be lost at one electrode, by the board or a lifted finger."""
_LOOK_S = 0.5  # between two decisions of the simulated subject


@dataclass(frozen=True, kw_only=True)
class ThresholdProcedure:
    """Measurement of thresholds: its board, its electrodes and its method."""

    start: str  # profile that the file began as
    file: ProfileFile  # where it goes
    board_url: str
    sites: Sequence[int]
    # repeats, seed: see `ThresholdSession`
    repeats: int = 3
    seed: int = 0
    # a simulated subject answers, on the board ``simulated:``, without waiting
    simulate: bool = False

    def progress(self) -> Progress:
        """Return the results of an earlier session with the same settings."""
        profile = self.file.profile
        return Progress(
            self.file.beside("thresholds.jsonl"),
            {
                "profile": self.start, "electrodes": len(profile.electrodes),
                "board": self.board_url.partition(":")[0],
                "pulse_us": profile.pulse.width_us,
                "repeats": self.repeats, "simulate": self.simulate,
            },
        )  # fmt: skip

    def measure(
        self,
        progress: Progress,  # keeps each once it is done
        keys: Keys,
        say: Callable[[str], None],  # shows a line
        stop: StopRequest,
        force: str | None = None,  # URL of the finger's force; see `Runner`
    ) -> None:
        """Measure electrode after electrode."""
        profile, measuring = self.file.profile, measuring_profile(self.file.profile)
        # A simulated subject feels simulated currents, and does not wait.
        display = Display("simulated:" if self.simulate else self.board_url, measuring)
        session = ThresholdSession(
            profile, display.board, self.sites, progress,
            repeats=self.repeats, seed=self.seed,
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
        )
        listener: Listener = Prompts(
            source,
            say,
            f"Current rises to {measuring.full_ma.max():.2f} mA at most. Press a key when you feel "
            "it, and again when it is strong enough",
        )
        if self.simulate:
            tops_ma = [float(each) for each in measuring.full_ma]
            finger = simulated_finger(profile, measuring, tops_ma, self.seed)
            listener = Subject(source, finger, _LOOK_S, REACTION_S)
        config = RunConfig(scan="points", intensity=1.0, seed=self.seed)
        present(source, display, config, listener, keys, stop, force)
        if not session.over:
            raise self.stopped(progress)

    def stopped(self, progress: Progress) -> CalibrationError:
        """Return the error of a procedure that was stopped."""
        left = len(set(self.sites) - set(progress.found))
        return CalibrationError(
            f"stopped, all electrodes are off: {left} of {len(self.sites)} electrodes are left, "
            "the same command goes on there"
        )

    def put_down(self, progress: Progress) -> str:
        """Set the results in the profile's file, not written yet; return them in a sentence."""
        threshold_ma, comfort_ma = filled(self.file.profile, progress.found)
        self.file.set("perception.threshold_ma", threshold_ma)
        self.file.set("perception.comfort_ma", comfort_ma)
        return sentence(progress.found)


def present(
    source: ExperimentSource,
    display: Display,
    config: RunConfig,
    listener: Listener,
    keys: Keys,
    stop: StopRequest,
    force: str | None = None,  # URL of the finger's force; see `Runner`
) -> None:
    """Present the trials of a calibration, whose currents are what it asks for; keys answer, and
    some end it at once."""

    def on_key(key: str) -> None:
        if key in STOP_KEYS:
            stop.ask(f"key {key!r}")
        else:
            source.press(key)

    with keys(on_key):
        Runner(
            source,
            display,
            config,
            force=force,
            listeners=[listener],
            stop=stop,
            load_kernels=single_bank,
        ).run()


class Prompts(Listener):
    """Shows a person each question once, and what the board's user should know."""

    def __init__(self, source: ExperimentSource, say: Callable[[str], None], task: str) -> None:
        super().__init__()
        self._source, self._say, self._task = source, say, task
        self._shown: Trial | None = None
        self._presses, self._full_n = True, 0.0

    def start(self, run: RunContext) -> None:
        self._full_n = run.profile.force.full_n
        self._say(f"{self._task}; q or Esc stops at once.")

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
