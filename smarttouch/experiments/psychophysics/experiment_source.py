"""An experiment as a source of stimuli: the pulses of its trials, and questions in between."""

from collections import deque
from collections.abc import Callable, Generator, Mapping
from functools import partial

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.afferent import Afferent
from smarttouch.base.clock import Clock
from smarttouch.base.errors import ExperimentError
from smarttouch.base.events import TrialEvent
from smarttouch.experiments.psychophysics.trials import (
    AdjustableLevel,
    Answer,
    Train,
    Trial,
    Trials,
    TrialTiming,
)
from smarttouch.profile import Profile
from smarttouch.running.listener import Listener
from smarttouch.running.step import StepResult
from smarttouch.sources.source_contract import Stimulus, StimulusSource
from smarttouch.stimulation.intensity import FIRST_NS, MOST_STEP_NS, force_gate
from smarttouch.stimulation.safety_limits import SafetyLimits, parts_per_billion

SILENT_US = 20_000
"""Interval between two checks for a key while there is no current."""
PAUSE_S = 0.5
"""Least time between an answer and the next trial."""
STEP_S = 0.05
"""One step of a current that follows the keys."""
_STEADY = 0.98
"""Part of the requested intensity at which a trial begins."""
_SPOILED = 0.5
"""Part of it below which current was lost within an interval. A key moves it by less; where
milliamperes count, nothing may."""
_FAINT = 0.01
"""Activation of pulses that open the intensity: those of threshold, if strong enough."""
AGAIN = "r"
"""Key that repeats a trial."""
_NUMBERS = ("first", "second")

Pulses = Generator[Stimulus, None, None]


