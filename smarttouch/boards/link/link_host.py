"""Host of a ``link`` board, whatever carries its packets: handshake, kernels and account."""

from collections import deque
from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.errors import (
    BoardError,
    EmergencyStopError,
    KernelTableError,
    LineLostError,
    OtherDeviceError,
)
from smarttouch.base.wire.framing import LARGEST_PACKET
from smarttouch.boards.driver import Driver
from smarttouch.boards.line import Line
from smarttouch.boards.link import protocol as protocol
from smarttouch.boards.link.protocol import (
    NOTHING,
    Feature,
    HostSession,
    Message,
    MessageKind,
    Rule,
    decode_volts,
)
from smarttouch.boards.link.sequence_encoding import (
    KernelImage,
    ScanPart,
    encode_limits,
    encode_scan,
)
from smarttouch.boards.reports import BoardReport, Capabilities, SequenceStart
from smarttouch.profile.device import Output
from smarttouch.stimulation.safety_gate import ProvedSequence, SafetyLimits
from smarttouch.stimulation.scan_sequence import KernelTable

OLD_PACKETS = slice(8, 10)
"""Places of packets refused as old and as of another session in a board's account."""
MOST_COMPLIANCES = 2.1
"""Bound of a slot's voltage: sources of both poles at their limit reach twice the compliance."""
OPEN_SHARE = 0.97
"""Part of the compliance: if every slot reaches it, nothing touches the electrodes."""
OVERHEAD = protocol.WHOLE_HEAD_BYTES + 4  # bytes of a packet beside its payload
_PIECE = 1024  # bytes of kernels at once: nothing else can pass while they do
_IDLE = 3  # times that nothing new may have been kept


def _offered(answer: Message, name: str) -> Capabilities:
    """Return the capabilities in a CAPABILITIES of any version."""
    if answer.version != protocol.VERSION:
        raise BoardError(
            f"the board at {name} speaks link version {answer.version}, this "
            f"program {protocol.VERSION}: bring both to the same"
        )
    head = protocol.CAPABILITIES.size
    if len(answer.payload) < head + protocol.KEEPING.size:
        raise malformed(name)
    outputs, output, features, current_ua, slots, zero_ms, volts = (
        protocol.CAPABILITIES.unpack_from(answer.payload)
    )
    if output >= len(protocol.OUTPUTS):
        raise BoardError(f"the board at {name} has outputs of unknown kind {output}")
    kind = protocol.OUTPUTS[output]
    room, packet, kernels = protocol.KEEPING.unpack_from(answer.payload, head)
    head += protocol.KEEPING.size
    if not features & Feature.KERNELS:
        room = kernels = 0
    return Capabilities(
        electrodes=outputs, output=kind, max_current_ma=current_ua / 1000, max_slots=slots,
        time_to_zero_ms=zero_ms, firmware=answer.payload[head:].decode("utf-8", "replace"),
        measures=bool(features & Feature.VOLTAGE), force=bool(features & Feature.FORCE),
        compliance_v=float(volts) or None, recharges=bool(features & Feature.RECHARGE),
        emergency_switch=bool(features & Feature.EMERGENCY), kernel_bytes=room,
        most_kernels=kernels, packet_bytes=packet,
    )  # fmt: skip


def malformed(name: str) -> BoardError:
    """Return the error of a board that gives invalid answers."""
    return BoardError(f"the board at {name} gives invalid answers: check its firmware")


class Packets(Protocol):
    """Packets to and from a board, which answers queries."""

    session: HostSession

    @property
    def name(self) -> str: ...

    def ask(self, question: MessageKind, payload: bytes = b"") -> Message:
        """Return the answer; raise BoardError if there is none."""
        ...


def give_kernels(
    line: Packets, image: KernelImage, most_bytes: int, go_on: Callable[[], None]
) -> None:
    """Give a board its kernels, in packets of at most ``most_bytes``; what it keeps already is not
    sent again. ``go_on`` raises if the board is to be stopped; one that keeps nothing is lost."""
    piece = min(_PIECE, most_bytes - OVERHEAD - protocol.KERNELS.size)
    at, most, data, idle = 0, 0, b"", 0
    while idle < _IDLE:
        go_on()
        head = protocol.KERNELS.pack(image.identity, len(image.data), at)
        answer = line.ask(MessageKind.KERNELS, head + data).payload
        if len(answer) != protocol.KEPT.size:
            raise malformed(line.name)
        identity, kept, whole, proof = protocol.KEPT.unpack(answer)
        if identity == image.identity and whole:
            if proof == image.proof(line.session.number):
                return
            raise KernelTableError(f"the board at {line.name} holds other kernels than those sent")
        # The first query carries no kernels: its answer shows where to begin.
        kept = kept if identity == image.identity and kept < len(image.data) else 0
        idle = 0 if kept > most else idle + 1
        most = max(most, kept)
        at, data = kept, image.data[kept : kept + piece]
    # Its session may have ended, as after 100 ms in which the host was held up.
    raise LineLostError(
        f"the board at {line.name} does not keep the kernels that it is sent: check its firmware"
    )


