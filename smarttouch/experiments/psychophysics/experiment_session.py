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
from smarttouch.base.version import __version__
from smarttouch.experiments.fitting.answers import read_table, usual_model
from smarttouch.experiments.fitting.findings import in_words, judge_answers
from smarttouch.experiments.psychophysics.catalog import LIMITS, Design
from smarttouch.experiments.psychophysics.experiment_source import ExperimentSource
from smarttouch.experiments.psychophysics.perceived_spikes import FITTED
from smarttouch.experiments.psychophysics.procedures import (
    Condition,
    middle_and_spread,
)
from smarttouch.experiments.psychophysics.simulated_subject import Subject, make_observer
from smarttouch.experiments.psychophysics.tasks import FrequencyTask
from smarttouch.experiments.psychophysics.trial_rows import About, RowFile, TrialRow
from smarttouch.experiments.psychophysics.trials import Answer, Trial, TrialTiming
from smarttouch.profile import Profile

_SAME = 1e-6  # relative difference by which a condition may change when written and read


class TrialSession:
    """Session that supplies trials, and writes a row for each answer before the next one.

    The file is all that is remembered: its answers are given again to a fresh procedure of the same
    arguments, which leads to the trial that comes next. A trial without its row is presented again.
    """

    def __init__(self, design: Design, file: RowFile, date: str) -> None:
        self.title: str = file.about.experiment
        self.total: int | None = design.total  # trials; None if it depends on the answers
        self._task, self._procedure = design.task, design.procedure
        self._file, self._date = file, date
        self._condition: Condition | None = next(design.procedure, None)
        for number, row in enumerate(file.rows):
            if self._condition is None or not _same(self._condition, row):
                raise ExperimentError(
                    f"{file.path}, trial {number + 1}, is not of this experiment: go on with the "
                    "options it was begun with, remove the file, or give another --output"
                )
            self._answer(row.success)
        self.resumed: int = len(file.rows)

    @property
    def done(self) -> int:
        """Number of trials that are over."""
        return len(self._file.rows)

    @property
    def over(self) -> bool:
        """Whether there is no next trial."""
        return self._condition is None

    @property
    def rows(self) -> list[TrialRow]:
        """Rows of all answers until now."""
        return self._file.rows

    def next(self) -> Trial | None:
        """Return the next trial; None after the last."""
        return None if self._condition is None else self._task.trial(self._condition)

    def record(self, trial: Trial, answer: Answer) -> None:
        """Write an answer, and pass it to the procedure."""
        condition = trial.condition
        success = answer.response == trial.success if answer.response else None
        about = self._file.about
        self._file.append(TrialRow(
            repetition=condition.repetition, trial=condition.trial, number=self.done,
            index=condition.index, experiment=about.experiment, procedure=about.procedure,
            standard=condition.standard if trial.compares else None,
            comparison=condition.comparison if answer.reached is None else answer.reached,
            comparison_interval=condition.comparison_interval or None, unit=trial.unit,
            target=trial.target, response=answer.response, success=success, rt=answer.rt_s,
            time_s=round(answer.time_s, 6), level=answer.level, participant=about.participant,
            session=about.session, date=self._date, seed=about.seed, frame_rate_hz=None,
            version=__version__,
        ))  # fmt: skip
        self._answer(success)

    def _answer(self, success: bool | None) -> None:
        try:
            self._condition = self._procedure.send(success)
        except StopIteration:
            self._condition = None


def _same(condition: Condition, row: TrialRow) -> bool:
    pairs = [(condition.standard, row.standard or 0.0), (condition.comparison, row.comparison)]
    if math.isnan(condition.comparison):
        # How far a current will rise is not known beforehand.
        pairs.pop()
    same_interval = (condition.comparison_interval or None) == row.comparison_interval
    return same_interval and all(
        math.isclose(*each, rel_tol=_SAME, abs_tol=_SAME) for each in pairs
    )


def summarize(design: Design, session: TrialSession, path: Path) -> list[str]:
    """Return a few lines about the answers until now, and the next command."""
    rows = session.rows
    lines = [_progress(session)]
    answered = [row for row in rows if row.success is not None]
    if design.method == LIMITS:
        enough = [row.comparison for row in rows if row.success]
        if enough:
            middle, spread = middle_and_spread(enough)
            lines.append(f"enough at {middle:.3f} mA (spread {spread:.3f}), {len(enough)} times")
        if len(enough) < len(rows):
            lines.append(f"{len(rows) - len(enough)} times it was never enough")
        return lines
    if answered:
        lines += _thresholds(path)
    if answered:
        lines.append(f"fit it: smarttouch experiment fit {path}")
    return lines


