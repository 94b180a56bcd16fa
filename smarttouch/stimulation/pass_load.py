"""Load of one pass of a sequence on each electrode: pulses that count as felt, and charge."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from smarttouch.profile.ceilings import (
    BURST_S,
    CEILING_MEAN_MA,
    CEILING_NET_MA,
    CEILING_PULSES_HZ,
)

WINDOW_NS = 1_000_000_000
BURST_US = round(1e6 * BURST_S)
PER_PULSE = 1_000_000
PER_PC = round(1000 * CEILING_PULSES_HZ / (1e6 * CEILING_MEAN_MA))
"""Weights that give felt pulses and charge one limit, in whole numbers: 3 of it for 1 pC, a
million for a pulse, and `MOST_PER_US` of either for each microsecond."""
MOST_PER_US = round(CEILING_PULSES_HZ)
NET_PC = round(1e9 * CEILING_NET_MA)
"""Largest net charge of an electrode in a second."""
PLANNED = 0.9
"""Part of the limit used by schedules, so that jittered steps keep the window of a second."""

Load = NDArray[np.float64]
"""Felt pulses × `PER_PULSE` and charge in pC × `PER_PC` of each electrode, (2, E): whole numbers,
all far below 2^53, where doubles are exact."""
Charge = NDArray[np.float64]
"""Signed charge of each electrode, positive cathodic, (E,) pC: whole numbers below 2^53."""


Sums = NDArray[np.float64]
"""Load and signed charge of each electrode, (3, E)."""


class PassLoad(NamedTuple):
    """Load of one pass of a sequence on each electrode.

    Attributes
    ----------
    sums : ndarray, (3, E)
        Load and net charge, with its recharge phase.
    recharge_pc : ndarray, (E,) pC
        Charge of its recharge phase if it has one, positive cathodic.
    busy_us : int, µs
        Time of its slots and its recharge phase.
    peak_pc : int, pC
        Largest charge of one pulse of its slots; 0 if none has current.
    """

    sums: Sums
    recharge_pc: Charge | None
    busy_us: int
    peak_pc: int


def shortest_period_us(load: Load) -> int:
    """Return the shortest period that a schedule plans for a load, µs.

    Above `BURST_US` it is more than any period allows.
    """
    return int(np.ceil(load.max(initial=0) / (PLANNED * MOST_PER_US)))
