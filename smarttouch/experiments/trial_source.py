"""Source that presents the trials of an experiment: pulses, and questions after them."""

import math
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial

from smarttouch.base.errors import ExperimentError, LevelNotReachedError
from smarttouch.base.events import TrialEvent
from smarttouch.emulator.drivers import SimulatedDriver
from smarttouch.experiments.observers import Observer, Starts, interval_of
from smarttouch.experiments.trials import STEP_S, Answer, Train, Trial, Trials
from smarttouch.profile import Profile
from smarttouch.running.pattern_program import SILENT_US, STEADY, Level, Program, Shown
from smarttouch.running.step_records import RunContext, StepResult
from smarttouch.sources.source_contract import Input, Stimulus
from smarttouch.stimulation.safety_gate import FIRST_NS, MOST_STEP_NS
from smarttouch.stimulation.scheduler import rate_share

PAUSE_S = 0.5  # shortest time between an answer and the next trial
PATIENCE_S = 10.0  # longest wait until a trial begins, with a simulated participant
MOST_SPOILED = 10  # largest number of times that a trial is repeated after a loss of current
_SPOILED = 0.5
"""A trial is repeated if intensity falls below this share of the requested intensity. For trials
with exact currents, the share is `STEADY`."""
_NUMBERS = ("first", "second")


