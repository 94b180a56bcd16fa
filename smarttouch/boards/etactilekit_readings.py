"""Voltages that an eTactileKit tells of its electrodes, and what they say of the skin."""

import threading

import numpy as np
from numpy.typing import NDArray

from smarttouch.boards.impedance import Impedance, judge
from smarttouch.boards.streamed import one_against_all
from smarttouch.scan.sequence import ScanSequence

VOLTS_PER_COUNT = 0.0893
DUMMY_KOHM = 66.0
"""A load fitted beside the skin; it takes V / 66 kΩ of the current."""
COMPLIANCE_V = 300.0
"""Of its switches (HV513), the most a reading can be worth."""
OPEN_SHARE = 0.95
"""Of the voltage without a finger: where every slot needs that much, there is none."""
_MOST_KEPT = 64


class Readings:
    """Keeps the voltages of patterns until they are taken.

    Parameters
    ----------
    wiring : ndarray, (E,)
        The output of each electrode.
    """

    def __init__(self, wiring: NDArray[np.intp]) -> None:
        self._wiring = wiring
        self._volts: list[tuple[ScanSequence, NDArray[np.float32]]] = []
        self._lock = threading.Lock()

    def note(self, sequence: ScanSequence, answer: bytes, lifted: bool) -> bool:
        """Keep what a board tells of a sequence; return whether the finger is lifted.

        Parameters
        ----------
        sequence : ScanSequence
        answer : bytes
            ADC counts of all outputs.
        lifted : bool
            What is believed where the answer says nothing.
        """
        adc = np.frombuffer(answer, "<u2")
        electrode, current_ua = one_against_all(sequence)
        volts = (adc[self._wiring[electrode]] * VOLTS_PER_COUNT).astype(np.float32)
        with self._lock:
            self._volts = [*self._volts[1 - _MOST_KEPT :], (sequence, volts)]
        if not volts.any():
            return lifted
        # Without a finger all of it goes through the load beside the skin.
        alone_v = np.minimum(np.abs(current_ua) / 1000 * DUMMY_KOHM, COMPLIANCE_V)
        return bool((volts >= OPEN_SHARE * alone_v).all())

    def take(self) -> list[tuple[ScanSequence, NDArray[np.float32]]]:
        """Return what was kept since the last call."""
        with self._lock:
            taken, self._volts = self._volts, []
        return taken

    def impedance(self, answer: bytes, level_ma: float) -> Impedance:
        """Return what the answer to a measuring pulse says of each electrode."""
        volts = np.frombuffer(answer, "<u2")[self._wiring].astype(np.float64) * VOLTS_PER_COUNT
        through_skin = np.maximum(level_ma - volts / DUMMY_KOHM, 1e-6)
        return judge(volts, through_skin, COMPLIANCE_V)
