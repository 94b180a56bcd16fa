"""Plan of a study, what each of its choices shows on a finger, and the rows of its table."""

import csv
import io
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import astuple, dataclass, fields
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, field_validator, model_validator

from smarttouch.base.afferent import Afferent, Mode
from smarttouch.imaging.array_window import profile_for_reading
from smarttouch.kernels.bank import KernelBank, load_bank
from smarttouch.physiology.anatomy import Anatomy, load_anatomy
from smarttouch.physiology.finger import Finger
from smarttouch.physiology.response import ResponseQuality
from smarttouch.profile import Profile, load_profile
from smarttouch.profile.toml_tables import Table, UnfitError, load_model
from smarttouch.reading.legibility import (
    Legibility,
    LineDelivery,
    NerveReading,
    legibility_of_shapes,
    legibility_on_finger,
    letter_sequences,
    letter_templates,
    letters_on_finger,
)
from smarttouch.reading.letter_shapes import ALPHABET, Shapes
from smarttouch.reading.material import ReadingMaterial
from smarttouch.running.config import RunConfig
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
    letters: str = ALPHABET
    """Letters shown on the fingers; none if empty."""
    pages: tuple[str, ...] = Field(default=(), max_length=1000)
    """Pages shown on the fingers, as for ``smarttouch read``."""

    @model_validator(mode="after")
    def _something_felt(self) -> Self:
        if not (self.letters or self.pages):
            raise UnfitError(
                "letters is empty and there are no pages: give one of them", key="letters"
            )
        return self

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
    pattern: str  # a letter, or the name of a page
    read_as: str  # letter that was read of the spikes; nothing for a page
    # 1 where a letter was read as another, else 0; of a page the error rate of characters
    error: float
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

    @classmethod
    def of(
        cls,
        choice: Choice,
        anatomy: str,
        finger: int,
        pattern: str,
        quality: ResponseQuality | NerveReading,
        current_ua: Sequence[NDArray[np.int16]],
        error: float,
        read_as: str = "",
    ) -> "StudyRow":
        """Return the row of one response; of a page nothing is counted. Currents are (S, E) µA
        each."""
        letter = quality if isinstance(quality, ResponseQuality) else None
        ra, sai, pc = (letter.afferents[each] if letter else 0 for each in Afferent)
        slots = sum(map(len, current_ua))
        total_ua = sum(int(np.abs(each.astype(np.int64)).sum()) for each in current_ua)
        return cls(
            choice.profile, anatomy, finger, choice.mode, choice.scan, choice.intensity, pattern,
            read_as, error, quality.silent_points, quality.wrong_class, quality.misplaced,
            letter.spikes if letter else 0, ra, sai, pc, slots, total_ua / 2000 / max(1, slots),
        )  # fmt: skip


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
    """What one finger after another feels, and what makes rows of it."""

    profile: Profile
    digest: str  # hash of all that the rows depend on, but for the profile and the finger
    # makes ready what fingers share, and returns the function of an anatomy, its name and a seed
    ready: Callable[[], Callable[[Anatomy, str, int], list[StudyRow]]]


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
        self._banks: dict[str, KernelBank] = {}

    def fingers(self) -> Iterator[tuple[Anatomy, str, int]]:
        """Yield the anatomy, its name and the seed of each finger."""
        for name in self.study.anatomies:
            anatomy = load_anatomy(self.file(name))
            for seed in range(1, self.study.fingers + 1):
                yield anatomy, name, seed

    def file(self, name: str) -> str | Path:
        """Return a file that lies beside the study, or the name as it is."""
        there = self._beside / name
        try:
            return there if there.is_file() else name
        except (OSError, ValueError):
            # A text, and no name of a file: too long, say.
            return name

    def bank(self, profile: str) -> KernelBank:
        """Return the kernels of a profile."""
        if profile not in self._banks:
            self._banks[profile] = load_bank(self.profiles[profile], self._progress)
        return self._banks[profile]

    def choices(self, profiles: Sequence[str] | None = None) -> Iterator[Choice]:
        """Yield the choices of some profiles, or of all, in the order of the table."""
        study = self.study
        for each in product(
            profiles or study.profiles, study.modes, study.scans, study.intensities
        ):
            yield Choice(*each)

    def shown(self) -> Iterator[Shown]:
        """Yield the letters of each profile, and then each page in each choice."""
        if self.study.letters:
            for name, profile in self.profiles.items():
                letters = self.letters(name)
                ready = partial(partial, rows_of_letters, profile, letters)
                yield Shown(profile, _hash(letters), ready)
        for page in self.study.pages:
            for choice in self.choices():
                yield self._page(choice, page)

    def letters(self, profile: str) -> list[tuple[Choice, Letters]]:
        """Return the letters as each choice with this profile delivers them."""
        return [
            (
                choice,
                letter_sequences(
                    self.study.letters, self.profiles[profile], self.bank(profile),
                    Mode(choice.mode), choice.scan, choice.intensity,
                ),
            )
            for choice in self.choices([profile])
        ]  # fmt: skip

    def _page(self, choice: Choice, page: str) -> Shown:
        profile, bank, place = (
            self.profiles[choice.profile],
            self.bank(choice.profile),
            self.file(page),
        )
        content = Path(place).read_bytes() if isinstance(place, Path) else b""
        kernels = [bank.kernels(each) for each in sorted(bank.weights)]

        def ready() -> Callable[[Anatomy, str, int], list[StudyRow]]:
            window = profile_for_reading(profile)
            sharing = RunConfig(scan=choice.scan).sharing(window)
            reading = LineDelivery(
                window, bank, _SHAPES.tone, _SHAPES.motion(window), Mode(choice.mode), sharing,
                choice.intensity,
            )  # fmt: skip
            # The truth is the text that Tesseract reads of the page itself.
            source = ReadingMaterial(str(place))
            found = legibility_of_shapes(source, reading, source.words)
            return partial(rows_of_page, found, reading, choice, page)

        return Shown(profile, _hash((choice, page, content, kernels)), ready)


_SHAPES = Shapes(graded=True)


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
                current_ua, error = letters[one.letter][0].current_ua, one.read_as != one.letter
                rows.append(
                    StudyRow.of(
                        choice, name, seed, one.letter, one.quality, [current_ua], float(error),
                        one.read_as,
                    )
                )  # fmt: skip
    return rows


def rows_of_page(
    found: Legibility,
    reading: LineDelivery,
    choice: Choice,
    page: str,
    anatomy: Anatomy,
    name: str,
    seed: int,
) -> list[StudyRow]:
    """Return what one finger reads of a page that was delivered; counts are not taken."""
    from threadpoolctl import threadpool_limits

    with threadpool_limits(limits=1, user_api="blas"):
        quality, error = legibility_on_finger(found, reading, seed, anatomy)
    slots = [line.current_ua for lines, _ in found.delivered for line in lines]
    return [StudyRow.of(choice, name, seed, page, quality, slots, error)]
