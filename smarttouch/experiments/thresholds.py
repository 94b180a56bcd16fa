"""Detection threshold and comfort level of each electrode, measured by a rising current."""

import math
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass, fields
from pathlib import Path

import numpy as np

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import CalibrationError
from smarttouch.base.events import Advice, BoardRestarted, Event, FingerLifted
from smarttouch.base.stopping import StopRequest
from smarttouch.boards.board import Board
from smarttouch.experiments.answer_file import NUMBER, OPTIONAL, WORDS, AnswerFile, Value
from smarttouch.experiments.contact_and_force_calibration import ProfileFile
from smarttouch.experiments.procedures import Condition, middle_and_spread
from smarttouch.experiments.trial_source import TrialSource
from smarttouch.experiments.trials import STEP_S, Course, Setup, Trial, Trials
from smarttouch.kernels.bank import single_bank
from smarttouch.profile import Profile
from smarttouch.running.config import RunConfig
from smarttouch.running.display import Display
from smarttouch.running.runner import Runner
from smarttouch.running.step_records import Listener, StepResult
from smarttouch.stimulation.safety_limits import LONGEST_RAMP_S

RISE_S = 6.0  # rise time of the first run from zero to the expected threshold
REACTION_S = 0.35  # reaction time: the threshold is the current 0.35 s before the key press
PAUSE_S = (1.0, 2.0)
"""Range of the random pause before a run, s. With a fixed pause, participants could count time."""
START_SHARE = (0.4, 0.7)
"""Range of a random share. In each run except the first, the current rises fast to this share of
the lowest threshold so far, and then slowly."""
LEAP = 10  # slope of the fast rise (see `START_SHARE`), divided by the slope after it
CEILING_S = 1.0  # a run ends after this time at the largest current
MOST_APART = 1.4  # largest ratio of the highest to the lowest threshold; above it, runs are added
EXTRA_RUNS = 2  # largest number of added runs
HURRIED_S = 0.8
"""Shortest plausible time between the two key presses of a run, s. After a shorter time, the run is
repeated: the participant may have held the key down, or felt pain."""
MOST_HURRIED = 2  # largest number of runs that are repeated because of `HURRIED_S`
LEAST_RATIO = 1.05  # smallest usable ratio of comfort level to threshold
STOP_KEYS = ("q", "Q", "\x1b", "\x03", "\x04", "")
"""Keys that end the measurement at once. An empty key means that the terminal was closed."""
_SLOWER = 0.98  # largest slope of the current, relative to the ramp of the profile
_REACTION, _HURRIED, _CEILING = (
    round(each / STEP_S) for each in (REACTION_S, HURRIED_S, CEILING_S)
)


def measuring_profile(profile: Profile, spare_ma: float = 0.0) -> Profile:
    """Return a copy of a profile, with comfort levels as high as the device's limits allow.

    The safety limits do not change, and the largest slope in mA/s does not grow. Comfort levels
    stay ``spare_ma`` below the limits of charge and total current, as a margin for rounding.
    """
    full_ma, limits = float(profile.full_ma.max()), profile.limits
    by_charge_ma = 1000 * limits.charge_uc / profile.pulse.width_us
    most_ma = min(
        limits.current_ma, min(by_charge_ma, profile.total_ma) - spare_ma,
        full_ma * LONGEST_RAMP_S / limits.ramp_s,
    )  # fmt: skip
    electrode_ma = limits.electrode_ma or (most_ma,) * len(profile.electrodes)
    ceilings_ma = [_whole_ua(min(most_ma, limit_ma)) for limit_ma in electrode_ma]
    perception = profile.perception.model_dump() | {"comfort_ma": ceilings_ma}
    # The ramp rises to the ceiling in `ramp_s`. To keep its slope, scale `ramp_s` with the ceiling.
    ramp_s = min(LONGEST_RAMP_S, limits.ramp_s * max(1.0, max(ceilings_ma) / full_ma))
    return Profile.model_validate({
        **profile.model_dump(), "perception": perception,
        "limits": limits.model_dump() | {"ramp_s": ramp_s},
    })  # fmt: skip


def _whole_ua(current_ma: float) -> float:
    return math.floor(1000 * current_ma + 1e-6) / 1000


