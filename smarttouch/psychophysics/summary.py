"""Summary at the end of a session, before any fit."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from smarttouch.psychophysics.catalog import LIMITS, Design
from smarttouch.psychophysics.procedures.procedure import Interleaved
from smarttouch.psychophysics.procedures.repeats import middle_and_spread
from smarttouch.psychophysics.rows import TrialRow
from smarttouch.psychophysics.session import Session
from smarttouch.psychophysics.tasks import LetterTask


def summarize(design: Design, session: Session, path: Path) -> list[str]:
    """Return a few lines about the answers until now, and the next command."""
    rows = session.rows
    lines = [_progress(session)]
    answered = [row for row in rows if row.success is not None]
    if isinstance(design.task, LetterTask):
        lines += _letters(answered, list(design.task.drawn))
    elif design.method == LIMITS:
        enough = [row.comparison for row in rows if row.success]
        if enough:
            middle, spread = middle_and_spread(enough)
            lines.append(f"enough at {middle:.3f} mA (spread {spread:.3f}), {len(enough)} times")
        if len(enough) < len(rows):
            lines.append(f"{len(rows) - len(enough)} times it was never enough")
        return lines
    else:
        lines += _estimates(design, rows[0].unit if rows else "")
    if answered:
        lines.append(f"fit it: smarttouch experiment fit {path}")
    return lines


def _progress(session: Session) -> str:
    total = "" if session.total is None else f" of {session.total}"
    missing = sum(row.success is None for row in session.rows)
    without = f", {missing} of them without an answer" if missing else ""
    before = f" ({session.resumed} in earlier runs)" if session.resumed else ""
    rest = "" if session.over else "; the same command goes on there"
    return f"{session.done}{total} trials{before}{without}{rest}"


def _estimates(design: Design, unit: str) -> list[str]:
    """Return the procedure's own estimates, a line for each standard."""
    if isinstance(design.procedure, Interleaved):
        found = design.procedure.estimates()
    else:
        found = [design.procedure.estimate()]
    return [
        f"threshold {each.threshold:.4g} {unit} (spread {each.spread:.2g}), {each.trials} trials"
        for each in found
        if each is not None
    ]


def _letters(answered: Sequence[TrialRow], letters: list[str]) -> list[str]:
    """Return the share correct, and the confusions, a row for each letter."""
    if not answered:
        return []
    right = sum(bool(row.success) for row in answered)
    lines = [
        f"{right} of {len(answered)} right, {right / len(answered):.0%}; by chance "
        f"{1 / len(letters):.0%}"
    ]
    counts = confusion(answered, letters)
    lines.append("shown, and answered as:")
    lines.append("   " + "".join(f"{each:>3}" for each in letters))
    for letter, row in zip(letters, counts.tolist(), strict=True):
        lines.append(f"  {letter}" + "".join(f"{count or '·':>3}" for count in row))
    return lines


def confusion(rows: Sequence[TrialRow], letters: Sequence[str]) -> NDArray[np.int64]:
    """Return how often each letter (row) was answered as each (column), (L, L) int."""
    place = {letter: index for index, letter in enumerate(letters)}
    counts = np.zeros((len(letters), len(letters)), np.int64)
    for row in rows:
        if row.response in place:
            counts[place[row.target], place[row.response]] += 1
    return counts
