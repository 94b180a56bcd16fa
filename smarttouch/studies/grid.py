"""Grid of a study: what is shown in each of its columns, prepared once for all fingers."""

import hashlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from smarttouch.afferent import Afferent, Mode
from smarttouch.delivered.population import DeliveredSlots
from smarttouch.kernels.bank import KernelBank, load_bank
from smarttouch.profile import Profile, load_profile
from smarttouch.profile.kernels import Kernels
from smarttouch.psychophysics.letters_felt import letter_sequences
from smarttouch.studies.plan import Study

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
class Shown:
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
        self.study, self._beside, self._progress = study, beside, progress
        self.profiles = {each: load_profile(self.file(each)) for each in study.profiles}
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

    def shown(self, profile: str) -> list[Shown]:
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
            found.append(Shown(choice, slots))
        return found
