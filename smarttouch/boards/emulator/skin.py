"""The electrodes on the skin, as an electrical circuit."""

import numpy as np
from numpy.typing import NDArray

RESISTANCE_OHM = 1.2e3
"""Spreading resistance of a 1 mm disc on skin of 0.43 S/m, 1/(4 σ a) = 1.16 kΩ."""
CAPACITANCE_F = 4.7e-9
"""Series capacitance of one output, in which a pulse's charge stays until it is let out.

An assumption about the board (a blocking capacitor at each output); the horny
layer under a 1 mm electrode is of the same order.
"""


class Skin:
    """Charge on the E electrodes, pulse after pulse.

    Attributes
    ----------
    charge_uc : ndarray, (E,) float64, µC
        Net charge that has passed each electrode and not come back.
    """

    def __init__(self, electrodes: int) -> None:
        self.charge_uc = np.zeros(electrodes)

    def pulse(self, current_ua: NDArray[np.float64], width_us: float) -> None:
        """Let a current (E,) flow for a while."""
        self.charge_uc += current_ua * width_us * 1e-6

    def short(self, duration_us: float) -> None:
        """Connect all electrodes; each falls to the mean with the time constant RC."""
        mean = self.charge_uc.mean()
        left = np.exp(-duration_us * 1e-6 / (RESISTANCE_OHM * CAPACITANCE_F))
        self.charge_uc = mean + (self.charge_uc - mean) * left

    @property
    def worst_uc(self) -> float:
        return float(np.abs(self.charge_uc).max(initial=0))
