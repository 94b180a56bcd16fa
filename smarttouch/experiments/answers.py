"""Answers to be fitted, and their reader from CSV files."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.errors import ExperimentError
from smarttouch.experiments.answer_file import read_cells
from smarttouch.experiments.psychometric import Array, Counts, Guess, Model


@dataclass(frozen=True, eq=False)
class Answers:
    """All trials of one standard, in their order."""

    standard: float  # standard of the comparison; 0 if there is none
    comparison: Array  # (N,): in the same unit
    success: Array  # (N,): 1 judged higher, felt, or right; 0 not; NaN no answer
    # (N,): of the comparison, 1 or 2; 0 where there are no two intervals
    interval: NDArray[np.int64]
    alternatives: int = 0  # number of alternatives; 0 if *yes* and *no*, or not known

    @property
    def presented(self) -> int:
        """Number of trials."""
        return len(self.success)

    @property
    def answered(self) -> int:
        """Number of trials with an answer."""
        return int(np.isfinite(self.success).sum())

    def chosen(self) -> tuple[int, int]:
        """Return the number of answers for the first of two intervals, and for the second."""
        two = np.isfinite(self.success) & (self.interval > 0)
        chosen = np.where(self.success == 1, self.interval, 3 - self.interval)[two]
        return int((chosen == 1).sum()), int((chosen == 2).sum())

    def counts(self) -> Counts:
        """Return trials and successes at each comparison; trials without an answer are left out."""
        given = np.isfinite(self.success)
        stimulus, which = np.unique(self.comparison[given], return_inverse=True)
        n, k = np.zeros(len(stimulus)), np.zeros(len(stimulus))
        np.add.at(n, which, 1.0)
        np.add.at(k, which, self.success[given])
        return Counts(stimulus, n, k)


def usual_model(
    all_answers: Sequence[Answers],  # to all standards
    # if None: with a standard, or comparisons on both sides of 0, *equal*; else one of the
    # alternatives; else of *felt*, free if some trials showed nothing, and 0 if none did
    guess: Guess | None = None,
    at: float | None = None,  # as for `Model`
) -> Model:
    """Return the model that belongs to the answers of one experiment."""
    stimulus = np.concatenate([each.comparison for each in all_answers])
    signed = bool((stimulus < 0).any())
    if guess is None:
        alternatives = max(each.alternatives for each in all_answers)
        if signed or any(each.standard for each in all_answers):
            guess = "equal"
        elif alternatives:
            guess = 1 / alternatives
        else:
            guess = "free" if (stimulus == 0).any() else 0.0
    return Model(guess, at, logarithmic=not signed)


@dataclass(frozen=True, eq=False)
class AnswerTable:
    """The answers of one file."""

    name: str  # of the file, without its ending
    unit: str  # of standards and comparisons, if stated
    answers: tuple[Answers, ...]  # to each standard, rising
    cut: bool = False  # whether a last line that is not whole was left out


def read_table(
    path: Path,
    # x, y, standard: columns of comparison, success and standard; the last need not be there. The
    # interval of the comparison (`comparison_interval`) and the words answered (`response`) are
    # used if there are such columns.
    x: str = "comparison",
    y: str = "success",
    standard: str = "standard",
) -> AnswerTable:
    """Read comparisons and answers, see `parse_cells`.

    An answer is 1, true, yes, correct or their contraries; an empty cell is none.
    """
    table = read_cells(path)
    for option, name in (("x", x), ("y", y), ("standard", standard)):
        if name not in table.head and name != "standard":
            raise ExperimentError(
                f"{path} has no column {name!r} for {option}: choose {' or '.join(table.head)}"
            )

    def number(line: int, column: str) -> float:
        return table.number(line, column) if table.lines[line][1].get(column, "").strip() else 0.0

    if not table.lines:
        raise ExperimentError(f"{path} has no trials below its first line: give one that has")
    rows = np.array([
        (number(line, standard), table.number(line, x), table.success(line, y),
         number(line, "comparison_interval"))
        for line in range(len(table.lines))
    ])  # fmt: skip
    cells = [each for _, each in table.lines]
    alternatives = _alternatives(cells)
    found = []
    for each in np.unique(rows[:, 0]):
        _, comparison, success, interval = rows[rows[:, 0] == each].T
        found.append(
            Answers(float(each), comparison, success, interval.astype(np.int64), alternatives)
        )
    units = {each.get("unit", "").strip() for each in cells}
    return AnswerTable(path.stem, units.pop() if len(units) == 1 else "", tuple(found), table.cut)


def _alternatives(lines: list[dict[str, str]]) -> int:
    """Return the number of alternatives; 0 if *yes* and *no*, or not known."""
    if any(cells.get("comparison_interval") for cells in lines):
        return 2
    said = {cells.get("response", "") for cells in lines}
    shown = {cells.get("target", "") for cells in lines} if said - {""} else set()
    return 0 if said - {""} <= {"y", "n"} else max(2, len(said | shown - {""}))