@dataclass(frozen=True)
class Thresholds:
    """Detection threshold and comfort level of one electrode."""

    # Medians of the runs; both are NaN if the participant did not feel the largest current.
    # If a run has no second key, its comfort level is the largest current.
    threshold_ma: float
    comfort_ma: float
    spread: float  # robust standard deviation of the runs' thresholds, divided by their median
    runs: int
    false_presses: int  # number of keys pressed before current could be felt

    @property
    def felt(self) -> bool:
        return bool(np.isfinite(self.threshold_ma))

    @property
    def usable(self) -> bool:
        """Whether the comfort level is far enough above the threshold."""
        return self.felt and self.comfort_ma >= LEAST_RATIO * self.threshold_ma

    def __str__(self) -> str:
        if not self.felt:
            return "not felt up to the largest current"
        note = "" if self.usable else " (too close together: not used)"
        return f"threshold {self.threshold_ma:.2f} mA, comfort level {self.comfort_ma:.2f} mA{note}"


@dataclass
class AscendingLimits:
    """Method of ascending limits at one electrode. Current rises in each run. The first key means
    *felt*, the second key means *strong enough*."""

    ceiling_ma: float  # largest current of a run
    expected_ma: float  # expected threshold; determines how fast the current rises
    repeats: int = 3  # number of runs; up to `EXTRA_RUNS` follow if their thresholds differ
    fastest_ma_s: float = float("inf")  # largest slope of the current
    seed: int | tuple[int, ...] = 0  # seed of random pauses and start currents (`START_SHARE`)

    def __post_init__(self) -> None:
        self._random = np.random.default_rng(self.seed)
        fastest_ma = self.fastest_ma_s * STEP_S
        wanted_ma = min(self.expected_ma, self.ceiling_ma) * STEP_S / RISE_S
        self._step_ma = min(wanted_ma, fastest_ma)
        self._leap_ma = min(LEAP * wanted_ma, fastest_ma)
        self._runs: list[tuple[float, float]] = []  # threshold, comfort level; NaN if not reached
        self._false_presses = self._hurried = 0

    def course(self) -> Course:
        """Yield the current of each step, see `Course`; return `Thresholds`."""
        while not self._is_done():
            run = yield from self._rise()
            if run is not None:
                self._runs.append(run)
        threshold, comfort = np.array(self._runs).T
        if np.isnan(threshold).any():
            return Thresholds(np.nan, np.nan, np.nan, len(self._runs), self._false_presses)
        middle, spread = middle_and_spread(threshold)
        return Thresholds(
            middle, float(np.median(comfort)), spread / middle, len(self._runs), self._false_presses
        )

    def _is_done(self) -> bool:
        thresholds_ma = [threshold_ma for threshold_ma, _ in self._runs]
        if thresholds_ma and math.isnan(thresholds_ma[-1]):
            return True
        if len(thresholds_ma) < self.repeats:
            return False
        apart = len(thresholds_ma) > 1 and max(thresholds_ma) > MOST_APART * min(thresholds_ma)
        return not apart or len(thresholds_ma) >= self.repeats + EXTRA_RUNS

    def _rise(self) -> Generator[float, bool | None, tuple[float, float] | None]:
        """Yield the currents of a run. Return its threshold and comfort level, mA. If the run must
        be repeated, return None."""
        pause, levels, threshold_ma, felt_at = self._draw_pause(), [0.0], math.nan, 0
        share = self._random.uniform(*START_SHARE) if self._runs else 0.0
        start_ma = share * min((run_ma for run_ma, _ in self._runs), default=0.0)
        while pause > 0:
            pressed = yield 0.0
            if pressed is None:
                return None
            self._false_presses += pressed
            pause = self._draw_pause() if pressed else pause - 1
        while True:
            rise_ma = self._leap_ma if levels[-1] < start_ma else self._step_ma
            levels.append(min(levels[-1] + rise_ma, self.ceiling_ma))
            pressed = yield levels[-1]
            steps = len(levels) - 1
            if pressed is None:
                return None
            if pressed and (steps <= _REACTION or self._is_hurried(steps, felt_at)):
                # A key that comes faster than any reaction is not a response to this current.
                self._false_presses += steps <= _REACTION
                return None
            if pressed and felt_at:
                return threshold_ma, levels[-1 - _REACTION]
            if pressed:
                threshold_ma, felt_at = levels[-1 - _REACTION], steps
            elif steps > _CEILING and levels[-1 - _CEILING] >= self.ceiling_ma:
                # The current has been at the ceiling for `CEILING_S`: end the run.
                return threshold_ma, self.ceiling_ma if felt_at else math.nan

    def _is_hurried(self, steps: int, felt_at: int) -> bool:
        """Return whether a run must be repeated because its second key came too soon. If so,
        increase the count of these runs."""
        hurried = felt_at > 0 and steps - felt_at < _HURRIED and self._hurried < MOST_HURRIED
        self._hurried += hurried
        return hurried

    def _draw_pause(self) -> int:
        return round(self._random.uniform(*PAUSE_S) / STEP_S)


