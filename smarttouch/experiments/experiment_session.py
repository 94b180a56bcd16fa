"""Session of an experiment: its trials, the file of its answers, and its summary."""

import contextlib
import math
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime
from itertools import count
from pathlib import Path

from smarttouch.base.errors import ExperimentError, SmartTouchError
from smarttouch.experiments.answers import AnswerFile, Row, Value
from smarttouch.experiments.catalog import trials_of
from smarttouch.experiments.observers import FITTED, Observer
from smarttouch.experiments.procedures import LIMITS, middle_and_spread
from smarttouch.experiments.trial_source import TrialSource
from smarttouch.experiments.trials import Answer, Setup, Trial, Trials

_SAME = 1e-6  # relative error of a condition after it was written and read


@dataclass
class ExperimentSession:
    """One run of an experiment: the remaining trials and the file of answers.

    To resume, the answers in the file are sent again to the generator of trials, which is
    deterministic and so arrives at the next trial. A trial without a row is repeated.
    """

    setup: Setup
    file: AnswerFile
    title: str
    resumed: int  # trials of earlier runs
    _trials: Trials
    _next: Trial | None  # None at the end
    _date: str  # start of the session

    @property
    def over(self) -> bool:
        """Whether all trials are done."""
        return self._next is None

    def source(self, observer: Observer | None = None) -> TrialSource:
        """Return the source of stimuli; an observer, if given, answers in place of a person."""
        setup = self.setup
        source = TrialSource(
            self._recorded(), setup.profile, self.title, done=self.resumed, total=setup.total,
            gap_s=setup.gap_s, answer_s=setup.answer_s, observer=observer,
        )  # fmt: skip
        source.url = f"experiment:{self.title}"
        return source

    def _recorded(self) -> Trials:
        """Yield the remaining trials; each answer is on disk before the next trial."""
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
        """Yield lines that introduce the session; ``modeled`` says if the participant is
        simulated."""
        total = "" if self.setup.total is None else f" of {self.setup.total}"
        if self.resumed and not self.over:
            yield f"continues at trial {self.resumed + 1}{total}: {self.file.path}"
        yield from self.setup.notes
        if modeled and self._next is not None and self._next.task == "faster":
            yield FITTED

    def after(self) -> Iterator[str]:
        """Yield lines about the answers so far and the next command."""
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
                middle, spread = middle_and_spread([_number(success) for success in successes])
                yield f"enough at {middle:.3f} mA (spread {spread:.3f}), {len(successes)} times"
            if len(successes) < len(rows):
                yield f"{len(rows) - len(successes)} times it was never enough"
        elif missing < len(rows):
            yield f"fit it: smarttouch experiment fit {self.file.path}"


@contextlib.contextmanager
def open_experiment(
    name: str, setup: Setup, path: Path, participant: str = "", session: str = ""
) -> Iterator[ExperimentSession]:
    """Open an experiment's file of answers, and continue where it ends.

    ``name`` is an experiment or its file, see `find_experiment`.
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
                    f"{path}, trial {number + 1}, is not from this experiment: continue with the "
                    "options of its first run, remove the file, or give another --output"
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
    # The comparison is NaN if the trial itself determines it.
    if not math.isnan(condition.comparison):
        pairs.append((condition.comparison, _number(row)))
    interval = condition.comparison_interval or None
    return interval == row["comparison_interval"] and all(
        math.isclose(one, float(other), rel_tol=_SAME, abs_tol=_SAME) for one, other in pairs
    )


def _number(row: Row) -> float:
    return float(row["comparison"] or 0.0)


def experiment_name(name: str, setup: Setup) -> str:
    """Return the experiment's name in its file: name and class."""
    return f"{Path(name).stem}-{setup.afferent.name}"


def session_name(experiment: str, participant: str, session: str) -> tuple[str, int]:
    """Return the file name of a session, without ending, and the seed of its random orders."""
    for parameter, name in (("participant", participant), ("session", session)):
        if any(not (character.isalnum() or character in "-_.") for character in name):
            raise SmartTouchError(
                f"{parameter} {name!r} becomes part of a file's name: use letters, digits, - and _"
            )
    named = "-".join(part for part in (participant, session, experiment) if part)
    return named, zlib.crc32(f"{participant}/{session}".encode()) % 10_000


def numbered(path: Path) -> Path:
    """Return a free path: the given one, or one with the next number."""
    names = (path.with_stem(f"{path.stem}-{number}") for number in count(2))
    return (
        next(candidate for candidate in names if not candidate.exists()) if path.exists() else path
    )
