"""Emulated firmware of the ``link`` board: a state machine to which the caller passes the time.

Its checks of sequences are in `link_board_limits`; the host checks sequences with other code."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.wire.framing import Deframer
from smarttouch.boards import link as protocol
from smarttouch.boards.link import Feature, Message, MessageKind, Output, Refusal, Rule
from smarttouch.emulator import link_packets
from smarttouch.emulator.firmware_base import RECHARGE, DeliveryLog, Firmware
from smarttouch.emulator.link_board_limits import (
    MAX_CURRENT_UA,
    RAMP_MS,
    BrokenRule,
    LinkRules,
    Load,
    Room,
)
from smarttouch.emulator.link_packets import BoardSession, ReceivedSequence, decode_lists
from smarttouch.emulator.skin import EmulatedFinger, SkinCircuit

NAME = "SmartTouch board emulator 1"


@dataclass
class _PendingSequence:
    """Accepted sequence that is executing or waiting for its start."""

    number: int
    sequence: ReceivedSequence
    load: Load  # load of one pass
    left: int  # number of remaining passes, including the executing one
    came_ns: int  # time of acceptance
    starts_ns: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))
    over_ns: int = 0  # end of the last slot or recharge phase of this pass
    end_ns: int = 0
    done: int = 0
    volts: list[float] = field(default_factory=list)
    recharge_ns: int | None = None  # start of a recharge phase that is not recorded yet

    def begin(self, start_ns: int, scan_end_ns: int) -> None:
        """Begin a pass. A pass that continues a scan ends at ``scan_end_ns`` or later."""
        sequence = self.sequence
        lengths = sequence.width_us + sequence.discharge_us
        self.done = 0
        self.starts_ns = start_ns + 1000 * (np.cumsum(lengths) - lengths)
        slots_end_ns = start_ns + 1000 * int(lengths.sum())
        self.over_ns = slots_end_ns + 1000 * sequence.recharge_us
        self.end_ns = start_ns + 1000 * sequence.period_us
        if sequence.goes_on:
            self.end_ns = max(scan_end_ns, self.over_ns)
        self.recharge_ns = None if sequence.recharge_ua is None else slots_end_ns
        self.volts.clear()


class LinkFirmware(Firmware):
    """Firmware on a model of the skin. If ``switch_open``, the emergency switch is open."""

    def __init__(
        self,
        output: Output,
        books: DeliveryLog,
        finger: EmulatedFinger | None = None,
        session: BoardSession | None = None,
        # shortest time from zero to full intensity; 0 turns off the ramp in tests
        ramp_ms: int = RAMP_MS,
        room: Room | None = None,
    ) -> None:
        self._electrodes = electrodes = books.electrodes
        self._output, self.books = output, books
        # Checks of many electrodes take long: meanwhile `DeviceClock` must not stand still.
        self.longest_step_ns += 10_000 * electrodes
        self._room = room = room or Room()
        self._rules = LinkRules(electrodes, output, room, ramp_ms)
        self._second = self._rules.second
        self.switch_open = False
        self._skin = SkinCircuit(electrodes)
        self._finger = finger or EmulatedFinger(electrodes)
        self._deframer = Deframer(room.packet_bytes)
        self._session = session or BoardSession()
        self._running: _PendingSequence | None = None
        self._waiting: _PendingSequence | None = None
        self._scan_end_ns = 0
        self._last, self._last_start_ns = (-1, False), 0
        """Number of the last accepted sequence, whether it has begun, and its start, ns."""
        self._refusing: Refusal | None = Refusal.STOPPED
        self._received_ns = 0  # time of the host's last sign of life
        self._packet_ns = 0  # time of the first byte of the current packet
        self._alive_ns = 0
        self._greeted = False
        self._shorted_since_ns = 0
        self._executed_ns = 0
        self._answers: list[bytes] = []

    @property
    def busy(self) -> bool:
        return self._running is not None

    @property
    def pending(self) -> int:
        """Number of executing and waiting sequences."""
        return (self._running is not None) + (self._waiting is not None)

    def feed(self, data: bytes, now_ns: int) -> bytes:
        """Process bytes from the host; return the answer."""
        self._pass_time(now_ns)
        deframer, session, books = self._deframer, self._session, self.books
        garbled = deframer.errors
        first, zero, rest = data.partition(b"\0")
        for piece in (first + zero, rest):
            if not deframer.waiting:
                self._packet_ns = now_ns
            for packet in deframer.feed(piece):
                self._answer(protocol.decode(packet), now_ns)
        if deframer.errors > garbled and self._greeted:
            self._refuse(0, Refusal.GARBLED)
        head = deframer.head(protocol.WHOLE_HEAD_BYTES)
        if head is not None and session.is_sign_of_life(head, self._packet_ns, now_ns):
            self._received_ns = now_ns
        books.framing_errors = deframer.errors
        books.old_packets, books.foreign_packets = session.old, session.foreign
        return self._take_answers()

    def advance(self, now_ns: int) -> bytes:
        """Execute everything that is due; return the answer. The host timeout ends the session."""
        self._pass_time(now_ns)
        return self._take_answers()

    def _take_answers(self) -> bytes:
        answers = b"".join(self._answers)
        self._answers.clear()
        return answers

    def _pass_time(self, now_ns: int) -> None:
        opened = self.switch_open or self._finger.opens_switch(now_ns / 1e9)
        self._session.state = protocol.SWITCH_OPEN * opened
        if opened and self._refusing is None:
            running = self._running
            recharge_ns = None if running is None else running.recharge_ns
            if recharge_ns is not None and recharge_ns <= self._executed_ns:
                # Record the recharge phase until now; skip everything else that is due.
                self._executed_ns = now_ns
            self._end(Refusal.EMERGENCY, "emergency", now_ns)
            self._refuse(0, Refusal.EMERGENCY)
        deadline_ns = self._received_ns + protocol.SILENCE_MS * 1_000_000
        self._execute(min(now_ns, deadline_ns))
        if now_ns >= deadline_ns and self._refusing is None:
            dropped = self._waiting
            self._end(Refusal.SILENCE, "silence", now_ns)
            if dropped is not None:
                self._refuse(dropped.number, Refusal.SILENCE)
        if self._greeted and now_ns - self._alive_ns >= protocol.ALIVE_MS * 1_000_000:
            self._alive_ns = now_ns
            self._finger.at(now_ns / 1e9, self._skin)
            force_mn = min(32767, round(1000 * self._finger.force_n))
            alive = self._session.encode_alive(protocol.ALIVE.pack(force_mn), now_ns)
            self._answers.append(alive)

    def hang_up(self, now_ns: int) -> None:
        """End the session, because the host has closed the line."""
        self.advance(now_ns)
        if self._refusing is not Refusal.STOPPED:
            self._end(Refusal.STOPPED, "host closed", now_ns)
        self._greeted = False

    def _end(self, refusing: Refusal, reason: str, now_ns: int) -> None:
        self.zero(reason, now_ns)
        self._refusing, self._session.live = refusing, False

    def zero(self, reason: str, now_ns: int) -> None:
        """Drop all sequences and short all electrodes."""
        if self._running is not None:
            self._recharge(self._running, self._executed_ns)
            self._second.end(min(now_ns, self._running.over_ns) // 1000)
        self._running = self._waiting = None
        super().zero(reason, now_ns)
        self.books.zero_after_ms = (now_ns - self._received_ns) / 1e6

    # -- sequences -----------------------------------------------------------

    def _execute(self, until_ns: int) -> None:
        self._executed_ns = until_ns
        while (table := self._running) is not None:
            due = int(np.searchsorted(table.starts_ns, until_ns, side="right"))
            for slot in range(table.done, due):
                self._deliver(table, slot)
            table.done = max(table.done, due)
            end_ns, waiting = table.end_ns, self._waiting
            if waiting is not None and waiting.sequence.goes_on:
                # The next part of the scan begins after these slots, before the period ends.
                end_ns = max(table.over_ns, waiting.came_ns)
            if until_ns < end_ns:
                return
            self._recharge(table, until_ns)
            self._end_scan(table, end_ns)

    def _end_scan(self, table: _PendingSequence, end_ns: int) -> None:
        if table.sequence.measure:
            volts = link_packets.encode_volts(np.array(table.volts))
            self._say(MessageKind.VOLTAGES, table.number, volts)
        table.left -= 1
        self._second.end(table.over_ns // 1000)
        if table.left and self._waiting is None:
            self._begin_pass(table, table.end_ns)
            return
        self.books.sequences += not table.sequence.more
        self._scan_end_ns = table.end_ns
        waiting, self._running, self._waiting = self._waiting, None, None
        if waiting is None:
            self.books.state, self.books.reason = "shorted", "end"
        else:
            self._begin(waiting, end_ns)

    def _begin_pass(self, table: _PendingSequence, start_ns: int) -> None:
        table.begin(start_ns, self._scan_end_ns)
        sequence = table.sequence
        self._second.begin(start_ns // 1000, sequence.period_us, table.load, sequence.goes_on)

    def _begin(self, table: _PendingSequence, start_ns: int) -> None:
        self._begin_pass(table, start_ns)
        self._running = table
        self._last, self._last_start_ns = (table.number, True), start_ns
        self._acknowledge()

    def _deliver(self, table: _PendingSequence, slot: int) -> None:
        sequence, start_ns = table.sequence, int(table.starts_ns[slot])
        self._finger.at(start_ns / 1e9, self._skin)
        self._skin.short(max(0, start_ns - self._shorted_since_ns) / 1000)
        width, discharge = int(sequence.width_us[slot]), int(sequence.discharge_us[slot])
        row = sequence.rows[slot]
        if self._output == "weighted":
            delivered = self._skin.pulse(row.astype(np.float64), width)
        else:
            delivered = self._skin.switched_pulse(row, float(sequence.source_ua[slot]), width)
        self._skin.short(discharge)
        self._shorted_since_ns = start_ns + (width + discharge) * 1000
        table.volts.append(delivered.source_v)
        self.books.state = "driving"
        self.books.enter(
            table.number, slot, int(sequence.site[slot]), delivered, width,
            self._skin.residual_uc, start_ns // 1000,
        )  # fmt: skip

    def _recharge(self, table: _PendingSequence, until_ns: int) -> None:
        """Execute the recharge phase. If ``until_ns`` is before its end, cut it short."""
        sequence, start_ns = table.sequence, table.recharge_ns
        if sequence.recharge_ua is None or start_ns is None or until_ns <= start_ns:
            return
        table.recharge_ns = None
        width_us = min(sequence.recharge_us, (until_ns - start_ns) / 1000)
        self._skin.short(max(0, start_ns - self._shorted_since_ns) / 1000)
        delivered = self._skin.pulse(sequence.recharge_ua.astype(np.float64), width_us)
        # Short all electrodes until the end of the scan.
        self._skin.short((table.end_ns - start_ns) / 1000 - width_us)
        self._shorted_since_ns = table.end_ns
        self.books.enter(
            table.number, RECHARGE, RECHARGE, delivered, width_us, self._skin.residual_uc,
            start_ns // 1000,
        )  # fmt: skip

    # -- packets -------------------------------------------------------------

    def _answer(self, message: Message, now_ns: int) -> None:
        session, kind = self._session, message.kind
        if kind == MessageKind.HELLO:
            if answer := session.answer_hello(message, self._capabilities()):
                self._answers.append(answer)
            else:
                self._refuse_packet(Refusal.FOREIGN)
            return
        if kind == MessageKind.BEGIN and session.would_begin(message):
            if session.state:
                refused = BrokenRule(Rule.NONE).nak(Refusal.EMERGENCY)
                self._answers.append(session.refuse_begin(message, refused))
                return
            # A new session starts with all electrodes at zero.
            session.begin(message)
            if self._running is not None:
                self.zero("begin", now_ns)
            self._refusing, self._last, self._greeted = None, (-1, False), True
            self._rules.begin_session()
        elif refusal := session.take(message, self._packet_ns):
            self._refuse_packet(refusal)
            return
        self._received_ns = now_ns
        match kind:
            case MessageKind.BEGIN if self._refusing is None:
                self._say(MessageKind.BEGUN, message.number)
            case MessageKind.SEQUENCE:
                self._accept(message, now_ns)
            case MessageKind.STOP:
                self._end(Refusal.STOPPED, "stop", now_ns)
                self._say(MessageKind.STOPPED, message.number)
            case MessageKind.STATUS:
                self._say(MessageKind.REPORT, message.number, self._report())
            case MessageKind.LIMITS:
                self._rules.take_limits(message.payload)
                taken = self._rules.limits is not None
                self._say(MessageKind.LIMITED, message.number, bytes([taken]))
            case MessageKind.KERNELS:
                self._take_kernels(message)

    def _take_kernels(self, message: Message) -> None:
        size, keep = protocol.KERNELS.size, self._rules.keep
        # Do not change kernels while a sequence uses them.
        if len(message.payload) >= size and not self.pending and self._refusing is None:
            identity, whole_size, offset = protocol.KERNELS.unpack_from(message.payload)
            keep.take(identity, whole_size, offset, message.payload[size:])
        is_complete, proof = keep.weights is not None, keep.proof(self._session.number)
        answer = protocol.KEPT.pack(keep.identity, keep.received, is_complete, proof)
        self._say(MessageKind.KEPT, message.number, answer)

    def _accept(self, message: Message, now_ns: int) -> None:
        number, (last, begun) = message.about, self._last
        if self._refusing is not None:
            opened = bool(self._session.state & protocol.SWITCH_OPEN)
            self._refuse(number, Refusal.EMERGENCY if opened else self._refusing)
        elif number == last:
            if begun:
                self._acknowledge()
        elif number < last:
            self._session.old += 1
            self._refuse_packet(Refusal.OLD)
        elif self._waiting is not None:
            self._refuse(number, Refusal.BUSY)
        elif table := self._check(number, message.payload, now_ns):
            self._last = (number, False)
            if self._running is None:
                self._begin(table, now_ns)
            else:
                self._waiting = table
            self._execute(now_ns)
        else:
            self.books.violations += 1

    def _check(self, number: int, payload: bytes, now_ns: int) -> _PendingSequence | None:
        """Decode and check a sequence. If it is malformed or unsafe, send a NAK; return None."""
        try:
            sequence = decode_lists(payload, self._electrodes, self._output != "weighted")
        except ValueError:
            self._refuse(number, Refusal.MALFORMED)
            return None
        start_ns, running = now_ns, self._running
        if running is not None:
            # A part that continues a scan begins after the slots of the previous part.
            start_ns = max(now_ns, running.over_ns if sequence.goes_on else running.end_ns)
        # The ramp follows real time, so add the time for which the board's clock stood still.
        real_us = start_ns // 1000 + round(1000 * self.books.stood_still_ms)
        broken = self._rules.check(sequence, start_ns // 1000, real_us)
        if isinstance(broken, Load):
            return _PendingSequence(number, sequence, broken, sequence.times, now_ns)
        self._say(MessageKind.NAK, number, broken.nak())
        return None

    def _acknowledge(self) -> None:
        """Send an ACK with the start time of the last sequence."""
        began = protocol.ACK.pack(self._last_start_ns // 1000)
        self._say(MessageKind.ACK, self._last[0], began)

    def _refuse_packet(self, reason: Refusal) -> None:
        if self._session.live:
            self._refuse(0, reason)

    def _refuse(self, number: int, reason: Refusal) -> None:
        self._say(MessageKind.NAK, number, BrokenRule(Rule.NONE).nak(reason))

    def _say(self, kind: MessageKind, about: int = 0, payload: bytes = b"") -> None:
        self._answers.append(self._session.encode(kind, about, payload))

    def _capabilities(self) -> bytes:
        able = Feature.VOLTAGE | Feature.FORCE | Feature.KERNELS | Feature.EMERGENCY
        if self._output == "weighted":
            able |= Feature.RECHARGE
        outputs, room = protocol.OUTPUTS.index(self._output), self._room
        head = protocol.CAPABILITIES.pack(
            self._electrodes, outputs, able, MAX_CURRENT_UA, room.slots, protocol.SILENCE_MS,
            round(self._skin.compliance_v), room.kernel_bytes, room.packet_bytes, room.kernels,
        )  # fmt: skip
        return head + NAME.encode()

    def _report(self) -> bytes:
        books, second = self.books, self._second
        return protocol.REPORT.pack(
            books.sequences, books.slots, books.pulses, books.violations,
            round(1000 * books.max_current_ma), round(1e6 * books.max_charge_uc),
            round(1e6 * books.max_net_charge_uc), self.pending, self._session.old,
            self._session.foreign, second.most_net_pc, -(-second.session_us // 10**6),
            -(-int(second.session[1].max()) // 10**6),
        )  # fmt: skip
