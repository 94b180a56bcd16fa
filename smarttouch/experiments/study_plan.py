"""Plan of a study, what each of its choices shows on a finger, and the rows of its table."""

import csv
import io
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import astuple, dataclass, fields
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, field_validator

from smarttouch.base.afferent import Afferent, Mode
from smarttouch.kernels.bank import load_bank
from smarttouch.physiology.anatomy import Anatomy, load_anatomy
from smarttouch.physiology.finger import Finger
from smarttouch.profile import Profile, load_profile
from smarttouch.profile.toml_tables import Table, UnfitError, load_model
from smarttouch.reading.legibility import (
    letter_sequences,
    letter_templates,
    letters_on_finger,
)
from smarttouch.reading.letter_shapes import ALPHABET
from smarttouch.stimulation.scan_sequence import ScanSequence


class Study(Table):
    """A grid: each finger of each anatomy, with each of everything else."""

    title: str = Field(min_length=1)
    """What is asked."""
    profiles: tuple[str, ...] = Field(default=("electric-mouse",), min_length=1, max_length=100)
    """Names or files of profiles."""
    anatomies: tuple[str, ...] = Field(default=("paper", "branched"), min_length=1, max_length=100)
    """Names or files of anatomies."""
    fingers: int = Field(default=10, ge=1, le=100_000)
    """Number of fingers of each anatomy, by seeds from 1 on."""
    modes: tuple[Literal["RA", "SAI", "PC", "natural"], ...] = Field(default=("RA",), min_length=1)
    """Whose receptors."""
    scans: tuple[Literal["points", "auto"], ...] = Field(default=("points",), min_length=1)
    """How points share slots."""
    intensities: tuple[float, ...] = Field(default=(1.0,), min_length=1, max_length=100)
    """Parts of the strongest comfortable current."""
    letters: str = Field(default=ALPHABET, min_length=1)
    """Letters shown on the fingers."""

    @field_validator("letters")
    @classmethod
    def _known(cls, letters: str) -> str:
        letters = "".join(dict.fromkeys(letters.upper()))
        if set(letters) - set(ALPHABET):
            raise UnfitError(f"letters {letters!r} must be from A to Z, as in T or AEIOU")
        return letters

    @field_validator("intensities")
    @classmethod
    def _possible(cls, intensities: tuple[float, ...]) -> tuple[float, ...]:
        for each in intensities:
            if not 0 < each <= 1:
                raise UnfitError(f"intensity {each:g} must be above 0 and at most 1")
        return intensities


def load_study(path: Path) -> Study:
    """Load the plan of a study."""
    return load_model(path, Study)


Advance = Callable[[int, int], None]
Letters = Mapping[str, tuple[ScanSequence, NDArray[np.bool_]]]  # slots, electrodes (E,)


@dataclass(frozen=True)
class Choice:
    """One choice of everything but the finger."""

    # profile, mode, scan: as the study names them
    profile: str
    mode: str
    scan: str
    intensity: float


@dataclass(frozen=True)
class StudyRow:
    """One finger and one pattern."""

    # profile, anatomy, finger, mode, scan, intensity: what was chosen; the finger is its seed
    profile: str
    anatomy: str
    finger: int
    mode: str
    scan: str
    intensity: float
    pattern: str  # the letter
    read_as: str  # letter that was read of the spikes
    error: float  # 1 where it was read as another, else 0
    # silent_points, wrong_class, misplaced: see `ResponseQuality`; NaN without a spike
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


HEADING = tuple(each.name for each in fields(StudyRow))
_KINDS = {"str": str, "int": int, "float": float}  # kinds of the columns by their names


def as_csv(rows: Iterable[StudyRow]) -> str:
    """Return rows as CSV with a heading; numbers read back as they were."""
    text = io.StringIO(newline="")
    writer = csv.writer(text)
    writer.writerow(HEADING)
    writer.writerows(astuple(row) for row in rows)
    return text.getvalue()


