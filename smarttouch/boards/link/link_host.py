"""Host of a ``link`` board, whatever carries its packets."""

from collections import deque
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.errors import BoardError, KernelTableError, LineLostError
from smarttouch.base.wire.framing import LARGEST_PACKET
from smarttouch.boards.board import Board, BoardReport, Capabilities
from smarttouch.boards.link import protocol as protocol
from smarttouch.boards.link.handshake import (
    OVERHEAD,
    Line,
    accepted,
    account_of,
    give_kernels,
    give_limits,
)
from smarttouch.boards.link.protocol import Message, MessageKind, decode_volts
from smarttouch.boards.link.sequence_encoding import KernelImage, ScanPart, encode_scan
from smarttouch.boards.probe_scans import measure_in_pairs, probe_sequences
from smarttouch.boards.reports import SATURATED, Impedance, SequenceStart, judge
from smarttouch.profile.device import Output
from smarttouch.stimulation.safety_gate import SafetyLimits
from smarttouch.stimulation.scan_sequence import KernelTable, ScanSequence

OLD_PACKETS = slice(8, 10)
"""Places of packets refused as old and as of another session in a board's account."""
MOST_COMPLIANCES = 2.1
"""Bound of a slot's voltage: sources of both poles at their limit reach twice the compliance."""
OPEN_SHARE = 0.97
"""Part of the compliance: if every slot reaches it, nothing touches the electrodes."""

_MOST_STARTS = 256

Measured = tuple[ScanSequence, NDArray[np.float32]]


class SentPart(NamedTuple):
    """Sequence on its way, or the part of one that a packet has room for."""

    number: int
    sequence: ScanSequence
    part: ScanPart


class BoardClock:
    """Reads a board's clock as the host's, by the answer that came fastest of the last few."""

    def __init__(self) -> None:
        self._ahead_ns: deque[int] = deque(maxlen=16)
        self.starts: dict[int, SequenceStart] = {}
        """Of the last `_MOST_STARTS` sequences, by their numbers."""

    def note(self, number: int, board_us: int, sent_ns: int, now_ns: int) -> None:
        """Take the start of a sequence that was sent at a time, and its answer now."""
        if self._ahead_ns and 1000 * board_us + min(self._ahead_ns) < sent_ns:
            # No sequence begins before it is sent: the board's clock has stood still.
            self._ahead_ns.clear()
        self._ahead_ns.append(now_ns - 1000 * board_us)
        time_ns = 1000 * board_us + min(self._ahead_ns)
        self.starts[number] = SequenceStart(number, time_ns, board_us)
        if len(self.starts) > _MOST_STARTS:
            del self.starts[next(iter(self.starts))]