def _progress(session: TrialSession) -> str:
    total = "" if session.total is None else f" of {session.total}"
    missing = sum(row.success is None for row in session.rows)
    without = f", {missing} of them without an answer" if missing else ""
    before = f" ({session.resumed} in earlier runs)" if session.resumed else ""
    rest = "" if session.over else "; the same command goes on there"
    return f"{session.done}{total} trials{before}{without}{rest}"


def _thresholds(path: Path) -> list[str]:
    """Return the thresholds of the answers, a line for each standard that has one."""
    table = read_table(path)
    model = usual_model(table.answers)
    found = [judge_answers(each, model) for each in table.answers]
    return [
        f"threshold {in_words(each.threshold)} {table.unit}, {each.answers.answered} trials"
        for each in found
        if each.threshold is not None
    ]


@dataclass(frozen=True)
class ExperimentSession:
    """One run of an experiment."""

    made: Design
    session: TrialSession
    profile: Profile
    course: TrialTiming
    path: Path  # file of the answers

    def source(self) -> ExperimentSource:
        """Return the source of its stimuli."""
        source = ExperimentSource(self.session, self.profile, self.course)
        source.url = f"experiment:{self.session.title}"
        return source

    def subject(
        self,
        source: ExperimentSource,
        simulate: str,
        seed: int,
        finger: int = 1,
        anatomy: str | Path = "paper",
    ) -> Subject:
        """Return a listener who answers in place of a person, with a finger by its seed."""
        observer = make_observer(
            simulate, self.profile, seed + self.session.resumed, finger, anatomy
        )
        return Subject(source, observer)

    def before(self, modeled: bool = False) -> Iterator[str]:
        """Yield lines that introduce the session, with a modeled participant or another."""
        session = self.session
        total = "" if session.total is None else f" of {session.total}"
        if session.resumed and not session.over:
            yield f"goes on at trial {session.resumed + 1}{total}: {self.path}"
        yield from self.made.notes
        if modeled and not session.over and isinstance(self.made.task, FrequencyTask):
            yield FITTED

    def after(self) -> list[str]:
        """Return lines on the progress of the session."""
        return summarize(self.made, self.session, self.path)


@contextlib.contextmanager
def open_experiment(
    made: Design,
    profile: Profile,
    course: TrialTiming,
    about: About,
    path: Path,
) -> Iterator[ExperimentSession]:
    """Open the file of an experiment's answers for a block, and go on where it ends."""
    with RowFile(path, about) as file:
        begun = datetime.now().astimezone().isoformat(timespec="seconds")
        session = TrialSession(made, file, begun)
        yield ExperimentSession(made, session, profile, course, path)


def parse_standards(text: str | None) -> tuple[float, ...] | None:
    """Return the frequencies that ``15,30`` names, in Hz."""
    if text is None:
        return None
    try:
        standards = tuple(float(each) for each in text.split(","))
    except ValueError:
        standards = ()
    if not standards or not all(0 < each < 1e6 for each in standards):
        message = f"standards {text!r} are not understood: give frequencies in Hz, as in 15,30,45"
        raise SmartTouchError(message)
    return tuple(dict.fromkeys(standards))


def session_name(experiment: str, participant: str, session: str) -> tuple[str, int]:
    """Return what an experiment's file is called without ending, and the seed of its orders."""
    for parameter, name in (("participant", participant), ("session", session)):
        if any(not (each.isalnum() or each in "-_.") for each in name):
            raise SmartTouchError(
                f"{parameter} {name!r} becomes part of a file's name: use letters, digits, - and _"
            )
    named = "-".join(each for each in (participant, session, experiment) if each)
    return named, zlib.crc32(f"{participant}/{session}".encode()) % 10_000


def numbered(path: Path) -> Path:
    """Return a file's name with the next number, if there is one of that name."""
    names = (path.with_stem(f"{path.stem}-{number}") for number in count(2))
    return next(each for each in names if not each.exists()) if path.exists() else path
