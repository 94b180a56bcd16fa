"""Impedance of each electrode on the skin, from a board's own measurement."""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

SATURATED = 0.97  # part of the compliance at which a source counts as saturated
OPEN_FACTOR = 5.0
SHORT_FACTOR = 0.1
"""Part of the median below which an electrode is shorted; good ones differ two- or threefold. An
estimate of ours.
"""

Condition = Literal["good", "open", "short", "unsure"]


@dataclass(frozen=True, eq=False)
class Impedance:
    """Impedances of all electrodes, measured once."""

    # (E,): voltage over current at the end of the measuring pulse, each electrode to the skin;
    # infinite where the board's voltage was not enough
    kohm: NDArray[np.float64]
    condition: tuple[Condition, ...]  # "unsure" where the reading fits more than one
    current_ma: float  # of the measuring pulse

    @property
    def broken(self) -> tuple[int, ...]:
        """Electrodes that are open or shorted."""
        return tuple(i for i, each in enumerate(self.condition) if each in ("open", "short"))

    @property
    def lifted(self) -> bool:
        """True if nothing touches the electrodes."""
        return all(each == "open" for each in self.condition)

    def figures(self) -> dict[str, Any]:
        """Return the values for a JSON file; open electrodes have no number."""
        kohm = [
            None if condition == "open" else float(f"{each:.4g}")
            for each, condition in zip(self.kohm, self.condition, strict=True)
        ]
        return {
            "impedance_kohm": kohm,
            "condition": self.condition,
            "current_ma": self.current_ma,
            "masked": self.broken,
        }


def judge(
    volts: NDArray[np.float64],
    current_ma: float | NDArray[np.float64],
    compliance_v: float,
    unsure: NDArray[np.bool_] | None = None,
) -> Impedance:
    """Return the impedances from the source's voltages (E,), each electrode against all others.

    The voltage of electrode i is I (Zᵢ + 1 / Σⱼ≠ᵢ 1/Zⱼ), all others in parallel; solved by repeated
    insertion, which converges as the return is small. ``unsure`` readings, (E,), may stand for
    another voltage.
    """
    total = np.asarray(volts, np.float64) / np.asarray(current_ma, np.float64)
    saturated = np.asarray(volts) >= SATURATED * compliance_v
    kohm = np.where(saturated, np.inf, np.maximum(total, 1e-3))
    for _ in range(20):
        admittance = 1 / kohm
        others = admittance.sum() - admittance
        back = np.divide(1, others, out=np.zeros_like(others), where=others > 0)
        kohm = np.where(saturated, np.inf, np.maximum(total - back, 1e-3))
    return classify(kohm, float(np.mean(current_ma)), unsure)


def classify(
    kohm: NDArray[np.float64], current_ma: float, unsure: NDArray[np.bool_] | None = None
) -> Impedance:
    """Return which electrodes are open or shorted, by their impedances, (E,) kΩ."""
    finite = kohm[np.isfinite(kohm)]
    middle = float(np.median(finite)) if finite.size else np.inf
    conditions: list[Condition] = []
    for index, value in enumerate(kohm):
        if unsure is not None and unsure[index]:
            conditions.append("unsure")
        elif not value <= OPEN_FACTOR * middle or not np.isfinite(value):
            conditions.append("open")
        elif value < SHORT_FACTOR * middle:
            conditions.append("short")
        else:
            conditions.append("good")
    return Impedance(kohm, tuple(conditions), current_ma)
