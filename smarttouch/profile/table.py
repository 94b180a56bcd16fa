"""What all tables of a profile share."""

from typing import Annotated

from pydantic import AfterValidator, BaseModel, ConfigDict, Field


def _require_sensible(value: float) -> float:
    if not SMALLEST <= value <= LARGEST:
        raise ValueError(f"{value:g} is of no use: give a number from {SMALLEST:g} to {LARGEST:g}")
    return value


SMALLEST, LARGEST = 1e-9, 1e9
"""No length, current, impedance or time of a device lies beyond, in the units of profiles."""
Number = Annotated[float, Field(ge=-LARGEST, le=LARGEST)]
Positive = Annotated[float, Field(gt=0), AfterValidator(_require_sensible)]


class Table(BaseModel):
    """A table of the file: read only, no unknown keys, and no number that is none or endless."""

    model_config = ConfigDict(
        extra="forbid", frozen=True, allow_inf_nan=False, ser_json_inf_nan="strings"
    )