def reason_of(refusal: Message) -> tuple[int, int, str]:
    """Return reason, rule and text of a NAK."""
    if len(refusal.payload) != protocol.NAK.size:
        return 0, Rule.NONE, ""
    reason, rule, slot, electrode, value, allowed = protocol.NAK.unpack(refusal.payload)
    name = next((each.name.lower() for each in Rule if each == rule), "unknown")
    words = f"rule {rule} ({name})" if rule else "malformed"
    words += f": {value}, allowed {allowed}" if value or allowed else ""
    words += f", slot {slot}" if slot != NOTHING else ""
    words += f", electrode {electrode}" if electrode != NOTHING else ""
    return reason, rule, words


class SentPart(NamedTuple):
    """Sequence on its way, or the part of one that a packet has room for."""

    number: int
    proved: ProvedSequence
    part: ScanPart
    sent_ns: int


class BoardClock:
    """Reads a board's clock as the host's, by the answer that came fastest of the last few."""

    def __init__(self) -> None:
        self._ahead_ns: deque[int] = deque(maxlen=16)

    def note(self, board_us: int, sent_ns: int, now_ns: int) -> int:
        """Return the host's time of the start of a sequence that was sent at a time, and its answer
        now."""
        if self._ahead_ns and 1000 * board_us + min(self._ahead_ns) < sent_ns:
            # No sequence begins before it is sent: the board's clock has stood still.
            self._ahead_ns.clear()
        self._ahead_ns.append(now_ns - 1000 * board_us)
        return 1000 * board_us + min(self._ahead_ns)


