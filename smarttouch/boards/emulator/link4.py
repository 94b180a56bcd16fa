"""Emulated firmware of the ``link`` board of version 4: kernels on the board, rules in numbers."""

from smarttouch.boards import link_protocol as protocol
from smarttouch.boards.emulator.checks import RAMP_MS, Complaint, Ramp, SessionLimits, complaint
from smarttouch.boards.emulator.delivery_log import DeliveryLog
from smarttouch.boards.emulator.finger import Finger
from smarttouch.boards.emulator.link import NAME, LinkFirmware
from smarttouch.boards.emulator.lists import Keep, decode_lists
from smarttouch.boards.emulator.session import BoardSession
from smarttouch.boards.emulator.skin import COMPLIANCE_V
from smarttouch.boards.link_protocol import Feature, Kind, Output, Refusal, Rule
from smarttouch.boards.link_sequence import WireSequence
from smarttouch.boards.link_session import Message

PACKET_BYTES = 1 << 20
KERNEL_BYTES = 1 << 23
MOST_KERNELS = 4096


class Link4Firmware(LinkFirmware):
    """The board of version 4 between its serial line and its electrodes.

    Parameters
    ----------
    electrodes, output, books, finger, compliance_v, session
        Of `LinkFirmware`.
    ramp_ms : int
        Least time from zero to full intensity; 0 for tests whose time is what they claim.
    kernel_bytes : int
        Room for kernels.
    """

    def __init__(
        self,
        electrodes: int,
        output: Output,
        books: DeliveryLog,
        finger: Finger | None = None,
        compliance_v: float = COMPLIANCE_V,
        session: BoardSession | None = None,
        ramp_ms: int = RAMP_MS,
        kernel_bytes: int = KERNEL_BYTES,
    ) -> None:
        session = session or BoardSession(version=protocol.NEWEST)
        super().__init__(electrodes, output, books, finger, compliance_v, session)
        self._kernel_bytes = kernel_bytes
        self._keep = Keep(self._electrodes, kernel_bytes, MOST_KERNELS)
        self._ramp = Ramp(ramp_ms)
        self._limits: SessionLimits | None = None

    def _begun(self) -> None:
        self._limits = None
        self._ramp.restart()

    def _answer_more(self, message: Message) -> None:
        if message.kind == Kind.LIMITS:
            if self._limits is None:
                self._limits = SessionLimits.of(message.payload, self._electrodes)
            self._say(Kind.LIMITED, message.number, bytes([self._limits is not None]))
        elif message.kind == Kind.KERNELS:
            size, keep = protocol.KERNELS.size, self._keep
            # What a sequence is made of stays as it is until that is over.
            if len(message.payload) >= size and not self.at_hand and self._refusing is None:
                identity, whole_size, offset = protocol.KERNELS.unpack_from(message.payload)
                keep.take(identity, whole_size, offset, message.payload[size:])
            whole = keep.weights is not None
            kept = protocol.KEPT.pack(keep.identity, keep.received, whole)
            self._say(Kind.KEPT, message.number, kept)

    def _judged(self, number: int, payload: bytes, now_ns: int) -> WireSequence | None:
        # Time that stood still with this process has passed on the skin.
        now_us = now_ns // 1000 + round(1000 * self.books.stood_still_ms)
        try:
            lists = decode_lists(payload, self._electrodes, self._output != "weighted")
        except ValueError:
            self._refuse(number, Refusal.MALFORMED)
            return None
        found: Complaint | None = Complaint(Rule.LIMITS)
        if self._limits is not None:
            most = self._ramp.allowed(now_us)
            found = complaint(lists, self._limits, self._keep, self._output, most)
        if found is not None:
            self._say(Kind.NAK, number, protocol.NAK.pack(Refusal.UNSAFE, *found))
            return None
        self._ramp.note(lists.intensity, now_us)
        return lists.sequence

    def _refuse(self, number: int, reason: Refusal, text: str = "") -> None:
        nothing = Complaint(Rule.NONE)
        self._say(Kind.NAK, number, protocol.NAK.pack(reason, *nothing))

    def _capabilities(self) -> bytes:
        keeping = protocol.KEEPING.pack(self._kernel_bytes, PACKET_BYTES, MOST_KERNELS)
        return self._able(Feature.KERNELS) + keeping + NAME.encode()

    def _report(self) -> bytes:
        books = self.books
        return protocol.ACCOUNT.pack(
            books.sequences, books.slots, books.pulses, books.violations,
            round(1000 * books.max_current_ma), round(1e6 * books.max_charge_uc),
            round(1e6 * books.max_net_charge_uc), self.at_hand, self._session.old,
            self._session.foreign,
        )  # fmt: skip
