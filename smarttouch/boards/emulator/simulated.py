"""Emulated board without a process or waiting: sequences advance its simulated time."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from smarttouch.boards import link_protocol as protocol
from smarttouch.boards.board import Board, BoardReport, Capabilities
from smarttouch.boards.emulator.checks import MAX_CURRENT_UA, MAX_SLOTS
from smarttouch.boards.emulator.delivery_log import DeliveryLog
from smarttouch.boards.emulator.link import LinkFirmware
from smarttouch.boards.link_lists import encode_limits, encode_lists
from smarttouch.boards.link_protocol import Kind
from smarttouch.boards.link_session import HostSession
from smarttouch.boards.link_setup import reason_of
from smarttouch.errors import BoardError
from smarttouch.profile.device import Output
from smarttouch.registry import refuse_rest
from smarttouch.stimulation.safety import SafetyLimits
from smarttouch.stimulation.sequence import ScanSequence
from smarttouch.wire.framing import LARGEST_PACKET, Deframer

_BEAT_NS = protocol.SILENCE_MS * 1_000_000 // 2  # longest time that the host says nothing

Pulses = tuple[NDArray[np.uint32], NDArray[np.float32], NDArray[np.int16]]
"""Sequence of each slot (N,), its width (N,) µs, and its delivered current (N, E) µA, positive
cathodic.
"""


@dataclass
class _KeptBooks(DeliveryLog):
    """Delivery log that keeps every pulse in memory until it is taken."""

    _kept: list[tuple[int, float, NDArray[np.int16]]] = field(default_factory=list, repr=False)

    def keep(self, number: int, width_us: float, current_ua: NDArray[np.float64]) -> None:
        self._kept.append((number, width_us, np.rint(current_ua).astype(np.int16)))

    def take(self) -> Pulses:
        kept, self._kept = self._kept, []
        current_ua = np.array([each for _, _, each in kept], np.int16)
        return (
            np.array([number for number, _, _ in kept], np.uint32),
            np.array([width for _, width, _ in kept], np.float32),
            current_ua.reshape(len(kept), self.electrodes),
        )


class SimulatedBoard(Board):
    """Emulated ``link`` firmware in the same thread: ``simulated:``. Bytes on the wire, checks and
    skin are those of ``emulator:``, but time is simulated: a sequence is over as soon as it has
    been computed."""

    simulated_time = True
    on_a_finger = False

    def __init__(
        self, rest: str, limits: SafetyLimits, output: Output | None = None, **_: Any
    ) -> None:
        super().__init__(limits, output)
        refuse_rest("simulated:", rest, BoardError)
        self._kind = "weighted" if output is None else output.kind
        self._power_up()
        self.capabilities = Capabilities(
            electrodes=limits.electrodes,
            output=self._kind,
            max_current_ma=MAX_CURRENT_UA / 1000,
            max_slots=MAX_SLOTS,
            time_to_zero_ms=protocol.SILENCE_MS,
            firmware="simulated",
            recharges=self._kind == "weighted",
        )

    def _time(self) -> None:
        """Return None: time is what sequences state, as no finger is on this board."""

    def take_pulses(self) -> Pulses:
        """Return all pulses delivered since the last call."""
        return self._books.take()

    def _open(self) -> None:
        self._power_up()
        self._exchange(self._session.encode(Kind.HELLO))
        self._exchange(self._session.encode(Kind.BEGIN))
        self._exchange(self._session.encode(Kind.LIMITS, 0, encode_limits(self._gate.limits)))

    def _power_up(self) -> None:
        self._books = _KeptBooks(self._gate.limits.electrodes)
        self._firmware = LinkFirmware(self._books.electrodes, self._kind, self._books, ramp_ms=0)
        self._deframer = Deframer()
        self._session = HostSession()
        self._now_ns = self._number = 0
        self._unread = b""

    def _send(self, sequence: ScanSequence, times: int) -> int:
        self._number += 1
        switched = self._kind != "weighted"
        payload = encode_lists(sequence, times, False, switched, None, LARGEST_PACKET)
        self._exchange(self._session.encode(Kind.SEQUENCE, self._number, payload))
        end_ns = self._now_ns + sequence.period_us * times * 1000
        while end_ns - self._now_ns > _BEAT_NS:
            self._go_on_unless_stopped()
            self._now_ns += _BEAT_NS
            self._exchange(self._session.encode(Kind.HEARTBEAT))
        self._now_ns = end_ns
        self._unread = self._firmware.advance(end_ns)
        return self._number

    def _exchange(self, packet: bytes) -> None:
        """Give the firmware a packet, and take its answers and what it has sent since the last."""
        answers = self._unread + self._firmware.feed(packet, self._now_ns)
        self._unread = b""
        for answer in self._deframer.feed(answers):
            message = self._session.take(answer)
            if message is None:
                continue
            if message.kind == Kind.ACK:
                self.acknowledged += 1
            elif message.kind == Kind.NAK:
                self.refused += 1
                _, _, words = reason_of(message)
                raise BoardError(
                    f"the simulated board refused sequence {message.about}: {words}", about="board"
                )

    def report(self) -> BoardReport:
        return BoardReport(*self._firmware.account())

    def _stop(self) -> None:
        # A stop from another thread waits for the end of the sequence.
        with self._writing:
            self._exchange(self._session.encode(Kind.STOP))