class LinkHost(Board):
    """Base of drivers of ``link`` boards: kernels, voltages and accounts; `_line` carries packets,
    and a subclass numbers and sends sequences."""

    keeps_kernels = True
    _spins = False
    _line: Line

    def __init__(self, limits: SafetyLimits, output: Output | None = None) -> None:
        super().__init__(limits, output)
        self._number = 0
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
        self._measured: deque[Measured] = deque(maxlen=64)

    def _set_up(self) -> None:
        """Give limits and kernels to a board whose session has begun, and start its account."""
        give_limits(self._line, self._gate.limits)
        self._give_kernels()
        self._account_before = self._status()
        self._slots_sent = self._unsafe_refused = 0
        # It may have been switched off meanwhile.
        self._board_clock = BoardClock()

    def start_of(self, number: int) -> SequenceStart | None:
        return self._board_clock.starts.get(number)

    def _note_start(self, message: Message, sent_ns: int, now_ns: int) -> None:
        self.acknowledged += any(
            each.number == message.about and not each.part.first for each in self._sent
        )
        (board_us,) = protocol.ACK.unpack(message.payload)
        self._board_clock.note(message.about, board_us, sent_ns, now_ns)

    def _note_sent(self, sequence: ScanSequence, part: ScanPart, times: int) -> None:
        """Remember what is about to be sent."""
        self._sent.append(SentPart(self._number, sequence, part))
        self._slots_sent += part.slots * times

    def _encoded(self, sequence: ScanSequence, times: int) -> list[ScanPart]:
        can = self.capabilities
        room = (can.packet_bytes or LARGEST_PACKET) - OVERHEAD
        switched = self._kind != "weighted"
        return encode_scan(
            sequence, times, can.measures, switched, self._image, room, can.max_slots
        )

    def keep_kernels(self, table: KernelTable) -> None:
        self._table = table
        self._require_open("giving it kernels")
        try:
            self._give_kernels()
        except LineLostError as lost:
            self._recover(lost)

    def _give_kernels(self) -> None:
        """Give the board as many kernels as it has room for; the rest goes as currents."""
        can, self._image = self.capabilities, None
        if self._table is None or not can.kernel_bytes or not can.packet_bytes:
            return
        image = KernelImage.of(self._table, can.kernel_bytes, can.most_kernels)
        try:
            give_kernels(self._line, image, can.packet_bytes, self._go_on_unless_stopped)
        except KernelTableError as other:
            raise self._latch(str(other)) from None
        self._image = image

    def _take_offer(self, answer: Message, known: Capabilities | None = None) -> None:
        self._kind, can = accepted(
            answer, self._line.name, self._gate.limits.electrodes, self._output, known
        )
        self.capabilities: Capabilities = can

    def _status(self) -> tuple[Any, ...]:
        return account_of(self._line.ask(MessageKind.STATUS), self._line.name)

    def _checked_account(self) -> tuple[Any, ...]:
        """Return the board's account; latch the board if that has what was not sent."""
        now, before, limits = self._status(), self._account_before, self._gate.limits
        violations, slots = now[3] - before[3], now[1] - before[1]
        largest_ma = limits.total_ua / 1000 if limits.one_source else limits.current_ua.max() / 1000
        if violations > self._unsafe_refused:
            raise self._latch(
                f"the board counted {violations} violations of its own rules, and refused "
                f"{self._unsafe_refused} sequences for one"
            )
        if slots > self._slots_sent:
            raise self._latch(
                f"the board delivered {slots} slots where {self._slots_sent} were sent"
            )
        if now[4] > max(before[4], largest_ma):
            raise self._latch(
                f"the board delivered {now[4]:g} mA, above the {largest_ma:g} mA that may be sent"
            )
        return now

    def report(self) -> BoardReport:
        account = self._checked_account()
        refused = max(0, sum(account[OLD_PACKETS]) - self._packets_before)
        return replace(BoardReport(*account[:7]), refused_packets=refused)

    def take_volts(self) -> list[Measured]:
        return [self._measured.popleft() for _ in range(len(self._measured))]

    def _measure(self) -> Impedance:
        can = self.capabilities
        if not can.measures or can.compliance_v is None:
            return super()._measure()
        self.take_volts()
        for probe in probe_sequences(self._gate.limits, self._output):
            volts = self._probed(probe)
        limits = self._gate.limits
        saturated = can.output == "weighted" and (volts >= SATURATED * can.compliance_v).any()
        if saturated and not limits.masked:
            level_ua = int(np.abs(probe.current_ua).max())
            return measure_in_pairs(
                self._probed, limits, level_ua, probe.intensity, probe.time_ns, can.compliance_v
            )
        # A masked electrode is not driven, and counts as open.
        every = np.full(limits.electrodes, can.compliance_v)
        every[probe.site] = volts
        return judge(every, probe.source_ua[0] / 1000, can.compliance_v)

    def _probed(self, probe: ScanSequence) -> NDArray[np.float64]:
        """Deliver a scan and return its voltages."""
        self.send(probe)
        self.drain()
        found = [
            volts for sequence, volts in self.take_volts() if sequence.time_ns == probe.time_ns
        ]
        if probe.slots and not found:
            raise BoardError(
                f"the board at {self._line.name} did not report the voltages of its electrodes: "
                "measure again"
            )
        return found[-1].astype(np.float64) if found else np.empty(0)

    def _receive(self, message: Message) -> None:
        """Handle a packet that answers neither a query nor a sequence."""
        match message.kind:
            case MessageKind.ALIVE:
                if len(message.payload) == protocol.ALIVE.size:
                    self._press(*protocol.ALIVE.unpack(message.payload))
            case MessageKind.VOLTAGES:
                self._note_volts(message)
            case _:
                self._line.session.refuse()

    def _press(self, force_mn: int) -> None:
        if hasattr(self, "capabilities") and self.capabilities.force:
            self.force_n: float | None = force_mn / 1000

    def _note_volts(self, message: Message) -> None:
        sent = next((each for each in self._sent if each.number == message.about), None)
        if sent is None:
            return self._line.session.refuse()
        sequence, part = sent.sequence, sent.part
        found = decode_volts(message.payload)
        if len(found) != part.slots or not len(found):
            return None
        self._volts = [*self._volts, found] if part.first else [found]
        volts = np.concatenate(self._volts)
        if len(volts) == sequence.slots == part.first + part.slots:
            compliance = self.capabilities.compliance_v
            if compliance is not None and volts.max() > MOST_COMPLIANCES * compliance:
                self._suspicion = (
                    f"the board measured {volts.max():.0f} V with a source of {compliance:g} V"
                )
            self._measured.append((sequence, volts))
            self.lifted: bool = compliance is not None and bool(
                (volts >= OPEN_SHARE * compliance).all()
            )
        return None
