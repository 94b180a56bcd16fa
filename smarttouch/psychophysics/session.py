"""A session: the trials of a procedure, and the file of its answers."""

import math

from smarttouch.errors import ExperimentError
from smarttouch.psychophysics.procedures.procedure import Condition, Procedure
from smarttouch.psychophysics.rows import RowFile, TrialRow
from smarttouch.psychophysics.trial import Answer, Task, Trial
from smarttouch.version import __version__

_SAME = 1e-6
"""Relative difference by which a condition may change when written and read."""


class Session:
    """Session that supplies trials, and writes a row for each answer before the next one.

    The file is all that is remembered: its answers are given again to a fresh procedure of the same
    arguments, which leads to the trial that comes next. A trial without its row is presented again.
    """

    def __init__(self, task: Task, procedure: Procedure, file: RowFile, date: str) -> None:
        self.title = file.about.experiment
        self._task, self._procedure, self._file, self._date = task, procedure, file, date
        for number, row in enumerate(file.rows):
            if procedure.done or not _same(procedure.next(), row):
                raise ExperimentError(
                    f"{file.path}, trial {number + 1}, is not of this experiment: go on with the "
                    "options it was begun with, overwrite it, or give another file",
                    about="trial",
                    remedy="overwrite or output",
                )
            procedure.answer(row.success)
        self.resumed = len(file.rows)

    @property
    def done(self) -> int:
        """Number of trials that are over."""
        return len(self._file.rows)

    @property
    def total(self) -> int | None:
        """Number of trials; None if it depends on the answers."""
        return self._procedure.total

    @property
    def over(self) -> bool:
        """Whether there is no next trial."""
        return self._procedure.done

    @property
    def rows(self) -> list[TrialRow]:
        """Rows of all answers until now."""
        return self._file.rows

    def next(self) -> Trial | None:
        """Return the next trial; None after the last."""
        return None if self._procedure.done else self._task.trial(self._procedure.next())

    def record(self, trial: Trial, answer: Answer) -> None:
        """Write an answer, and pass it to the procedure."""
        condition = trial.condition
        success = answer.response == trial.success if answer.response else None
        about = self._file.about
        self._file.append(
            TrialRow(
                repetition=condition.repetition,
                trial=condition.trial,
                number=self.done,
                index=condition.index,
                experiment=about.experiment,
                procedure=about.procedure,
                standard=condition.standard if trial.compares else None,
                comparison=condition.comparison if answer.reached is None else answer.reached,
                comparison_interval=condition.comparison_interval or None,
                unit=trial.unit,
                target=trial.target,
                response=answer.response,
                success=success,
                rt=answer.rt_s,
                time_s=round(answer.time_s, 6),
                level=answer.level,
                participant=about.participant,
                session=about.session,
                date=self._date,
                seed=about.seed,
                frame_rate_hz=None,
                version=__version__,
            )
        )
        self._procedure.answer(success)


def _same(condition: Condition, row: TrialRow) -> bool:
    pairs = [(condition.standard, row.standard or 0.0), (condition.comparison, row.comparison)]
    if math.isnan(condition.comparison):
        # How far a current will rise is not known beforehand.
        pairs.pop()
    same_interval = (condition.comparison_interval or None) == row.comparison_interval
    return same_interval and all(
        math.isclose(*each, rel_tol=_SAME, abs_tol=_SAME) for each in pairs
    )