class ExperimentSource(StimulusSource, Listener):
    """Source that presents trial after trial.

    Each begins when the intensity is there that the user has chosen; one whose current is lost
    within an interval (paused, finger lifted, board gone) is presented again.
    """

    ended = "the experiment is over"

    def __init__(
        self,
        trials: Trials,
        profile: Profile,
        course: TrialTiming,
        # force of a virtual finger; boards that a finger may be on need another source
        press_n: float | None = None,
        # time of keys between two stimuli; None: that of the last stimulus
        clock: Clock | None = None,
    ) -> None:
        super().__init__(trials.title)
        self.knows_force = press_n is not None
        self.asking: Trial | None = None
        self.playing: tuple[int, int] | None = None
        self.repeats = self.spoiled = 0
        self.rising: Trial | None = None
        self._trials, self._profile, self._course = trials, profile, course
        self._press_n = float("nan") if press_n is None else press_n
        self._clock = clock
        self._pressed: deque[tuple[str, int]] = deque()
        self._now_ns, self._looked = 0, (0, 0)
        self._presentation = 0
        self._trial: Trial | None = None
        self._finger = ""
        self._limits = SafetyLimits.of(profile)
        self._faint = _FAINT
        self._steady = self._lost = False
        self._level, self._current_ma = 0.0, 0.0
        self._silence = np.zeros((len(Afferent), len(profile.electrodes)), np.float32)
        self._silent_us = max(SILENT_US, self._least_us)
        self._stimuli = self._present_all()

    @property
    def _least_us(self) -> int:
        return -int(-1e6 // self._profile.limits.rate_hz)

    @property
    def keys(self) -> Mapping[str, Callable[[], None]]:
        """Keys of the current trial's answers, and the key that repeats it."""
        named = "12ynr\n\r" + "".join(map(chr, range(ord("A"), ord("Z") + 1)))
        return {key: partial(self.press, key) for key in (*named, "left", "right")}

    def press(self, key: str) -> None:
        """Take a key; from any thread."""
        time_ns, clock_ns = self._looked
        since_ns = 0 if self._clock is None else self._clock.now_ns() - clock_ns
        self._pressed.append((key, time_ns + since_ns))

    def read(self, time_ns: int) -> Stimulus | None:
        """Return the next stimulus of the trial that is on; None after the last trial."""
        self._now_ns = time_ns
        self._looked = (time_ns, 0 if self._clock is None else self._clock.now_ns())
        return next(self._stimuli, None)

    def step(self, result: StepResult) -> None:
        """Take note of how the last stimulus went out."""
        step, sequence = result.step, result.step.sequence
        given = step.tactile
        gate = force_gate(step.input.force_n, self._profile.force)
        exact = self._trial is not None and self._trial.exact
        asked = given.level if exact else given.level * gate * step.level
        self._level = step.level
        self._steady = 0 < _STEADY * asked <= sequence.intensity and result.number is not None
        if self.playing is None and self._steady and sequence.slots and self._faint < 1:
            ppb = parts_per_billion(sequence.intensity)
            if self._limits.strength_of(sequence) < _STEADY * ppb:
                # Pulses this weak do not open that much.
                self._steady, self._faint = False, min(1.0, 2 * self._faint)
        if gate == 0:
            self._finger = "press the finger on the electrodes"
        elif step.level == 0:
            self._finger = "raise the intensity with +"
        else:
            self._finger = "press firmly, and raise the intensity to the full with +"
        if self.playing is not None:
            least = _STEADY if exact else _SPOILED
            # A current that follows the keys begins at zero.
            lost = result.number is None or step.restarted or (asked == 0 and not exact)
            self._lost |= lost or sequence.intensity < least * asked
            if sequence.period_us != step.asked_us and not self.notes:
                self.notes.append(
                    f"pulses were asked for at {1e6 / step.asked_us:.4g} Hz and went out at "
                    f"{sequence.rate_hz:.4g} Hz: this board or so many sites cannot do all "
                    "frequencies"
                )
            if sequence.slots:
                self._current_ma = float(np.abs(sequence.current_ua).max()) / 1000

    def _present_all(self) -> Pulses:
        while (trial := self._trials.next()) is not None:
            self._trial = trial
            self.emit(TrialEvent(self._now_ns, f"trial {self._trials.done + 1}: {trial.words}"))
            answer, spoiled = None, self.spoiled
            while answer is None:
                yield from self._prepare(trial)
                answer = yield from self._attempt(trial)
                self._require_current(self.spoiled - spoiled)
            self.emit(
                TrialEvent(self._now_ns, f"response {self._trials.done + 1}: {_words(answer)}")
            )
            self._trials.record(trial, answer)
        self._trial = None
        self.title = f"{self._trials.title}: over"

    def _prepare(self, trial: Trial) -> Pulses:
        """Be silent, after the faintest pulses where these must open the intensity first."""
        train = trial.intervals[0]
        # A blank begins as the train that it stands for, so that nothing distinguishes the two.
        activation = train.activation if train.blanked is None else train.blanked
        # What rises within the trial begins low, and needs no more than that.
        level = train.level_at(0) if trial.course is None else _FAINT
        self._say("")
        yield from self._be_silent(PAUSE_S, level)
        began_ns, patience_s = self._now_ns, self._course.patience_s
        while not self._steady:
            self._say(self._finger)
            if patience_s is not None and self._now_ns - began_ns > patience_s * 1e9:
                raise ExperimentError(
                    f"no trial could begin for {patience_s:g} s, and nobody is there to "
                    f"{self._finger}: give more intensity or force",
                    about="trial",
                    remedy="intensity or force",
                )
            faint = np.float32(self._faint) * (activation > 0)
            yield self._stimulus(faint, self._silent_us, level)
            if self._steady:
                self._say("")
                yield from self._be_silent(PAUSE_S, level)

    def _attempt(self, trial: Trial) -> Generator[Stimulus, None, Answer | None]:
        """Present a trial and ask; return None if it is to be presented again."""
        self._presentation += 1
        self._lost = False
        for index, train in enumerate(trial.intervals):
            if index:
                yield from self._be_silent(self._course.gap_s, train.level)
            self._say("feel" if len(trial.intervals) == 1 else _NUMBERS[index])
            if trial.course is None:
                answer = yield from self._play(trial, index, train)
            else:
                answer = yield from self._follow(trial, trial.course, train)
            self.playing = None
            if self._lost:
                self.spoiled += 1
                self.emit(
                    TrialEvent(
                        self._now_ns, f"trial {self._trials.done + 1} again: current was lost"
                    )
                )
                return None
            if answer is not None:
                return answer
        if trial.rises:
            return self._answer("n", None, self._current_ma)
        answer = yield from self._ask(trial)
        return answer

    def _play(
        self, trial: Trial, index: int, train: Train
    ) -> Generator[Stimulus, None, Answer | None]:
        """Play an interval; an answer ends one that rises."""
        self.rising = trial if train.rises else None
        self._pressed.clear()
        for pulse in range(train.pulses):
            if self._lost:
                return None
            if not train.rises:
                # Whoever answers while the last pulse fades has felt all of them.
                self._pressed.clear()
            elif (key := self._key(trial)) is not None:
                return self._answer(trial.answers[key[0]], None, self._current_ma)
            self.playing = (self._presentation, index)
            yield self._stimulus(train.activation, train.period_us, train.level_at(pulse))
        if train.rises and (key := self._key(trial)) is not None:
            return self._answer(trial.answers[key[0]], None, self._current_ma)
        return None

    def _follow(
        self, trial: Trial, course: AdjustableLevel, train: Train
    ) -> Generator[Stimulus, None, Answer | None]:
        """Let the current follow the keys from zero on, no faster than the ramp."""
        profile, step_ns = self._profile, round(STEP_S * 1e9)
        full_ma = float(profile.full_ma[train.activation.any(axis=0)].min())
        self.rising = trial
        self._pressed.clear()
        level, since_ns, due_ns = 0.0, self._now_ns, self._now_ns + step_ns
        current_ma = course.next()
        while not course.done:
            # From zero by the first step that currents take.
            risen_ns = min(self._now_ns - since_ns, MOST_STEP_NS) if level else FIRST_NS
            level = min(1.0, current_ma / full_ma, level + risen_ns / 1e9 / profile.limits.ramp_s)
            since_ns = self._now_ns
            self.playing = (self._presentation, 0)
            yield self._stimulus(train.activation, train.period_us, level)
            if self._lost:
                course.restart()
                self.rising = None
                return None
            while self._now_ns >= due_ns and not course.done:
                due_ns += step_ns
                course.answer(bool(self._pressed))
                self._pressed.clear()
                current_ma = 0.0 if course.done else course.next()
        yield self._quiet(self._silent_us, 0.0)
        return self._answer("", None, self._current_ma)

    def _require_current(self, spoiled: int) -> None:
        """Raise if a trial was spoiled more often than it may be."""
        most = self._course.most_spoiled
        if most is not None and spoiled > most:
            raise ExperimentError(
                f"current was lost {spoiled} times in one trial, and {most} may be: check the "
                "board's line, and keep the finger on the electrodes",
                about="trial",
            )

    def _ask(self, trial: Trial) -> Generator[Stimulus, None, Answer | None]:
        self._say(trial.question + (f", {AGAIN} again" if self._course.again else ""))
        asked_ns, waits_s = self._now_ns, self._course.answer_s
        level = trial.intervals[0].level
        self.asking = trial
        try:
            while waits_s is None or self._now_ns - asked_ns < waits_s * 1e9:
                key = self._key(trial)
                if key is None:
                    yield self._quiet(self._silent_us, level)
                elif key[0] == AGAIN:
                    self.repeats += 1
                    self.emit(TrialEvent(self._now_ns, f"trial {self._trials.done + 1} felt again"))
                    return None
                else:
                    rt_s = max(0, key[1] - asked_ns) / 1e9
                    return self._answer(trial.answers[key[0]], rt_s)
        finally:
            self.asking = None
        return self._answer("", None)

    def _answer(self, response: str, rt_s: float | None, reached: float | None = None) -> Answer:
        self.rising = None
        return Answer(response, rt_s, self._now_ns / 1e9, self._level, reached)

    def _key(self, trial: Trial) -> tuple[str, int] | None:
        """Return the first valid key, and when it was pressed."""
        again = self._course.again and not trial.rises
        while self._pressed:
            key = self._pressed.popleft()
            if key[0] in trial.answers or (again and key[0] == AGAIN):
                return key
        return None

    def _be_silent(self, seconds: float, level: float) -> Pulses:
        end_ns = self._now_ns + round(seconds * 1e9)
        while (left_us := (end_ns - self._now_ns) // 1000) >= self._least_us:
            last = left_us <= self._silent_us + self._least_us
            yield self._quiet(left_us if last else self._silent_us, level)

    def _quiet(self, period_us: int, level: float) -> Stimulus:
        return self._stimulus(self._silence, period_us, level)

    def _stimulus(self, activation: NDArray[np.float32], period_us: int, level: float) -> Stimulus:
        number, self.frames = self.frames, self.frames + 1
        return Stimulus(activation, self._now_ns, self._press_n, period_us, level, number=number)

    def _say(self, words: str) -> None:
        total = "" if self._trials.total is None else f" of {self._trials.total}"
        self.title = f"{self._trials.title}, trial {self._trials.done + 1}{total}" + (
            f": {words}" if words else ""
        )


def _words(answer: Answer) -> str:
    if not answer.response:
        return "none"
    after = "" if answer.rt_s is None else f" after {answer.rt_s:.2f} s"
    return (
        answer.response + after + ("" if answer.reached is None else f" at {answer.reached:.3f} mA")
    )
