"""Charge balance of each electrode, and reversal of polarity to restore it."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from smarttouch.stimulation.sequence import ScanSequence

_LOWEST = np.iinfo(np.int16).min


class ChargeBalance:
    """Sum of the charge of all sequences, electrode by electrode.

    It counts current times width of all that sources drive, recharge phases included.
    What the short circuit after a pulse lets flow back depends on the skin, which nobody
    has measured, and is not in it.

    Parameters
    ----------
    electrodes : int
        The E electrodes.

    Attributes
    ----------
    charge_pc : ndarray, (E,) int64, pC
        Net charge that has passed each electrode, **positive cathodic**, without rounding.
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

        For boards that cannot recharge (`add_recharge`). The one is taken that leaves the
        smaller sum of squares. The twin has the same sites and the opposite currents, so it
        keeps all limits that the sequence keeps. **It drives the other class**: what reaches
        RA reaches SAI when reversed, and the other way round (Fig. 10). It wants a board of
        both polarities, and what was proved of the sequence is not said of it. Nothing is
        entered.
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