_ABOUT = {"profile": WORDS, "electrodes": NUMBER, "board": WORDS, "pulse_us": NUMBER,
          "repeats": NUMBER}  # fmt: skip
_COLUMNS = {
    **_ABOUT, "electrode": NUMBER, "threshold_ma": OPTIONAL, "comfort_ma": OPTIONAL,
    "spread": OPTIONAL, "runs": NUMBER, "false_presses": NUMBER, "version": WORDS,
}  # fmt: skip
_RESULTS = tuple(each.name for each in fields(Thresholds))


class Progress(AnswerFile):
    """File with the results of a threshold session, from which an interrupted session continues.

    Each result is on disk before `keep` returns. An open file is locked. `close` removes a file
    without results. Raises ExperimentError if an existing file has settings other than ``about``.
    """

    def __init__(self, path: Path, about: Mapping[str, Value]) -> None:
        super().__init__(path, about, _COLUMNS)
        self.found: dict[int, Thresholds] = {}
        for row in self.rows:
            threshold_ma, comfort_ma, spread, runs, false_presses = (
                math.nan if row[column] is None else float(row[column] or 0.0)
                for column in _RESULTS
            )
            if not (math.isnan(threshold_ma) or 0 < threshold_ma <= comfort_ma):
                super().close()
                raise CalibrationError(
                    f"{path} has a threshold of {threshold_ma:g} mA with a comfort level of "
                    f"{comfort_ma:g} mA: correct the line, or remove the file to start over"
                )
            self.found[int(row["electrode"] or 0)] = Thresholds(
                threshold_ma, comfort_ma, spread, int(runs), int(false_presses)
            )

    def close(self) -> None:
        """Close the file; remove it if it contains no results."""
        if not self.found:
            self.forget()
        super().close()

    def keep(self, site: int, found: Thresholds) -> None:
        values = asdict(found)
        self.append({"electrode": site} | {
            name: None if math.isnan(value) else value for name, value in values.items()
        })  # fmt: skip
        self.found[site] = found

    def forget(self) -> None:
        """Remove the file. Call this when the profile contains the results."""
        self.path.unlink(missing_ok=True)


def threshold_trials(
    profile: Profile,  # profile to measure with
    board: Board,  # must be open before the first trial; its `max_current_ma` limits the current
    sites: Sequence[int],
    progress: Progress,  # stores each result; electrodes with a stored result are skipped
    say: Callable[[str], None],  # shows a line of text
    *,
    repeats: int = 3,  # runs of rising current for each electrode
    seed: int = 0,  # seed of all random choices
) -> Trials:
    """Measure one electrode after another. Repeat an electrode once if its results are unusable."""
    measuring = measuring_profile(profile)
    # A train needs two pulses, so lengthen it at a low pulse rate.
    setup = Setup(measuring, Afferent.RA, train_s=max(0.8, 2 / measuring.pulse.rate_hz))
    for site in sites:
        if site in progress.found:
            continue
        for attempt in (0, 1):
            ceiling_ma = min(float(measuring.full_ma[site]), board.capabilities.max_current_ma)
            rising = AscendingLimits(
                _whole_ua(ceiling_ma), float(profile.threshold_ma[site]), repeats,
                _SLOWER * float(measuring.full_ma[site]) / measuring.limits.ramp_s,
                (seed, site, attempt),
            )  # fmt: skip
            answer = yield Trial(
                Condition(0.0, math.nan, index=site), (setup.train([site], setup.pulse_hz),),
                "felt",
                f"electrode {site}: press a key when you feel it, again when it is strong enough",
                "mA", exact=True, course=rising.course(),
            )  # fmt: skip
            thresholds: Thresholds = answer.found
            if thresholds.usable or not thresholds.felt:
                break
        progress.keep(site, thresholds)
        say(f"electrode {site}: {thresholds}")


Found = Mapping[int, Thresholds]
Keys = Callable[[Callable[[str], None]], AbstractContextManager[None]]
"""Function that takes a handler of keys and returns a context manager. In its context, the handler
receives each pressed key. An empty key means that the terminal was closed."""


def filled(profile: Profile, found: Found) -> tuple[list[float], list[float]]:
    """Return thresholds and comfort levels of all electrodes, mA.

    Electrodes without a usable result keep their values.
    """
    usable = {site: site_result for site, site_result in found.items() if site_result.usable}
    if not usable:
        raise CalibrationError(
            "no electrode has a usable threshold and comfort level: check contact with 'smarttouch "
            "calibrate contact', and explain the task to the participant"
        )
    threshold, comfort = profile.threshold_ma.astype(float), profile.full_ma.astype(float)
    for site, site_result in usable.items():
        threshold[site], comfort[site] = site_result.threshold_ma, site_result.comfort_ma
    # Round down, so that no comfort level exceeds a limit.
    return (
        [round(float(value_ma), 3) for value_ma in threshold],
        [math.floor(1000 * float(value_ma) + 1e-3) / 1000 for value_ma in comfort],
    )


