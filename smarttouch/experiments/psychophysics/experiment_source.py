"""An experiment as a program: the pulses of its trials, and questions in between."""

import math
from collections import deque
from collections.abc import Callable, Mapping
from functools import partial

from smarttouch.base.errors import ExperimentError, LevelNotReachedError
from smarttouch.base.events import TrialEvent
from smarttouch.experiments.psychophysics.trials import Answer, Train, Trial, Trials, TrialTiming
from smarttouch.profile import Profile
from smarttouch.running.program import SILENT_US, STEADY, Level, Program, Shown
from smarttouch.running.step import StepResult
from smarttouch.stimulation.ramp import FIRST_NS, MOST_STEP_NS

PAUSE_S = 0.5  # least time between an answer and the next trial
STEP_S = 0.05  # one step of a current that follows the keys
_SPOILED = 0.5
"""Part of the requested intensity below which current was lost within an interval. A key moves it
by less; where milliamperes count, nothing may."""
AGAIN = "r"  # key that repeats a trial
_NUMBERS = ("first", "second")


class ExperimentSource(Program):
    """Source that presents trial after trial.

    Each begins when the intensity is there that the user has chosen; one whose current is lost
    within an interval (paused, finger lifted, board gone) is presented again.
    """

    fixed_mode = True
    ended = "the experiment is over"

    def __init__(self, trials: Trials, profile: Profile, timing: TrialTiming) -> None:
        super().__init__(profile, trials.title)
        self.asking: Trial | None = None
        self.playing: tuple[int, int] | None = None
        self.rising: Trial | None = None
        self.repeats: int = 0
        self.spoiled: int = 0
        self._trials, self._timing = trials, timing
        self.patience_s: float = timing.patience_s or math.inf
        self._pressed: deque[tuple[str, int]] = deque()
        self._presentation = 0

    @property
    def keys(self) -> Mapping[str, Callable[[], None]]:
        """Keys of the current trial's answers, and the key that repeats it."""
        named = "12ynr\n\r" + "".join(map(chr, range(ord("A"), ord("Z") + 1)))
        return {key: partial(self.press, key) for key in (*named, "left", "right")}

    def press(self, key: str) -> None:
        """Take a key; from any thread."""
        self._pressed.append((key, self.time_ns()))

    def step(self, result: StepResult) -> None:
        """Note how the last stimulus was sent."""
        super().step(result)
        asked_us, sequence = result.step.asked_us, result.sequence
        if self.playing is not None and sequence.period_us != asked_us and not self.notes:
            self.notes.append(
                f"pulses were requested at {1e6 / asked_us:.4g} Hz and sent at "
                f"{sequence.rate_hz:.4g} Hz: this board or so many sites cannot do all frequencies"
            )

    def note_opening(self) -> None:
        """Show what is missing for a trial to begin."""
        self._say(self._missing)

    def program(self) -> None:
        """Present all trials."""
        while (trial := self._trials.next()) is not None:
            self._tell("trial", f": {trial.words}")
            answer, spoiled = None, self.spoiled
            while answer is None:
                self._prepare(trial)
                answer = self._attempt(trial)
                self._require_current(self.spoiled - spoiled)
            self._tell("response", f": {_words(answer)}")
            self._trials.record(trial, answer)
        self.title = f"{self._trials.title}: over"

    def _prepare(self, trial: Trial) -> None:
        """Pause without current, after faint pulses where these must open the intensity first."""
        train = trial.intervals[0]
        # A blank begins as the train that it stands for, so that nothing distinguishes the two.
        activation = train.activation if train.blanked is None else train.blanked
        level = train.level_at(0)
        self._say("")
        self.wait(PAUSE_S)
        try:
            if trial.course is not None:
                # It rises by itself, from zero; only force and the user's level must be there.
                self.wait(self.patience_s, self._is_ready)
                if not self._is_ready():
                    raise LevelNotReachedError("")
                return
            # Where no pulses are weak enough, no level is opened.
            while self.rise(level, activation, exact=trial.exact):
                self._say("")
                self.wait(PAUSE_S)
        except LevelNotReachedError:
            raise ExperimentError(
                f"no trial could begin for {self.patience_s:g} s, and nobody is there to "
                f"{self._missing}: give more --intensity or --force"
            ) from None

    def _is_ready(self) -> bool:
        """Return whether a current can follow the keys; report what is missing."""
        ready = self.gate * self.user_level >= STEADY
        if not ready:
            self.note_opening()
        return ready

    def _attempt(self, trial: Trial) -> Answer | None:
        """Present a trial and ask; return None if it is to be presented again."""
        self._presentation += 1
        for index, train in enumerate(trial.intervals):
            if index:
                self.wait(self._timing.gap_s)
            self._say("feel" if len(trial.intervals) == 1 else _NUMBERS[index])
            self.playing = (self._presentation, index)
            self.rising = trial if trial.course is not None or train.rises else None
            self._pressed.clear()
            play = self._played if trial.course is None else self._followed
            try:
                shown, key = play(trial, train)
            except LevelNotReachedError:
                self.spoiled += 1
                self._tell("trial", " again: current was lost")
                return None
            finally:
                self.playing = self.rising = None
            if trial.course is not None:
                self.wait(SILENT_US / 1e6)
                return self._answer("", None, shown.current_ma)
            if key is not None:
                return self._answer(trial.answers[key[0]], None, shown.current_ma)
        if trial.rises:
            return self._answer("n", None, shown.current_ma)
        return self._asked(trial)

    def _played(self, trial: Trial, train: Train) -> tuple[Shown, tuple[str, int] | None]:
        """Play an interval; an answer ends one that rises."""
        key: tuple[str, int] | None = None

        def level(since_s: float) -> float | None:
            nonlocal key
            if train.rises:
                key = self._key(trial)
            else:
                # Keys are dropped until the last pulse; one while it fades counts.
                self._pressed.clear()
            return train.level_at(round(since_s * 1e6) // train.period_us) if key is None else None

        shown = self._present(trial, train, level, train.pulses * train.period_us / 1e6)
        return shown, self._key(trial) if train.rises and key is None else key

    def _followed(self, trial: Trial, train: Train) -> tuple[Shown, None]:
        """Make the current follow the keys from zero, no faster than the ramp."""
        course = trial.course
        assert course is not None
        full_ma = float(self._profile.full_ma[train.activation.any(axis=0)].min())
        level, before_ns, due_ns = 0.0, 0, round(STEP_S * 1e9)
        current_ma = course.next()

        def follow(since_s: float) -> float | None:
            nonlocal level, before_ns, due_ns, current_ma
            since_ns = round(since_s * 1e9)
            while since_ns >= due_ns and not course.done:
                due_ns += round(STEP_S * 1e9)
                course.answer(bool(self._pressed))
                self._pressed.clear()
                current_ma = 0.0 if course.done else course.next()
            # From zero by the first step that currents take.
            risen_ns = min(since_ns - before_ns, MOST_STEP_NS) if level else FIRST_NS
            most = level + risen_ns / 1e9 / self._profile.limits.ramp_s
            level, before_ns = min(1.0, current_ma / full_ma, most), since_ns
            return None if course.done else level

        try:
            return self._present(trial, train, follow, math.inf), None
        except LevelNotReachedError:
            course.restart()
            raise

    def _present(self, trial: Trial, train: Train, level: Level, seconds: float) -> Shown:
        return self.show(
            train.activation, seconds, level, rate_hz=train.rate_hz, opens=0, exact=trial.exact,
            least=STEADY if trial.exact else _SPOILED,
        )  # fmt: skip

    def _asked(self, trial: Trial) -> Answer | None:
        self._say(trial.question + (f", {AGAIN} again" if self._timing.again else ""))
        key: tuple[str, int] | None = None

        def is_answered() -> bool:
            nonlocal key
            key = self._key(trial)
            return key is not None

        self.asking, asked_ns = trial, self.now_ns
        self.wait(self._timing.answer_s or math.inf, is_answered)
        self.asking = None
        if key is None:
            return self._answer("", None)
        if key[0] == AGAIN:
            self.repeats += 1
            self._tell("trial", " felt again")
            return None
        return self._answer(trial.answers[key[0]], max(0, key[1] - asked_ns) / 1e9)

    def _require_current(self, spoiled: int) -> None:
        """Raise if a trial was spoiled more often than it may be."""
        most = self._timing.most_spoiled
        if most is not None and spoiled > most:
            raise ExperimentError(
                f"current was lost {spoiled} times in one trial, and {most} times are allowed: "
                "check the board's line, and keep the finger on the electrodes"
            )

    def _answer(self, response: str, rt_s: float | None, reached: float | None = None) -> Answer:
        return Answer(response, rt_s, self.now_ns / 1e9, self.user_level, reached)

    def _key(self, trial: Trial) -> tuple[str, int] | None:
        """Return the first valid key, and when it was pressed."""
        again = self._timing.again and not trial.rises
        while self._pressed:
            key = self._pressed.popleft()
            if key[0] in trial.answers or (again and key[0] == AGAIN):
                return key
        return None

    @property
    def _missing(self) -> str:
        if self.gate == 0:
            return "press the finger on the electrodes"
        if self.user_level == 0:
            return "raise the intensity with +"
        return "press firmly, and raise the intensity to the full with +"

    def _tell(self, what: str, words: str) -> None:
        """Emit an event of the current trial."""
        self.emit(TrialEvent(self.now_ns, f"{what} {self._trials.done + 1}{words}"))

    def _say(self, words: str) -> None:
        total = "" if self._trials.total is None else f" of {self._trials.total}"
        self.title: str = f"{self._trials.title}, trial {self._trials.done + 1}{total}" + (
            f": {words}" if words else ""
        )


def _words(answer: Answer) -> str:
    if not answer.response:
        return "none"
    after = "" if answer.rt_s is None else f" after {answer.rt_s:.2f} s"
    return (
        answer.response + after + ("" if answer.reached is None else f" at {answer.reached:.3f} mA")
    )