class LinkHost(Driver):
    """Base of drivers of ``link`` boards: kernels, voltages and accounts; `_packets` carries
    packets, and a subclass numbers and sends sequences."""

    keeps_kernels = True
    reports_delivery = True
    reports_starts = True
    _packets: Packets
    _line: Line

    def __init__(self, limits: SafetyLimits, output: Output | None = None) -> None:
        self._output = output
        self._limits = limits
        self._can: Capabilities | None = None
        self._number = 0
        self._account: tuple[Any, ...] | None = None
        """Account of the board at zero, since it was stopped."""
        self._account_before: tuple[Any, ...] = ()
        """Account of the board when it was opened, or opened again after its line was lost."""
        self._packets_before = 0  # packets that it had refused when it was opened
        self._slots_sent = 0  # slots sent since then, repetitions included
        self._unsafe_refused = 0
        """Sequences refused as unsafe since then, and those sent again: they may count twice."""
        self._suspicion = ""  # fault found in what the board says, until the board is latched
        self._table: KernelTable | None = None
        self._image: KernelImage | None = None
        self._board_clock = BoardClock()
        self._sent: deque[SentPart] = deque(maxlen=4)
        self._volts: list[NDArray[np.float32]] = []  # voltages of the parts of a scan so far

    @property
    def can(self) -> Capabilities:
        """Capabilities of the board, which is open."""
        assert self._can is not None
        return self._can

    def _set_up(self) -> None:
        """Give limits and kernels to a board whose session has begun, and start its account."""
        packets = self._packets
        if packets.ask(MessageKind.LIMITS, encode_limits(self._limits)).payload != b"\1":
            raise malformed(packets.name)
        self._give_kernels()
        self._account_before, self._account = self._ask_account(), None
        self._slots_sent = self._unsafe_refused = 0
        # It may have been switched off meanwhile.
        self._board_clock = BoardClock()

    def _note_start(self, message: Message, now_ns: int) -> None:
        """Take the start of a sequence from its acknowledgment."""
        (board_us,) = protocol.ACK.unpack(message.payload)
        for sent in self._sent:
            if sent.number == message.about:
                time_ns = self._board_clock.note(board_us, sent.sent_ns, now_ns)
                if not sent.part.first:
                    start = SequenceStart(sent.proved.number, time_ns, board_us)
                    self._line.events.started(start)

    def _note_sent(self, proved: ProvedSequence, part: ScanPart, now_ns: int) -> SentPart:
        """Remember what is about to be sent, and return it."""
        sent = SentPart(self._number, proved, part, now_ns)
        self._sent.append(sent)
        self._slots_sent += part.slots * proved.times
        return sent

    def _encoded(self, proved: ProvedSequence) -> list[ScanPart]:
        can = self.can
        room = (can.packet_bytes or LARGEST_PACKET) - OVERHEAD
        switched = can.output != "weighted"
        return encode_scan(
            proved.sequence, proved.times, can.measures, switched, self._image, room, can.max_slots
        )

    def store_kernels(self, table: KernelTable) -> None:
        self._table = table
        self._give_kernels()

    def _give_kernels(self) -> None:
        """Give the board as many kernels as it has room for; the rest goes as currents."""
        can, self._image = self.can, None
        if self._table is None or not can.kernel_bytes or not can.packet_bytes:
            return
        image = KernelImage.of(self._table, can.kernel_bytes, can.most_kernels)
        try:
            give_kernels(self._packets, image, can.packet_bytes, self._line.require_running)
        except KernelTableError as other:
            raise self._line.events.fault(str(other)) from None
        self._image = image

    def _take_offer(self, answer: Message) -> None:
        """Take a board's capabilities if they fit the profile and, once its line was lost, those
        from before. A wrong board has received no more than HELLO."""
        name, known = self._packets.name, self._can if self._line.reopened else None
        found = _offered(answer, name)
        if found.emergency_switch and answer.state & protocol.SWITCH_OPEN:
            raise EmergencyStopError(
                f"the emergency switch of the board at {name} is open: close it, then begin again"
            )
        if known not in (None, found):
            raise OtherDeviceError(f"the board at {name} now is another: only HELLO was sent to it")
        outputs, electrodes = found.electrodes, self._limits.electrodes
        wanted = found.output if self._output is None else self._output.kind
        if (outputs, found.output) != (electrodes, wanted):
            raise BoardError(
                f"the board at {name} has {outputs} electrodes and is {found.output}, the profile "
                f"needs {electrodes} and {wanted}: use the profile of this board"
            )
        self._can = found

    def _ask_account(self) -> tuple[Any, ...]:
        """Return a REPORT: counts, mA and µC, in the order of `protocol.REPORT`."""
        answer = self._packets.ask(MessageKind.STATUS)
        if len(answer.payload) != protocol.REPORT.size:
            raise malformed(self._packets.name)
        fields = protocol.REPORT.unpack(answer.payload)
        strongest_ua, charge_pc, net_pc = fields[4:7]
        return (*fields[:4], strongest_ua / 1e3, charge_pc / 1e6, net_pc / 1e6, *fields[7:])

    def _checked_account(self) -> tuple[Any, ...]:
        """Return the board's account; latch the board if that has what was not sent."""
        now, before, limits = self._account, self._account_before, self._limits
        if now is None:
            now = self._ask_account()
        violations, slots = now[3] - before[3], now[1] - before[1]
        largest_ma = limits.total_ua / 1000 if limits.one_source else limits.current_ua.max() / 1000
        fault = self._line.events.fault
        if violations > self._unsafe_refused:
            raise fault(
                f"the board counted {violations} violations of its own rules, and refused "
                f"{self._unsafe_refused} sequences for one"
            )
        if slots > self._slots_sent:
            raise fault(f"the board delivered {slots} slots where {self._slots_sent} were sent")
        if now[4] > max(before[4], largest_ma):
            raise fault(
                f"the board delivered {now[4]:g} mA, above the {largest_ma:g} mA that may be sent"
            )
        return now

    def status(self) -> BoardReport:
        account = self._checked_account()
        refused = max(0, sum(account[OLD_PACKETS]) - self._packets_before)
        return BoardReport(*(*account[:7], refused))

    def _receive(self, message: Message) -> None:
        """Handle a packet that answers neither a query nor a sequence."""
        match message.kind:
            case MessageKind.ALIVE:
                measures = self._can is not None and self._can.force
                if measures and len(message.payload) == protocol.ALIVE.size:
                    (force_mn,) = protocol.ALIVE.unpack(message.payload)
                    self._line.events.force(force_mn / 1000)
            case MessageKind.VOLTAGES:
                self._note_volts(message)
            case _:
                self._packets.session.refuse()

    def _note_volts(self, message: Message) -> None:
        sent = next((each for each in self._sent if each.number == message.about), None)
        if sent is None:
            return self._packets.session.refuse()
        sequence, part = sent.proved.sequence, sent.part
        found = decode_volts(message.payload)
        if len(found) != part.slots or not len(found):
            return None
        self._volts = [*self._volts, found] if part.first else [found]
        volts = np.concatenate(self._volts)
        if len(volts) == sequence.slots == part.first + part.slots:
            compliance = self.can.compliance_v
            if compliance is not None and volts.max() > MOST_COMPLIANCES * compliance:
                self._suspicion = (
                    f"the board measured {volts.max():.0f} V with a source of {compliance:g} V"
                )
            self._line.events.volts(sequence, volts)
            lifted = compliance is not None and bool((volts >= OPEN_SHARE * compliance).all())
            self._line.events.lift(lifted)
        return None