def from_csv(text: str) -> list[StudyRow]:
    """Return the rows of a CSV text; ValueError if they are not of a study."""
    heading, *lines = csv.reader(io.StringIO(text, newline=""))
    if tuple(heading) != HEADING:
        raise ValueError("its columns are others")
    kinds: list[Any] = [_KINDS[getattr(each.type, "__name__", "")] for each in fields(StudyRow)]
    return [
        StudyRow(*(kind(cell) for kind, cell in zip(kinds, line, strict=True))) for line in lines
    ]


@dataclass(frozen=True)
class Shown:
    """The letters of one profile, and what makes rows of them on one finger after another."""

    profile: Profile
    digest: str  # hash of all that the rows depend on, but for the profile and the finger
    # returns the rows of an anatomy, its name and a seed
    made: Callable[[Anatomy, str, int], list[StudyRow]]


class Grid:
    """Profiles and banks of a study, and what it shows.

    Files are named from the folder `beside`; `progress` is called with the number of sites of a
    bank that are designed, and of all, if any have to be.
    """

    def __init__(self, study: Study, beside: Path, progress: Advance | None = None) -> None:
        self.study: Study = study
        self._beside, self._progress = beside, progress
        self.profiles: dict[str, Profile] = {
            each: load_profile(self.file(each)) for each in study.profiles
        }

    def fingers(self) -> Iterator[tuple[Anatomy, str, int]]:
        """Yield the anatomy, its name and the seed of each finger."""
        for name in self.study.anatomies:
            anatomy = load_anatomy(self.file(name))
            for seed in range(1, self.study.fingers + 1):
                yield anatomy, name, seed

    def file(self, name: str) -> str | Path:
        """Return a file that lies beside the study, or the name as it is."""
        there = self._beside / name
        return there if os.path.isfile(there) else name  # noqa: PTH113, as it takes any name

    def shown(self) -> Iterator[Shown]:
        """Yield the letters of each profile."""
        for name, profile in self.profiles.items():
            letters = self.letters(name)
            yield Shown(profile, _hash(letters), partial(rows_of_letters, profile, letters))

    def letters(self, profile: str) -> list[tuple[Choice, Letters]]:
        """Return the letters as each choice with this profile delivers them."""
        study, bank = self.study, load_bank(self.profiles[profile], self._progress)
        choices = (
            Choice(profile, *each) for each in product(study.modes, study.scans, study.intensities)
        )
        return [
            (
                choice,
                letter_sequences(
                    study.letters, self.profiles[profile], bank, Mode(choice.mode), choice.scan,
                    choice.intensity,
                ),
            )
            for choice in choices
        ]  # fmt: skip


def _hash(parts: object) -> str:
    import joblib

    return str(joblib.hash(parts))


def rows_of_letters(
    profile: Profile,
    shown: Sequence[tuple[Choice, Letters]],
    anatomy: Anatomy,
    name: str,
    seed: int,
) -> list[StudyRow]:
    """Return the rows of one finger for all letters in all choices of its profile."""
    from threadpoolctl import threadpool_limits

    known, rows = letter_templates(profile), []
    # One finger is one piece of work: the same numbers wherever it is done.
    with threadpool_limits(limits=1, user_api="blas"):
        finger = Finger(profile, seed, anatomy)
        for choice, letters in shown:
            for one in letters_on_finger(finger, letters, Mode(choice.mode).afferents, known):
                current_ua = letters[one.letter][0].current_ua
                total_ua = np.abs(current_ua.astype(np.int64)).sum()
                quality, slots = one.quality, len(current_ua)
                ra, sai, pc = (quality.afferents[each] for each in Afferent)
                rows.append(
                    StudyRow(
                        choice.profile, name, seed, choice.mode, choice.scan, choice.intensity,
                        one.letter, one.read_as, float(one.read_as != one.letter),
                        quality.silent_points, quality.wrong_class, quality.misplaced,
                        quality.spikes, ra, sai, pc, slots,
                        int(total_ua) / 2000 / max(1, slots),
                    )
                )  # fmt: skip
    return rows
