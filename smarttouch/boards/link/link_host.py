"""Host of a ``link`` board, whatever carries its packets."""

from collections import deque
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.errors import KernelTableError
from smarttouch.base.wire.framing import LARGEST_PACKET
from smarttouch.boards.driver import Driver
from smarttouch.boards.line import Line
from smarttouch.boards.link import protocol as protocol
from smarttouch.boards.link.handshake import (
    OVERHEAD,
    Packets,
    accepted,
    account_of,
    give_kernels,
    give_limits,
)
from smarttouch.boards.link.protocol import Message, MessageKind, decode_volts
from smarttouch.boards.link.sequence_encoding import KernelImage, ScanPart, encode_scan
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


class SentPart(NamedTuple):
    """Sequence on its way, or the part of one that a packet has room for."""

    number: int
    proved: ProvedSequence
    part: ScanPart


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
        self._begun = 0  # number of sequences that the board has acknowledged
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
        give_limits(self._packets, self._limits)
        self._give_kernels()
        self._account_before, self._account = self._ask_account(), None
        self._slots_sent = self._unsafe_refused = 0
        # It may have been switched off meanwhile.
        self._board_clock = BoardClock()

    def _note_start(self, message: Message, sent_ns: int, now_ns: int) -> None:
        (board_us,) = protocol.ACK.unpack(message.payload)
        time_ns = self._board_clock.note(board_us, sent_ns, now_ns)
        for each in self._sent:
            if each.number == message.about and not each.part.first:
                self._begun += 1
                self._line.events.started(SequenceStart(each.proved.number, time_ns, board_us))

    def _note_sent(self, proved: ProvedSequence, part: ScanPart) -> None:
        """Remember what is about to be sent."""
        self._sent.append(SentPart(self._number, proved, part))
        self._slots_sent += part.slots * proved.times

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
        known = self._can if self._line.reopened else None
        self._can = accepted(
            answer, self._packets.name, self._limits.electrodes, self._output, known
        )

    def _ask_account(self) -> tuple[Any, ...]:
        return account_of(self._packets.ask(MessageKind.STATUS), self._packets.name)

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
        return replace(BoardReport(*account[:7]), refused_packets=refused)

    def _receive(self, message: Message) -> None:
        """Handle a packet that answers neither a query nor a sequence."""
        match message.kind:
            case MessageKind.ALIVE:
                if len(message.payload) == protocol.ALIVE.size:
                    self._press(*protocol.ALIVE.unpack(message.payload))
            case MessageKind.VOLTAGES:
                self._note_volts(message)
            case _:
                self._packets.session.refuse()

    def _press(self, force_mn: int) -> None:
        if self._can is not None and self._can.force:
            self._line.events.force(force_mn / 1000)

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
