"""Rows of a study: what one finger feels of one pattern in one choice."""

import csv
import io
from collections.abc import Iterable, Sequence
from dataclasses import astuple, dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from smarttouch.afferent import Afferent
from smarttouch.physiology.anatomy import Anatomy
from smarttouch.physiology.felt import Felt
from smarttouch.physiology.finger import Finger
from smarttouch.profile import Profile
from smarttouch.psychophysics.letters_felt import letter_templates, letters_on_finger
from smarttouch.reading.nerve import NerveReading
from smarttouch.studies.grid import Choice, Shown


@dataclass(frozen=True)
class Row:
    """One finger and one pattern."""

    # profile, anatomy, finger, kernels, mode, scan, intensity: what was chosen; the finger is its
    # seed
    profile: str
    anatomy: str
    finger: int
    kernels: str
    mode: str
    scan: str
    intensity: float
    pattern: str  # a letter, or the name of a page
    read_as: str  # letter that was read of the spikes; nothing for a page
    # 1 where a letter was read as another, else 0; of a page the error rate of characters
    error: float
    # silent_points, wrong_class, misplaced: see `felt.Felt`; NaN without a spike
    silent_points: float
    wrong_class: float
    misplaced: float
    spikes: int  # all spikes of a letter in ten periods
    # ra, sai, pc: afferents that fired
    ra: int
    sai: int
    pc: int
    slots: int  # slots of a period
    total_ma: float  # mean total current of a slot

    @classmethod
    def of(
        cls, choice: Choice, anatomy: str, finger: int, pattern: str, felt: Felt | NerveReading,
        current_ua: Sequence[NDArray[np.int16]], error: float, read_as: str = "",
    ) -> "Row":  # fmt: skip
        """Return the row of one response; of a page nothing is counted. Currents are (S, E) µA
        each."""
        letter = felt if isinstance(felt, Felt) else None
        ra, sai, pc = (letter.afferents[each] if letter else 0 for each in Afferent)
        slots = sum(map(len, current_ua))
        total_ua = sum(int(np.abs(each.astype(np.int64)).sum()) for each in current_ua)
        return cls(
            choice.profile, anatomy, finger, choice.kernels, choice.mode, choice.scan,
            choice.intensity, pattern, read_as, error, felt.silent_points, felt.wrong_class,
            felt.misplaced, letter.spikes if letter else 0, ra, sai, pc, slots,
            total_ua / 2000 / max(1, slots),
        )  # fmt: skip


HEADING = tuple(each.name for each in fields(Row))
_KINDS = {"str": str, "int": int, "float": float}
"""Kinds of the columns by their names."""


def rows_of_finger(
    profile: Profile, anatomy: Anatomy, name: str, seed: int, shown: Sequence[Shown]
) -> list[Row]:
    """Return the rows of one finger for all letters in all choices of its profile."""
    from threadpoolctl import threadpool_limits

    known, rows = letter_templates(profile), []
    # One finger is one piece of work: the same numbers wherever it is done.
    with threadpool_limits(limits=1, user_api="blas"):
        finger = Finger(profile, seed, anatomy)
        for each in shown:
            for one in letters_on_finger(finger, each.letters, each.wanted, known):
                current_ua, letter = each.letters[one.letter][0].current_ua, one.letter
                error = float(one.read_as != letter)
                rows.append(
                    Row.of(
                        each.choice, name, seed, letter, one.felt, [current_ua], error, one.read_as
                    )
                )
    return rows


def as_csv(rows: Iterable[Row]) -> str:
    """Return rows as CSV with a heading; numbers read back as they were."""
    text = io.StringIO(newline="")
    writer = csv.writer(text)
    writer.writerow(HEADING)
    writer.writerows(astuple(row) for row in rows)
    return text.getvalue()


def from_csv(text: str) -> list[Row]:
    """Return the rows of a CSV text; ValueError if it is none of a study."""
    heading, *lines = csv.reader(io.StringIO(text, newline=""))
    if tuple(heading) != HEADING:
        raise ValueError("its columns are others")
    kinds: list[Any] = [_KINDS[getattr(each.type, "__name__", "")] for each in fields(Row)]
    return [Row(*(kind(cell) for kind, cell in zip(kinds, line, strict=True))) for line in lines]
