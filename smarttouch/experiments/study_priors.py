"""What is not known of a finger: assumptions with their priors, and anatomies drawn from them.

Each assumption has a prior with its source (``priors.toml``). A Latin hypercube draws all of them
at once, so that few draws cover every range evenly. A draw is an anatomy like any other.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationError, model_validator

from smarttouch.base.errors import ProfileError
from smarttouch.physiology.anatomy import Anatomy
from smarttouch.profile.toml_tables import Number, Table, UnfitError, load_model, table_error

Array = NDArray[np.float64]
SEED = 1
"""Seed of the hypercube."""
_SHIPPED = Path(__file__).with_name("priors.toml")


class Prior(Table):
    """Bounds of one assumption."""

    name: str = Field(min_length=1)
    """What it is, with its unit."""
    keys: tuple[str, ...] = Field(min_length=1)
    """Keys of an anatomy that get the value, such as ``ra.depth_mm`` or
    ``layers.0.thickness_mm``."""
    low: Number
    """Smallest value."""
    high: Number
    """Largest value."""
    log: bool = False
    """Whether logarithms are drawn evenly, not values."""
    times: bool = False
    """Whether values multiply those of the anatomy."""
    branched: bool = False
    """Whether it is for classes whose axons have several endings only."""
    source: str = Field(min_length=1)
    """Where the bounds come from."""

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if not self.low < self.high or (self.log and self.low <= 0):
            raise UnfitError(
                f"low {self.low:g} and high {self.high:g} of {self.name!r} are no range: give a "
                "smaller and a larger number, above 0 for logarithms",
                key="low",
            )
        return self

    def value(self, part: float) -> float:
        """Return the value at a part of the way from the lower to the upper bound."""
        if self.log:
            return float(self.low * (self.high / self.low) ** part)
        return self.low + part * (self.high - self.low)


class Priors(Table):
    """Assumptions that are drawn."""

    priors: tuple[Prior, ...] = Field(min_length=1, max_length=100)
    """In the order of the hypercube."""


def load_priors(path: Path | None = None) -> tuple[Prior, ...]:
    """Load a file of priors, the shipped ones if none."""
    return load_model(path or _SHIPPED, Priors).priors


def hypercube(priors: Sequence[Prior], draws: int) -> Array:
    """Return the values of each draw, (N, P), the same for the same priors and number."""
    from scipy.stats.qmc import LatinHypercube

    parts = LatinHypercube(len(priors), seed=np.random.default_rng(SEED)).random(draws)
    return np.array(
        [
            [prior.value(float(part)) for prior, part in zip(priors, row, strict=True)]
            for row in parts
        ]
    )


def drawn_anatomy(anatomy: Anatomy, priors: Sequence[Prior], values: Array) -> Anatomy:
    """Return an anatomy with the values of one draw, (P,); ProfileError if one is impossible.

    Layers are drawn only of an anatomy that has some.
    """
    table = anatomy.model_dump()
    for prior, value in zip(priors, values.tolist(), strict=True):
        for key in prior.keys:
            *folders, last = key.split(".")
            if folders[:1] == ["layers"] and not anatomy.layers:
                continue
            into: Any = table
            try:
                for each in folders:
                    into = into[int(each) if each.isdigit() else each]
                if prior.branched and into["endings"] == 1:
                    continue
                drawn = into[last] * value if prior.times else value
                into[last] = max(1, round(drawn)) if isinstance(into[last], int) else drawn
            except (LookupError, TypeError):
                raise ProfileError(
                    f"prior {prior.name!r}: {key!r} is no number of anatomy {anatomy.name!r}",
                    key="keys",
                ) from None
    try:
        return Anatomy.model_validate(table)
    except ValidationError as error:
        raise table_error(ProfileError, f"a draw of {anatomy.name}", error) from None
