"""Plan of a study: a TOML file of what is compared, on which fingers."""

from pathlib import Path
from typing import Literal, Self

from pydantic import Field, field_validator, model_validator

from smarttouch.profile.complaints import load_model
from smarttouch.profile.table import Table, UnfitError
from smarttouch.psychophysics.letters import ALPHABET


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
    """Letters that are felt; none if empty."""
    pages: tuple[str, ...] = Field(default=(), max_length=1000)
    """Pages that are felt, as for ``smarttouch read``."""

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
