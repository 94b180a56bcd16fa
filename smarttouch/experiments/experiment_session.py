"""Session of an experiment: remaining trials, file of answers and summary."""

import contextlib
import math
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime
from itertools import count
from pathlib import Path

from smarttouch.base.errors import ExperimentError, SmartTouchError
from smarttouch.experiments.answer_file import AnswerFile, Row, Value
from smarttouch.experiments.observers import FITTED, Observer
from smarttouch.experiments.procedures import LIMITS, middle_and_spread
from smarttouch.experiments.standard_experiments import trials_of
from smarttouch.experiments.trial_source import TrialSource
from smarttouch.experiments.trials import Answer, Setup, Trial, Trials

_TOLERANCE = 1e-6  # values of a condition match if their relative or absolute difference is smaller


@dataclass
class ExperimentSession:
    """One run of an experiment: the remaining trials and the file of answers.

    To resume, a session sends the answers in the file to the generator of trials. The generator is
    deterministic, so it then yields the first trial that has no row in the file.
    """

    setup: Setup
    file: AnswerFile
    title: str
    resumed: int  # number of trials done in earlier runs
    _trials: Trials
    _next: Trial | None  # None after the last trial
    _date: str  # start of the session

    @property
    def over(self) -> bool:
        """Whether all trials are done."""
        return self._next is None

    def source(self, observer: Observer | None = None) -> TrialSource:
        """Return the source of stimuli. An observer, if given, answers instead of a person."""
        setup = self.setup
        source = TrialSource(
            self._recorded(), setup.profile, self.title, done=self.resumed, total=setup.total,
            gap_s=setup.gap_s, answer_s=setup.answer_s, observer=observer,
        )  # fmt: skip
        source.url = f"experiment:{self.title}"
        return source

    def _recorded(self) -> Trials:
        """Yield the remaining trials; write each answer to disk before the next trial."""
        while (trial := self._next) is not None:
            answer = yield trial
            self.file.append(self._row(trial, answer))
            self._next = _next(self._trials, answer)

    def _row(self, trial: Trial, answer: Answer) -> Row:
        condition, reached = trial.condition, answer.reached
        return {
            "thisRepN": condition.repetition, "thisTrialN": condition.trial,
            "thisN": len(self.file.rows), "thisIndex": condition.index,
            "standard": condition.standard or None,
            "comparison": condition.comparison if reached is None else reached,
            "comparison_interval": condition.comparison_interval or None, "unit": trial.unit,
            "target": trial.target, "response": answer.response, "success": answer.success,
            "rt": answer.rt_s, "time_s": round(answer.time_s, 6), "level": answer.level,
            "date": self._date,
        }  # fmt: skip

    def before(self, modeled: bool = False) -> Iterator[str]:
        """Yield lines shown before a session. ``modeled``: whether `SimulatedObserver` answers."""
        total = "" if self.setup.total is None else f" of {self.setup.total}"
        if self.resumed and not self.over:
            yield f"continues at trial {self.resumed + 1}{total}: {self.file.path}"
        yield from self.setup.notes
        if modeled and self._next is not None and self._next.task == "faster":
            yield FITTED

    def after(self) -> Iterator[str]:
        """Yield lines of text to show after the session: counts, results and the next command."""
        rows, total = self.file.rows, self.setup.total
        successes = [row for row in rows if row["success"]]
        missing = sum(row["success"] is None for row in rows)
        yield (
            f"{len(rows)}{'' if total is None else f' of {total}'} trials"
            + (f" ({self.resumed} in earlier runs)" if self.resumed else "")
            + (f", {missing} of them without an answer" if missing else "")
            + ("" if self.over else "; repeat the command to continue")
        )
        if self.setup.procedure == LIMITS:
            if successes:
                middle, spread = middle_and_spread([_comparison(success) for success in successes])
                words = f"median of {len(successes)} trials; spread {spread:.3f} mA"
                yield f"strong enough at {middle:.3f} mA ({words})"
            if len(successes) < len(rows):
                yield f"in {len(rows) - len(successes)} trials the largest current was too weak"
        elif missing < len(rows):
            yield f"fit the answers: smarttouch experiment fit {self.file.path}"


@contextlib.contextmanager
def open_experiment(
    name: str, setup: Setup, path: Path, participant: str = "", session: str = ""
) -> Iterator[ExperimentSession]:
    """Open the file of an experiment's answers, and continue after its last answer.

    ``name`` is the name of an experiment or a Python file, see `find_experiment`.
    """
    setup, trials = trials_of(name, setup)
    trial = next(trials, None)
    title = experiment_name(name, setup)
    about: dict[str, Value] = {
        "experiment": title, "procedure": setup.procedure, "participant": participant,
        "session": session, "seed": setup.seed,
    }  # fmt: skip
    with AnswerFile(path, about) as file:
        for number, row in enumerate(file.rows):
            if trial is None or not _is_same(trial, row):
                raise ExperimentError(
                    f"{path}, trial {number + 1}, is not from this experiment: use the options of "
                    "the first run, remove the file, or give another --output"
                )
            success = row["success"]
            answer = Answer(str(row["response"]), None if success is None else bool(success))
            trial = _next(trials, answer)
        date = datetime.now().astimezone().isoformat(timespec="seconds")
        yield ExperimentSession(setup, file, title, len(file.rows), trials, trial, date)


def _next(trials: Trials, answer: Answer) -> Trial | None:
    try:
        return trials.send(answer)
    except StopIteration:
        return None


def _is_same(trial: Trial, row: Row) -> bool:
    condition = trial.condition
    pairs = [(condition.standard, row["standard"] or 0.0)]
    # If keys of the participant determine the comparison, it is NaN and cannot be checked.
    if not math.isnan(condition.comparison):
        pairs.append((condition.comparison, _comparison(row)))
    interval = condition.comparison_interval or None
    return interval == row["comparison_interval"] and all(
        math.isclose(expected, float(stored), rel_tol=_TOLERANCE, abs_tol=_TOLERANCE)
        for expected, stored in pairs
    )


def _comparison(row: Row) -> float:
    return float(row["comparison"] or 0.0)


def experiment_name(name: str, setup: Setup) -> str:
    """Return the name of an experiment with the stimulated class, such as ``frequency-RA``."""
    return f"{Path(name).stem}-{setup.afferent.name}"


def session_name(experiment: str, participant: str, session: str) -> tuple[str, int]:
    """Return the file name of a session, without suffix, and the seed of its random orders."""
    for parameter, name in (("participant", participant), ("session", session)):
        if any(not (character.isalnum() or character in "-_.") for character in name):
            raise SmartTouchError(
                f"{parameter} {name!r} becomes part of a file's name: use letters, digits, - and _"
            )
    named = "-".join(part for part in (participant, session, experiment) if part)
    return named, zlib.crc32(f"{participant}/{session}".encode()) % 10_000


def numbered(path: Path) -> Path:
    """Return the path. If the file exists, return the path with the next free number."""
    names = (path.with_stem(f"{path.stem}-{number}") for number in count(2))
    return (
        next(candidate for candidate in names if not candidate.exists()) if path.exists() else path
    )
