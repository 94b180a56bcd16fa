"""Library of patterns for any array: shapes that stand still, and a few that move."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from smarttouch.electrodes import ElectrodeArray

SHORTEST_MS, LONGEST_MS = 20, 60_000
USUAL_MS = 500
_STEP_MS = 150
_SECTORS = 8

Levels = NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class Pattern:
    """Activation of the electrodes for a while."""

    level: Levels  # (E,) uint8: 255 is full activation
    duration_ms: int = USUAL_MS


def library(electrodes: ElectrodeArray) -> dict[str, tuple[Pattern, ...]]:
    """Return the patterns that an array has room for, by their names."""
    half = np.maximum(np.ptp(electrodes.position_mm, axis=0) / 2, 1e-9)
    x, y = (electrodes.position_mm / half).T
    # Half a cell, and a bit for what is rounded.
    cell_x, cell_y = np.minimum(np.array(electrodes.cell_mm) / 2 / half, 1) + 1e-6
    far, turn = np.hypot(x, y), np.mod(np.arctan2(y, x), 2 * np.pi)
    still = {
        "all": far < np.inf,
        "point": far == far.min(),
        "row": np.abs(y) <= cell_y,
        "column": np.abs(x) <= cell_x,
        "cross": (np.abs(y) <= cell_y) | (np.abs(x) <= cell_x),
        "diagonal": np.abs(x - y) <= max(cell_x, cell_y),
        "frame": np.maximum(np.abs(x), np.abs(y)) >= 1 - 1e-6,
        "ring": np.abs(far - 0.7) <= max(cell_x, cell_y),
        "left half": x < 0,
        "upper half": y < 0,
    }
    found = {
        **{name: (_pattern(on),) for name, on in still.items()},
        "sweep right": _moving(np.unique(x.round(6)), lambda at: np.abs(x - at) < 1e-5),
        "sweep down": _moving(np.unique(y.round(6)), lambda at: np.abs(y - at) < 1e-5),
        "turn": _moving(
            np.arange(_SECTORS) * 2 * np.pi / _SECTORS,
            lambda at: np.mod(turn - at, 2 * np.pi) < 2 * np.pi / _SECTORS,
        ),
    }
    there = {name: tuple(one for one in each if one.level.any()) for name, each in found.items()}
    return {name: each for name, each in there.items() if each}


def _pattern(on: NDArray[np.bool_], duration_ms: int = USUAL_MS) -> Pattern:
    return Pattern(np.where(on, 255, 0).astype(np.uint8), duration_ms)


def _moving(places: NDArray[Any], there: Callable[[float], Any]) -> tuple[Pattern, ...]:
    return tuple(_pattern(there(float(each)), _STEP_MS) for each in places)
