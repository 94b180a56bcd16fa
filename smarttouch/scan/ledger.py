"""What charge every electrode has passed, and polarity as a means to bring it back."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from smarttouch.scan.sequence import ScanSequence

_LOWEST = np.iinfo(np.int16).min


class ChargeLedger:
    """Adds up the pulses of sequences, electrode by electrode.

    Parameters
    ----------
    electrodes : int
        The E electrodes.

    Attributes
    ----------
    charge_uc : ndarray, (E,) float64, µC
        Net charge that has passed each electrode, **positive cathodic**.
    """

    def __init__(self, electrodes: int) -> None:
        self.charge_uc = np.zeros(electrodes)

    @property
    def worst_uc(self) -> float:
        """Largest net charge of any electrode, µC (magnitude)."""
        return float(np.abs(self.charge_uc).max(initial=0.0))

    def add(self, sequence: ScanSequence, times: int = 1) -> None:
        """Enter a sequence that is delivered so many times."""
        self.charge_uc += times * _charge_uc(sequence)

    def balancing(self, sequence: ScanSequence) -> ScanSequence:
        """Return a sequence or its reversed twin, whichever evens the ledger out more.

        The one is taken that leaves the smaller sum of squares. The twin has
        the same sites and the opposite currents, so it keeps all limits that
        the sequence keeps; but it stimulates other afferents (Fig. 10), and
        wants a board of both polarities; what was proved of the sequence is not
        said of it. Nothing is entered.
        """
        if self.charge_uc @ _charge_uc(sequence) <= 0:
            return sequence
        if sequence.current_ua.min() == _LOWEST:
            # It has no positive twin in 16 bits; no profile allows 32 mA anyway.
            return sequence
        return replace(sequence, current_ua=-sequence.current_ua, proof=None)


def _charge_uc(sequence: ScanSequence) -> NDArray[np.float64]:
    """Return what one scan carries through each electrode, (E,) µC, positive cathodic."""
    widths = sequence.width_us.astype(np.float64)
    return np.asarray(widths @ sequence.current_ua.astype(np.float64) * 1e-6)