class TrialSource(Program):
    """Source that presents the trials of a generator, and sends each answer back to the generator.

    A trial begins when the current has reached the user's intensity. A trial is repeated if the
    current is lost. An observer, if given, answers instead of a person.
    """

    fixed_mode = True
    ended = "the experiment is over"

    def __init__(
        self,
        trials: Trials,
        profile: Profile,
        title: str,
        *,
        done: int = 0,  # number of trials done in earlier runs
        total: int | None = None,  # number of trials; None if it depends on the answers
        gap_s: float = 0.5,  # pause between two intervals
        answer_s: float = 0.0,  # time limit for an answer; 0 for none
        observer: Observer | None = None,
    ) -> None:
        super().__init__(profile, title)
        self._trials, self._name, self._done = trials, title, done
        self._of = "" if total is None else f" of {total}"
        self._gap_s, self._answer_s, self._observer = gap_s, answer_s or math.inf, observer
        self.patience_s: float = math.inf if observer is None else PATIENCE_S
        self._pressed: deque[tuple[str, int]] = deque()
        self._starts: list[Starts] | None = None  # timing of each interval; None between stimuli
        self._wanted: float | None = None  # latest current that `Trial.course` yielded, mA
        self._softness = 1.0  # softness of the train being presented

    @property
    def keys(self) -> Mapping[str, Callable[[], None]]:
        """Keys of all possible answers."""
        named = "12yn\n\r" + "".join(map(chr, range(ord("A"), ord("Z") + 1)))
        return {key: partial(self.press, key) for key in (*named, "left", "right")}

    def press(self, key: str) -> None:
        """Store a pressed key and its time. Any thread may call this."""
        self._pressed.append((key, self.time_ns()))

    def start(self, run: RunContext) -> None:
        super().start(run)
        if self._observer is not None and not isinstance(run.board.driver, SimulatedDriver):
            raise ExperimentError(
                "a simulated participant responds only to simulated currents: choose the board "
                "simulated:"
            )

    def read(self, time_ns: int) -> Input | None:
        """Return the stimulus to send. Below softness 1 the pulse rate follows the force."""
        stimulus = super().read(time_ns)
        if isinstance(stimulus, Stimulus) and stimulus.period_us is not None and self._softness < 1:
            share = rate_share(self.gate, self._softness)
            stimulus = replace(stimulus, period_us=round(stimulus.period_us / share))
        return stimulus

    def step(self, result: StepResult) -> None:
        """Record when the stimulus was sent; note a rate that the board cannot reach."""
        super().step(result)
        if self._starts is None:
            return
        asked_us, sequence = result.step.asked_us, result.sequence
        if sequence.period_us != asked_us and not self.notes:
            self.notes.append(
                f"pulses were requested at {1e6 / asked_us:.4g} Hz and sent at "
                f"{sequence.rate_hz:.4g} Hz: the board cannot stimulate all sites faster"
            )
        if self._observer is not None and result.number is not None:
            discharge_us = int(sequence.discharge_us[0]) if sequence.slots else 0
            self._starts[-1][result.number] = (sequence.time_ns, discharge_us)

    def note_opening(self) -> None:
        """Show what the participant must do so that the trial can begin."""
        self._say(self._missing)

    def program(self) -> None:
        trial = next(self._trials, None)
        while trial is not None:
            self._tell("trial", f": {trial.words}")
            answer, spoiled = None, 0
            while answer is None:
                try:
                    answer = self._attempt(trial)
                except LevelNotReachedError as lost:
                    spoiled += 1
                    self._tell("trial", " again: current was lost")
                    if spoiled > MOST_SPOILED:
                        raise ExperimentError(
                            f"current was lost {spoiled} times in one trial, more than the allowed "
                            f"{MOST_SPOILED}: check the connection, and keep the finger on the "
                            "electrodes"
                        ) from lost
                finally:
                    self._starts = None
            self._tell("response", f": {_words(answer)}")
            self._done += 1
            try:
                trial = self._trials.send(answer)
            except StopIteration:
                trial = None
        self.title = f"{self._name}: over"

    def _attempt(self, trial: Trial) -> Answer:
        self._say("")
        self.wait(PAUSE_S)
        felt: list[Starts] = []
        if trial.course is not None:
            return self._attempt_course(trial)
        train = trial.intervals[0]
        self._open(partial(self.rise, train.level, train.activation, trial.exact))
        for index, train in enumerate(trial.intervals):
            if index:
                self.wait(self._gap_s)
            self._say("feel" if len(trial.intervals) == 1 else _NUMBERS[index])
            felt.append({})
            self._starts = felt
            self._present(trial, train, train.level, train.seconds)
            self._starts = None
        # Ignore keys that were pressed during the stimuli.
        self._pressed.clear()
        return self._ask(trial) if self._observer is None else self._decided(trial, felt)

    def _open(self, raise_level: Callable[[], float]) -> None:
        """Call ``raise_level`` until it returns 0, which means that the level is reached."""
        try:
            while raise_level():
                self._say("")
                self.wait(PAUSE_S)
        except LevelNotReachedError:
            raise ExperimentError(
                f"no trial began within {self.patience_s:g} s: a simulated participant cannot "
                f"{self._missing}, so give a higher --intensity or --force"
            ) from None

    def _present(self, trial: Trial, train: Train, level: Level, seconds: float) -> Shown:
        activation = train.activation * (not train.is_blank)
        self._softness = train.softness
        try:
            return self.show(
                activation, seconds, level, rate_hz=train.rate_hz, opens=0, exact=trial.exact,
                least=STEADY if trial.exact else _SPOILED,
            )  # fmt: skip
        finally:
            self._softness = 1.0

    def _attempt_course(self, trial: Trial) -> Answer:
        """Present the current that `Trial.course` yields, but raise it no faster than the ramp."""
        course, (train,) = trial.course, trial.intervals
        assert course is not None
        if self._observer is not None:
            raise ExperimentError(
                "a simulated participant cannot control a current: leave out --simulate"
            )
        # Wait for force, but do not raise the ramp: `Trial.course` raises the current.
        self._open(self._wait_for_force)
        full_ma = float(self._profile.full_ma[train.activation.any(axis=0)].min())
        level, before_ns, due_ns = 0.0, 0, round(STEP_S * 1e9)
        found: object = None
        self._wanted = next(course) if self._wanted is None else self._wanted
        self._say(trial.question)
        self._pressed.clear()
        self._starts = [{}]

        def follow(since_s: float) -> float | None:
            nonlocal level, before_ns, due_ns, found
            since_ns = round(since_s * 1e9)
            while since_ns >= due_ns and self._wanted is not None:
                due_ns += round(STEP_S * 1e9)
                pressed = len(self._pressed)
                try:
                    self._wanted = course.send(pressed > 0)
                except StopIteration as end:
                    self._wanted, found = None, end.value
                for _ in range(pressed):
                    self._pressed.popleft()
            if self._wanted is None:
                return None
            # The gate lets the first nonzero level be as high as the ramp rises in `FIRST_NS`.
            risen_ns = min(since_ns - before_ns, MOST_STEP_NS) if level else FIRST_NS
            most_level = level + risen_ns / 1e9 / self._profile.limits.ramp_s
            level, before_ns = min(1.0, self._wanted / full_ma, most_level), since_ns
            return level

        try:
            shown = self._present(trial, train, follow, math.inf)
        except LevelNotReachedError:
            self._wanted = course.send(None)
            raise
        self._starts = None
        self.wait(SILENT_US / 1e6)
        response = found if isinstance(found, str) else ""
        answer = self._answer(trial, response, None)
        return replace(answer, reached=shown.current_ma, found=found)

    def _wait_for_force(self) -> float:
        """Wait until force and intensity suffice, then return 0 to end the loop in `_open`."""

        def is_ready() -> bool:
            ready = self.gate * self.user_level >= STEADY
            if not ready:
                self.note_opening()
            return ready

        self.wait(self.patience_s, is_ready)
        if not is_ready():
            raise LevelNotReachedError("")
        return 0.0

    def _decided(self, trial: Trial, felt: list[Starts]) -> Answer:
        """Return the observer's answer to the pulses that the board delivered."""
        driver = self._context.board.driver
        assert self._observer is not None
        assert isinstance(driver, SimulatedDriver)
        self.wait(SILENT_US / 1e6)
        pulses = driver.take_pulses()
        intervals = [interval_of(pulses, starts) for starts in felt]
        response = self._observer.respond(trial.task, intervals, trial.alternatives)
        if response is None:
            return self._answer(trial, "", None)
        return self._answer(trial, response, 0.0)

    def _ask(self, trial: Trial) -> Answer:
        self._say(trial.question)
        asked_ns = self.now_ns

        def is_answered() -> bool:
            while self._pressed and self._pressed[0][0] not in trial.answers:
                self._pressed.popleft()
            return bool(self._pressed)

        self.wait(self._answer_s, is_answered)
        if not is_answered():
            return self._answer(trial, "", None)
        key, pressed_ns = self._pressed.popleft()
        return self._answer(trial, trial.answers[key], max(0, pressed_ns - asked_ns) / 1e9)

    def _answer(self, trial: Trial, response: str, rt_s: float | None) -> Answer:
        success = response == trial.success if response else None
        return Answer(response, success, rt_s, self.now_ns / 1e9, self.user_level)

    @property
    def _missing(self) -> str:
        if self.gate == 0:
            return "press the finger on the electrodes"
        if self.user_level == 0:
            return "raise the intensity with +"
        return "press firmly, and raise the intensity to its maximum with +"

    def _tell(self, what: str, words: str) -> None:
        """Emit an event about the current trial."""
        self.emit(TrialEvent(self.now_ns, f"{what} {self._done + 1}{words}"))

    def _say(self, words: str) -> None:
        self.title: str = f"{self._name}, trial {self._done + 1}{self._of}" + (
            f": {words}" if words else ""
        )


def _words(answer: Answer) -> str:
    words = answer.response or "none"
    if answer.rt_s is not None:
        words += f" after {answer.rt_s:.2f} s"
    return words if answer.reached is None else f"{words} at {answer.reached:.3f} mA"
