"""Safety rules of the ``link`` board, implemented independently of the host's."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smarttouch.boards.link_protocol import Output
from smarttouch.boards.link_sequence import WireSequence

MAX_CURRENT_UA = 5000
MAX_WIDTH_US = 200
MAX_CHARGE_PC = 500_000
MIN_PERIOD_US = 5000
MAX_SLOTS = 4096
MAX_RECHARGE_UA = 500
"""Limit of a recharge phase, a tenth of the strongest pulse, as the board has no thresholds."""
MAX_RECHARGE_US = 20_000
MAX_RECHARGE_PC = 2_000_000


@dataclass(frozen=True)
class Rules:
    """Rules of a board with a number of outputs of one kind."""

    electrodes: int
    output: Output

    def complaint(self, sequence: WireSequence) -> str:
        """Return the first violation by a sequence of the board's own rules; empty if none."""
        weighted = self.output == "weighted"
        current = _nominal(sequence)
        if sequence.electrodes != self.electrodes:
            return f"{sequence.electrodes} electrodes on a board of {self.electrodes}"
        if weighted != (sequence.current_ua is not None):
            return f"wrong kind of sequence for a {self.output} board"
        if len(sequence.width_us) > MAX_SLOTS:
            return f"{len(sequence.width_us)} slots"
        if sequence.period_us < MIN_PERIOD_US:
            return f"period {sequence.period_us} us"
        width = sequence.width_us.astype(np.int64)
        if int((width + sequence.discharge_us).sum()) > sequence.period_us:
            return "slots do not fit the period"
        if len(width) and not 0 < int(width.min()) <= int(width.max()) <= MAX_WIDTH_US:
            return f"pulse width {int(width.max())} us"
        if np.any(np.abs(current.sum(axis=1)) > 1e-6):
            return "a slot is out of balance"
        peaks = np.abs(current).max(axis=1, initial=0)
        if np.any(peaks > MAX_CURRENT_UA):
            return f"current {peaks.max():.0f} uA"
        if np.any(peaks * width > MAX_CHARGE_PC):
            return f"charge {(peaks * width).max():.0f} pC"
        if sequence.state is not None and self._states_wrong(sequence.state):
            return "a slot without both poles, or with an unknown state"
        if sequence.recharge_ua is not None:
            slots_us = int((width + sequence.discharge_us).sum())
            return _recharge_complaint(
                sequence.recharge_ua, sequence.recharge_us, slots_us, sequence.period_us
            )
        return ""

    def _states_wrong(self, state: NDArray[np.int8]) -> bool:
        cathodes, anodes = (state == 1).sum(axis=1), (state == -1).sum(axis=1)
        wrong = (state == 2).any(axis=1) | (cathodes == 0) | (anodes == 0)
        if self.output == "one-against-all":
            wrong |= (state == 0).any(axis=1) | (np.minimum(cathodes, anodes) != 1)
        return bool(wrong.any())


def _recharge_complaint(
    current_ua: NDArray[np.int16], width_us: int, slots_us: int, period_us: int
) -> str:
    """Return the first violation by a recharge phase after slots; empty if none."""
    current = [int(each) for each in current_ua]
    strongest = max(map(abs, current), default=0)
    if not slots_us:
        return "a recharge phase without slots"
    if not 0 < width_us <= MAX_RECHARGE_US:
        return f"recharge phase of {width_us} us"
    if slots_us + width_us > period_us:
        return "slots and recharge phase do not fit the period"
    if sum(current):
        return "the recharge phase is out of balance"
    if strongest > MAX_RECHARGE_UA:
        return f"recharge current {strongest} uA"
    if strongest * width_us > MAX_RECHARGE_PC:
        return f"recharge charge {strongest * width_us} pC"
    return ""


def _nominal(sequence: WireSequence) -> NDArray[np.float64]:
    """Return the nominal current, (S, E) µA; a source divides equally among equal electrodes."""
    if sequence.current_ua is not None:
        return sequence.current_ua.astype(np.float64)
    assert sequence.state is not None
    assert sequence.source_ua is not None
    share = np.zeros(sequence.state.shape)
    for pole in (1, -1):
        connected = sequence.state == pole
        share += pole * connected / np.maximum(connected.sum(axis=1, keepdims=True), 1)
    return share * sequence.source_ua[:, None]