def sentence(found: Found) -> str:
    """Return the sentence that the profile stores about these thresholds."""
    usable = [site_result for site_result in found.values() if site_result.usable]
    threshold = np.array([site_result.threshold_ma for site_result in usable])
    comfort = np.array([site_result.comfort_ma for site_result in usable])
    spread = float(np.median([site_result.spread for site_result in usable]))
    unusable = sorted(site for site, site_result in found.items() if not site_result.usable)
    return (
        f"{len(usable)} electrodes with usable results from a rising current; median threshold "
        f"{np.median(threshold):.2f} mA ({threshold.min():.2f} to {threshold.max():.2f}), median "
        f"comfort level {np.median(comfort):.2f} mA ({comfort.min():.2f} to {comfort.max():.2f}), "
        f"median spread of the threshold at one electrode {spread:.1%}, "
        f"{sum(site_result.runs for site_result in found.values())} runs, "
        f"{sum(site_result.false_presses for site_result in found.values())} false presses"
        + (f"; electrodes without usable results keep their values: {unusable}" if unusable else "")
    )


@dataclass(frozen=True, kw_only=True)
class ThresholdProcedure:
    """Threshold measurement on a board: electrodes, method and files."""

    start: str  # name or file of the initial profile
    file: ProfileFile  # profile file for the results
    board_url: str
    sites: Sequence[int]
    # repeats, seed: see `threshold_trials`
    repeats: int = 3
    seed: int = 0

    def progress(self) -> Progress:
        """Open the file of results, which may contain results of an interrupted session."""
        profile = self.file.profile
        return Progress(
            self.file.beside("thresholds.csv"),
            {
                "profile": self.start, "electrodes": len(profile.electrodes),
                "board": self.board_url.partition(":")[0], "pulse_us": profile.pulse.width_us,
                "repeats": self.repeats,
            },
        )  # fmt: skip

    def measure(
        self,
        progress: Progress,  # stores each result
        keys: Keys,
        say: Callable[[str], None],  # shows a line
        stop: StopRequest,
        force: str | None = None,  # URL of the force sensor, see `Runner`
    ) -> None:
        """Measure all electrodes. `STOP_KEYS` end the measurement; any other key is an answer."""
        profile, measuring = self.file.profile, measuring_profile(self.file.profile)
        display = Display(self.board_url, measuring)
        trials = threshold_trials(
            profile, display.board, self.sites, progress, say, repeats=self.repeats, seed=self.seed
        )
        source = TrialSource(trials, measuring, "thresholds")

        def on_key(key: str) -> None:
            if key in STOP_KEYS:
                stop.ask(f"key {key!r}")
            else:
                source.press(key)

        say(
            f"The current rises to at most {measuring.full_ma.max():.2f} mA. Press a key when you "
            "feel it, and again when it is strong enough; q or Esc stops at once."
        )
        config = RunConfig(scan="points", intensity=1.0, seed=self.seed)
        with keys(on_key):
            Runner(
                source, display, config, force=force, stop=stop, load_kernels=single_bank,
                listeners=[_Prompts(source, say)],
            ).run()  # fmt: skip
        if set(self.sites) - set(progress.found):
            raise self.stopped(progress)

    def stopped(self, progress: Progress) -> CalibrationError:
        left = len(set(self.sites) - set(progress.found))
        return CalibrationError(
            f"stopped, all electrodes are off; {left} of {len(self.sites)} electrodes are not yet "
            "measured: repeat the command to continue"
        )

    def set_results(self, progress: Progress) -> str:
        """Set the results in the profile, without writing the file; return a summary sentence."""
        threshold_ma, comfort_ma = filled(self.file.profile, progress.found)
        self.file.set("perception.threshold_ma", threshold_ma)
        self.file.set("perception.comfort_ma", comfort_ma)
        return sentence(progress.found)


class _Prompts(Listener):
    """Listener that shows questions, missing preconditions and messages of the board."""

    def __init__(self, source: TrialSource, say: Callable[[str], None]) -> None:
        super().__init__()
        self._source, self._say, self._shown = source, say, ""

    def step(self, result: StepResult) -> None:
        asked = self._source.title.partition(": ")[2]
        if asked and asked != self._shown:
            self._say(asked)
        self._shown = asked

    def event(self, event: Event) -> None:
        if isinstance(event, Advice | BoardRestarted | FingerLifted):
            self._say(str(event))
