"""Common base of all tables of a profile."""

from collections.abc import Iterable, Mapping
from typing import Annotated, Any, Self

from pydantic import AfterValidator, BaseModel, ConfigDict, Field


class UnfitError(ValueError):
    """A value in a profile that does not fit the rest of it. Reading a file makes a `ProfileError`
    of it with the same attributes; the key and its value need not be given where pydantic knows
    them."""

    def __init__(self, message: str, **attributes: Any) -> None:
        super().__init__(message)
        self.attributes = attributes


class AllUnfitError(ValueError):
    """All values in a profile that do not fit."""

    def __init__(self, errors: tuple[UnfitError, ...]) -> None:
        super().__init__("; ".join(map(str, errors)))
        self.errors = errors


def raise_all(errors: Iterable[UnfitError]) -> None:
    """Raise all errors together, if there are any."""
    found = tuple(errors)
    if found:
        raise AllUnfitError(found)


def _require_sensible(value: float) -> float:
    if not SMALLEST <= value <= LARGEST:
        raise UnfitError(f"{value:g} is of no use: give a number from {SMALLEST:g} to {LARGEST:g}")
    return value


SMALLEST, LARGEST = 1e-9, 1e9
"""Range of plausible lengths, currents, impedances and times, in the units of profiles."""
Number = Annotated[float, Field(ge=-LARGEST, le=LARGEST)]
Positive = Annotated[float, Field(gt=0), AfterValidator(_require_sensible)]


class Table(BaseModel):
    """Table of the file: read only, without unknown keys, NaN or infinite numbers."""

    model_config = ConfigDict(
        extra="forbid", frozen=True, allow_inf_nan=False, ser_json_inf_nan="strings"
    )

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Self:
        """Return a copy with other values, checked as those of a file are."""
        if not update:
            return super().model_copy(deep=deep)
        kept = {name: getattr(self, name) for name in self.model_fields_set}
        return self.model_validate(kept | dict(update))
