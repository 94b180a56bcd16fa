"""Host-side delivery statistics, for boards that report none."""

import numpy as np

from smarttouch.boards.capabilities import BoardReport
from smarttouch.stimulation.ledger import ChargeBalance
from smarttouch.stimulation.sequence import ScanSequence


class HostStatistics:
    """Delivery statistics kept by the host."""

    def __init__(self, electrodes: int) -> None:
        self._sequences = self._slots = self._pulses = self._most_pulses = 0
        self._current_ma = self._charge_uc = self._net_uc = self._unsure_uc = 0.0
        self._ledger = ChargeBalance(electrodes)

    def add(
        self, sequence: ScanSequence, times: int = 1, again: bool = False, most: int | None = None
    ) -> None:
        """Add a sequence that was scanned ``times`` times, or at least that and at most ``most``
        times; ``again`` if the sequence itself has been counted before."""
        most = times if most is None else most
        self._sequences += not again
        if not sequence.slots or not most:
            return
        pulses = int(np.count_nonzero(sequence.current_ua))
        self._slots += times * sequence.slots
        self._pulses += times * pulses
        self._most_pulses += most * pulses
        peaks = np.abs(sequence.current_ua.astype(np.int32)).max(axis=1)
        self._current_ma = max(self._current_ma, float(peaks.max()) / 1000)
        self._charge_uc = max(self._charge_uc, float((peaks * sequence.width_us).max()) / 1e6)
        self._ledger.add(sequence, times)
        self._unsure_uc += (most - times) * float((peaks * sequence.width_us).sum()) / 1e6
        self._net_uc = max(self._net_uc, self._ledger.worst_uc + self._unsure_uc)

    def report(self) -> BoardReport:
        return BoardReport(
            self._sequences,
            self._slots,
            self._pulses,
            0,
            self._current_ma,
            self._charge_uc,
            self._net_uc,
            by="host",
            most_pulses=self._most_pulses,
        )
