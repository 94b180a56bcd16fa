"""The host's own account of what it sent."""

import numpy as np

from smarttouch.boards.board import BoardReport
from smarttouch.scan.ledger import ChargeLedger
from smarttouch.scan.sequence import ScanSequence


class HostBooks:
    """What was sent, for boards that keep no account of their own.

    Parameters
    ----------
    electrodes : int
        Of the board.
    """

    def __init__(self, electrodes: int) -> None:
        self._sequences = self._slots = self._pulses = 0
        self._current_ma = self._charge_uc = self._net_uc = 0.0
        self._ledger = ChargeLedger(electrodes)

    def add(self, sequence: ScanSequence, times: int = 1, again: bool = False) -> None:
        """Write down a sequence that was sent, or was repeated."""
        self._sequences += not again
        if not sequence.slots:
            return
        self._slots += times * sequence.slots
        self._pulses += times * int(np.count_nonzero(sequence.current_ua))
        peaks = np.abs(sequence.current_ua.astype(np.int32)).max(axis=1)
        self._current_ma = max(self._current_ma, float(peaks.max()) / 1000)
        self._charge_uc = max(self._charge_uc, float((peaks * sequence.width_us).max()) / 1e6)
        self._ledger.add(sequence, times)
        self._net_uc = max(self._net_uc, self._ledger.worst_uc)

    def report(self) -> BoardReport:
        """Return the account so far."""
        return BoardReport(
            self._sequences,
            self._slots,
            self._pulses,
            0,
            self._current_ma,
            self._charge_uc,
            self._net_uc,
            by="host",
        )
