"""Charge balance of each electrode, and reversal of polarity to restore it."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from smarttouch.stimulation.sequence import ScanSequence

_LOWEST = np.iinfo(np.int16).min


class ChargeBalance:
    """Sum of the charge of all sequences, electrode by electrode.

    It counts current times width of all that sources drive, recharge phases included; the current
    that flows back through the short circuit after a pulse is unknown and not counted. `charge_pc`,
    (E,) int64 positive cathodic, is exact.
    """

    def __init__(self, electrodes: int) -> None:
        self.charge_pc = np.zeros(electrodes, np.int64)

    @property
    def charge_uc(self) -> NDArray[np.float64]:
        """Net charge that has passed each electrode, (E,) µC, positive cathodic."""
        return np.asarray(self.charge_pc * 1e-6)

    @property
    def worst_uc(self) -> float:
        """Largest net charge of any electrode, µC (magnitude)."""
        return float(np.abs(self.charge_uc).max(initial=0.0))

    def add(self, sequence: ScanSequence, times: int = 1) -> None:
        """Add a sequence that is delivered a number of times."""
        self.charge_pc += times * net_charge_pc(sequence)

    def balancing(self, sequence: ScanSequence) -> ScanSequence:
        """Return a sequence or its reversed twin, whichever balances the charge better.

        For boards that cannot recharge (`add_recharge`). The one that leaves the smaller sum of
        squares is taken. The twin has the same sites and the opposite currents, so it keeps all
        limits that the sequence keeps. **It drives the other class**: what reaches RA reaches SAI
        when reversed, and vice versa (Fig. 10). It needs a board of both polarities, and has no
        proof of selectivity. The sum stays as it is.
        """
        if self.charge_uc @ (net_charge_pc(sequence) * 1e-6) <= 0:
            return sequence
        if sequence.current_ua.min() == _LOWEST:
            # It has no positive twin in 16 bits; no profile allows 32 mA anyway.
            return sequence
        return replace(sequence, current_ua=-sequence.current_ua, proof=None)


def net_charge_pc(sequence: ScanSequence) -> NDArray[np.int64]:
    """Return the charge of one scan through each electrode, (E,) pC, positive cathodic."""
    # Whole numbers far below 2**53: this product is exact, and faster than one of integers.
    widths = sequence.width_us.astype(np.float64)
    net = (widths @ sequence.current_ua.astype(np.float64)).astype(np.int64)
    if sequence.recharge_ua is not None:
        net += sequence.recharge_ua.astype(np.int64) * sequence.recharge_us
    return np.asarray(net)
