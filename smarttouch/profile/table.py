"""What all tables of a profile share."""

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]


class Table(BaseModel):
    """A table of the file: read only, and no unknown keys."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=False)
