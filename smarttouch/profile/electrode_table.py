"""Electrode arrays from tables of coordinates: CSV files and arrays of numbers."""

import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from smarttouch.base.errors import ProfileError
from smarttouch.base.tables import read_csv
from smarttouch.profile.device import CommandDefaults, Limits, Output, PerceptThresholds
from smarttouch.profile.layouts import FreeLayout, GridLayout
from smarttouch.profile.toml_tables import table_error

USUAL_DIAMETER_MM = 1.0
_OF_THE_SENSOR_AND_FINGER = ("optics", "registration", "force")


def layout_of(table: Path | str | NDArray[np.floating[Any]]) -> FreeLayout:
    """Return discs at coordinates, (E, 2) or with a diameter (E, 3), mm right and down.

    A CSV file names its columns ``x_mm``, ``y_mm`` and, if given, ``diameter_mm``.
    """
    if isinstance(table, Path | str):
        path = Path(table)
        found = read_csv(path, ProfileError)
        names = ("x_mm", "y_mm", "diameter_mm")
        numbers = found.numbers(names[: 2 + ("diameter_mm" in found.head)], rising=False)
    else:
        path, numbers = Path("the table"), np.asarray(table, np.float64)
    if numbers.ndim != 2 or numbers.shape[1] not in (2, 3) or not len(numbers):
        raise ProfileError(
            f"a table of {numbers.shape} is no table of electrodes: give (E, 2), mm right and "
            "down, or (E, 3) with diameters",
            key="electrodes",
        )
    count = len(numbers)
    sizes = [(size, 0.0) for size in numbers[:, 2].tolist()] if numbers.shape[1] == 3 else None
    layout = {
        "layout": "free",
        "positions_mm": numbers[:, :2].tolist(),
        "size_mm": (USUAL_DIAMETER_MM, 0.0),
        "shapes": None if sizes is None else ["disc"] * count,
        "sizes_mm": sizes,
    }
    try:
        made = FreeLayout.model_validate(layout)
        made.build()
    except ValidationError as error:
        raise table_error(ProfileError, path, error) from None
    return made


LARGEST_PITCH_MM = 1e9


def grid_of(size: str, pitch_mm: float, diameter_mm: float) -> GridLayout:
    """Return a grid of discs, of a size like ``5x5``: rows and columns."""
    found = re.fullmatch(r"(\d+)x(\d+)", size)
    if found is None:
        raise ProfileError(f"grid {size!r} is no grid: give rows and columns as 5x5", key="grid")
    if not 0 < diameter_mm < pitch_mm:
        raise ProfileError(
            f"discs of {diameter_mm:g} mm do not fit a pitch of {pitch_mm:g} mm: give a diameter "
            "above 0 and below the pitch",
            key="diameter_mm",
        )
    if pitch_mm > LARGEST_PITCH_MM:
        # Along both axes at once: the layout would report it twice.
        raise ProfileError(
            f"a pitch of {pitch_mm:g} mm is out of range: give at most {LARGEST_PITCH_MM:g} mm",
            key="pitch_mm",
        )
    layout = {
        "layout": "grid",
        "rows": found[1],
        "columns": found[2],
        "pitch_x_mm": pitch_mm,
        "pitch_y_mm": pitch_mm,
        "diameter_mm": diameter_mm,
    }
    try:
        return GridLayout.model_validate(layout)
    except ValidationError as error:
        raise table_error(ProfileError, "the grid", error) from None


def lowest_for_all(
    count: int, output: Output, perception: PerceptThresholds, limits: Limits, calibrated: Any
) -> dict[str, Any]:
    """Return tables of a profile for another array of ``count`` electrodes.

    What was said of each electrode becomes the least of all, and what was measured on the old array
    goes.
    """
    own = output.model_dump() | {"masked": (), "wiring": None}
    if isinstance(output.impedance_kohm, tuple):
        own["impedance_kohm"] = max(output.impedance_kohm)
    felt = perception.model_dump() | {"level": None}
    if isinstance(perception.threshold_ma, tuple):
        felt["threshold_ma"] = min(perception.threshold_ma)
    if perception.comfort_ma is not None:
        felt["comfort_ma"] = (min(perception.comfort_ma),) * count
    limited = limits.model_dump()
    if limits.electrode_ma is not None:
        limited["electrode_ma"] = (min(limits.electrode_ma),) * count
    kept = {name: note for name, note in calibrated.items() if name in _OF_THE_SENSOR_AND_FINGER}
    return {
        "output": own,
        "perception": felt,
        "limits": limited,
        "calibrated": kept,
        "defaults": CommandDefaults(),
    }
