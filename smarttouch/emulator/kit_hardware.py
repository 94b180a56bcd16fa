"""Output stage of the published kits: one current source."""

import math

import numpy as np

from smarttouch.emulator.finger_events import EmulatedFinger
from smarttouch.emulator.firmware import DeliveryLog
from smarttouch.emulator.skin import SkinCircuit

VOLTS_PER_COUNT = 0.0893  # scale of the eTactileKit's converter; assumed for its relative's as well
LARGEST_READING = 4095


class SingleSource:
    """Output stage of a kit, with the skin connected; a shunt is a load beside the skin."""

    def __init__(
        self,
        books: DeliveryLog,
        finger: EmulatedFinger | None,
        compliance_v: float,
        shunt_ohm: float = math.inf,
    ) -> None:
        self.books = books
        self._skin = SkinCircuit(books.electrodes, compliance_v=compliance_v)
        self._finger = finger or EmulatedFinger(books.electrodes)
        self._shunt_ohm = shunt_ohm
        self._state = np.zeros(books.electrodes, np.int8)
        self._rested_ns = 0

    def pulse(
        self,
        number: int,
        electrode: int,
        current_ua: float,
        width_us: float,
        start_ns: int,
        *,
        among: int,
        rest_us: float,
        slot: int | None = None,
        grounded: bool = True,
        more: bool = False,
    ) -> int:
        """Deliver a pulse, ground all outputs for the rest after it, and record both; return the
        converter's reading at its end.

        Current is positive cathodic; the first ``among`` electrodes take part, one against the
        others. Before it, outputs were ``grounded`` or unconnected; with ``more``, another pulse of
        the slot follows. The slot's number is the electrode's if not given.
        """
        self._finger.at(start_ns / 1e9, self._skin)
        if start_ns > self._rested_ns:
            pass_time = self._skin.short if grounded else self._skin.idle
            pass_time((start_ns - self._rested_ns) / 1000)
        sign = 1 if current_ua > 0 else -1
        self._state[:among], self._state[among:] = -sign, 0
        if electrode < len(self._state):
            self._state[electrode] = sign
        delivered = self._skin.switched_pulse(
            self._state, abs(current_ua), width_us, self._shunt_ohm
        )
        if rest_us:
            self._skin.short(rest_us)
        self._rested_ns = start_ns + round(1000 * (width_us + rest_us))
        self.books.enter(
            number, electrode if slot is None else slot, electrode, delivered, width_us,
            self._skin.residual_uc, start_ns // 1000, more=more,
        )  # fmt: skip
        flowed = bool(delivered.current_ua.any())
        volts = delivered.source_v if flowed else self._skin.compliance_v
        return min(LARGEST_READING, int(volts / VOLTS_PER_COUNT))
