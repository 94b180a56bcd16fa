"""Plan of a study, and the sequences of each of its choices."""

import hashlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, field_validator, model_validator

from smarttouch.base.afferent import Afferent, Mode
from smarttouch.kernels.bank import KernelBank, load_bank
from smarttouch.profile import Profile, load_profile
from smarttouch.profile.device import Kernels
from smarttouch.profile.toml_tables import Table, UnfitError, load_model
from smarttouch.reading.letter_responses import letter_sequences
from smarttouch.reading.letter_shapes import ALPHABET
from smarttouch.running.delivered import DeliveredSlots


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
    kernels: tuple[str, ...] = Field(default=("node",), min_length=1, max_length=100)
    """``node``, ``finger``, or ``finger:ANATOMY`` where that is not the anatomy of the profile."""
    modes: tuple[Literal["RA", "SAI", "PC", "natural"], ...] = Field(default=("RA",), min_length=1)
    """Whose receptors."""
    scans: tuple[Literal["points", "auto", "frame"], ...] = Field(default=("points",), min_length=1)
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
                "letters is empty and there are no pages: give one of them", about="letters"
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
                raise UnfitError(f"intensity {each:g} must be above 0 and at most 1")  # fmt: skip
        return intensities

    @field_validator("kernels")
    @classmethod
    def _offered(cls, kernels: tuple[str, ...]) -> tuple[str, ...]:
        for each in kernels:
            if each not in ("node", "finger") and not each.startswith("finger:"):
                raise UnfitError(
                    f"kernels {each!r} are not offered: give node, finger or finger:ANATOMY"
                )
        return kernels


def load_study(path: Path) -> Study:
    """Load the plan of a study."""
    return load_model(path, Study)


Advance = Callable[[int, int], None]


@dataclass(frozen=True)
class Choice:
    """One choice of everything but the finger."""

    # profile, kernels, mode, scan: as the study names them
    profile: str
    kernels: str
    mode: str
    scan: str
    intensity: float


@dataclass(frozen=True, eq=False)
class DeliveredLetters:
    """Letters as one choice delivers them."""

    choice: Choice
    # slots of each letter, and its electrodes (E,)
    letters: dict[str, tuple[DeliveredSlots, NDArray[np.bool_]]]

    @property
    def wanted(self) -> tuple[Afferent, ...]:
        return Mode(self.choice.mode).afferents

    def digest(self) -> str:
        """Return a hash of all that is delivered."""
        found = hashlib.sha256(repr(self.choice).encode())
        for letter, (slots, active) in self.letters.items():
            found.update(letter.encode() + repr(slots.period_us).encode())
            for each in (slots.current_ua, slots.width_us, slots.discharge_us, active):
                found.update(np.ascontiguousarray(each).tobytes())
        return found.hexdigest()


def choices(study: Study) -> Iterator[Choice]:
    """Yield all choices in the order of the table."""
    for each in product(study.profiles, study.kernels, study.modes, study.scans, study.intensities):
        yield Choice(*each)


class Grid:
    """Profiles, banks and sequences of a study.

    Files are named from the folder `beside`; `progress` is called with the number of sites of a
    bank that are designed, and of all, if any have to be.
    """

    def __init__(self, study: Study, beside: Path, progress: Advance | None = None) -> None:
        self.study: Study = study
        self._beside, self._progress = beside, progress
        self.profiles: dict[str, Profile] = {
            each: load_profile(self.file(each)) for each in study.profiles
        }
        self._banks: dict[tuple[str, str], tuple[Profile, KernelBank]] = {}

    def file(self, name: str) -> str | Path:
        """Return a file that lies beside the study, or the name as it is."""
        there = self._beside / name
        try:
            return there if there.is_file() else name
        except (OSError, ValueError):
            # A text, and no name of a file: too long, say.
            return name

    def bank(self, choice: Choice) -> tuple[Profile, KernelBank]:
        """Return the profile with a choice's objective, and its kernels."""
        key = choice.profile, choice.kernels
        if key not in self._banks:
            profile = self.profiles[choice.profile]
            objective, _, anatomy = choice.kernels.partition(":")
            own = profile.kernels
            wanted = own.model_copy(
                update={"objective": objective, "anatomy": str(self.file(anatomy or own.anatomy))}
            )
            profile = profile.model_copy(
                update={"kernels": Kernels() if objective == "node" else wanted}
            )
            self._banks[key] = profile, load_bank(profile, self._progress)
        return self._banks[key]

    def shown(self, profile: str) -> list[DeliveredLetters]:
        """Return the letters as each choice with this profile delivers them."""
        found = []
        for choice in choices(self.study):
            if choice.profile != profile:
                continue
            letters = letter_sequences(
                self.study.letters, *self.bank(choice), Mode(choice.mode), choice.scan,
                choice.intensity,
            )  # fmt: skip
            slots = {
                letter: (
                    DeliveredSlots(
                        each.current_ua, each.width_us, each.discharge_us, each.period_us
                    ),
                    active,
                )
                for letter, (each, active) in letters.items()
            }
            found.append(DeliveredLetters(choice, slots))
        return found
