"""Rows of a study: the response of one finger to one letter or page in one choice."""

import csv
import hashlib
import io
from collections.abc import Iterable, Sequence
from dataclasses import astuple, dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.afferent import Afferent, Mode
from smarttouch.experiments.study_plan import Choice, DeliveredLetters, Grid
from smarttouch.imaging.array_window import profile_for_reading
from smarttouch.physiology.anatomy import Anatomy
from smarttouch.physiology.finger import Finger
from smarttouch.physiology.response import ResponseQuality
from smarttouch.profile import Profile
from smarttouch.reading.delivered_lines import LineDelivery, NerveReading
from smarttouch.reading.legibility import Legibility, legibility_of_shapes, legibility_on_finger
from smarttouch.reading.letter_responses import letter_templates, letters_on_finger
from smarttouch.reading.letter_shapes import Shapes, Style
from smarttouch.reading.material import ReadingMaterial
from smarttouch.running.config import RunConfig


@dataclass(frozen=True)
class StudyRow:
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
            choice.profile, anatomy, finger, choice.kernels, choice.mode, choice.scan,
            choice.intensity, pattern, read_as, error, quality.silent_points, quality.wrong_class,
            quality.misplaced, letter.spikes if letter else 0, ra, sai, pc, slots,
            total_ua / 2000 / max(1, slots),
        )  # fmt: skip


HEADING = tuple(each.name for each in fields(StudyRow))
_KINDS = {"str": str, "int": int, "float": float}
"""Kinds of the columns by their names."""


def rows_of_finger(
    profile: Profile, anatomy: Anatomy, name: str, seed: int, shown: Sequence[DeliveredLetters]
) -> list[StudyRow]:
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
                    StudyRow.of(
                        each.choice,
                        name,
                        seed,
                        letter,
                        one.quality,
                        [current_ua],
                        error,
                        one.read_as,
                    )
                )
    return rows


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


_SHAPES = Shapes(Style.GRADED)


@dataclass(frozen=True)
class ShownPage:
    """One page in one choice."""

    grid: Grid
    choice: Choice
    page: str  # as the study names it

    @cached_property
    def reading(self) -> LineDelivery:
        profile, bank = self.grid.bank(self.choice)
        window = profile_for_reading(profile)
        sharing = RunConfig(scan=self.choice.scan).sharing(window)
        return LineDelivery(
            window, bank, _SHAPES.tone, _SHAPES.motion(window), Mode(self.choice.mode), sharing,
            self.choice.intensity,
        )  # fmt: skip

    @cached_property
    def delivered(self) -> Legibility:
        """Delivered lines, and the truth: the text that Tesseract reads of the page itself."""
        source = ReadingMaterial(str(self.grid.file(self.page)))
        return legibility_of_shapes(source, self.reading, _SHAPES, source.words)

    def digest(self) -> str:
        """Return a hash of all that its rows depend on, but for the finger."""
        found = hashlib.sha256(repr((self.choice, self.page)).encode())
        place = Path(self.grid.file(self.page))
        found.update(place.read_bytes() if place.is_file() else b"")
        profile, bank = self.grid.bank(self.choice)
        found.update(profile.model_dump_json().encode())
        for each in Afferent:
            if each in bank.weights:
                found.update(bank.kernels(each).tobytes())
        return found.hexdigest()


def row_of_page(
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
