"""Cells of a CSV file, and the values in them."""

import csv
import io
import math
from collections.abc import Iterable
from types import NoneType
from typing import Any, get_args

from smarttouch.errors import ExperimentError


def read_cell(text: str, kind: Any) -> str | bool | float | None:
    """Return the value in a cell; kinds are those of the attributes of `TrialRow`."""
    if kind is str:
        return text
    kinds = get_args(kind) or (kind,)
    if not text and NoneType in kinds:
        return None
    if bool in kinds:
        return bool(("0", "1").index(text))
    if int in kinds:
        return int(text)
    number = float(text)
    if not math.isfinite(number):
        raise ValueError(text)
    return number


def write_cell(value: str | float | None, column: str) -> str:
    """Return the text of a cell."""
    if isinstance(value, str):
        if "\n" in value or "\r" in value:
            raise ExperimentError(
                f"{column} {value!r} has a line break: leave it out", about=column
            )
        return value
    if value is None:
        return ""
    if not math.isfinite(value):
        raise ExperimentError(
            f"{column} is {value}, which no trial can be: give a number", about=column
        )
    # What comes from numpy would be written with its type's name.
    return repr(float(value)) if isinstance(value, float) else str(int(value))


def write_line(cells: Iterable[str]) -> bytes:
    """Return a line of the file, in UTF-8."""
    line = io.StringIO(newline="")
    csv.writer(line, lineterminator="\n").writerow(cells)
    return line.getvalue().encode()
