"""Driver of boards that implement our own protocol over a serial line."""

import time
from collections import deque
from typing import Never

from smarttouch.base.clock import LATE_NS
from smarttouch.base.errors import BoardError, BoardFaultError, EmergencyStopError, LineLostError
from smarttouch.base.wire.port import (
    Port,
    UsbIdentity,
    device_of,
    identity_of,
    open_port,
    reopen_port,
)
from smarttouch.boards.board import Capabilities
from smarttouch.boards.faults import restart_lost_board, slow_line_notes
from smarttouch.boards.link import protocol as protocol
from smarttouch.boards.link.handshake import reason_of
from smarttouch.boards.link.link_host import OLD_PACKETS, LinkHost
from smarttouch.boards.link.packet_line import ANSWER_S, LinkLine
from smarttouch.boards.link.protocol import Message, MessageKind, Refusal, Rule
from smarttouch.boards.link.sequence_encoding import ScanPart
from smarttouch.profile.device import Output
from smarttouch.stimulation.safety_gate import Rise, SafetyLimits
from smarttouch.stimulation.safety_limits import parts_per_billion
from smarttouch.stimulation.scan_sequence import ScanSequence

RECOVER_S = 3.0  # time to wait for a lost port
AGAIN_S = 0.04
"""Time after which a sequence without an ACK is sent again, unless it is too late for it."""
IN_FLIGHT = 1  # sequences sent but not yet begun: the board has one place for them
AFTER_ZERO_S = 0.02
"""Time after a stop in which the board's count of slots must stand still: a period at 50 Hz."""


class LinkBoard(LinkHost):
    """Board at the far end of a serial line: ``link:PORT``, a device or any URL that pyserial
    knows. Limits and output are of the finger's profile."""

    drives_in_send = False
    _line: LinkLine

    def __init__(self, port: str, limits: SafetyLimits, output: Output | None = None) -> None:
        super().__init__(limits, output)
        self._line = LinkLine(port, self._receive, self._aftermath, self._send_again)
        self._in_flight: dict[int, tuple[bytes, int]] = {}
        """Payload, and when it was sent, of each sequence without an answer."""
        self._repeated: deque[int] = deque(maxlen=64)
        """Sequences sent more than once: they may be answered more than once."""
        self._stop_answered = False
        self._identity: UsbIdentity | None = None
        self._in_flight_due_ns = 0
        self._in_flight_ppb, self._in_flight_ns = (0, 0), 0
        self._rises = True
        # The line may be slower than the gate: the rise that the skin gets is the line's.
        self._rise = Rise(limits.ramp_ns)
        self._again_s = 0.0

    # -- the contract ------------------------------------------------------

    @property
    def device(self) -> str | None:
        return device_of(self._line.name) if self._line.name else None

    def _open(self) -> None:
        if not self._line.name:
            raise BoardError("link: needs a port, for example link:/dev/ttyACM0")
        port = open_port(self._line.name)
        self._identity = identity_of(port)
        self._packets_before = 0
        self._start(port)
        self._packets_before = sum(self._account_before[OLD_PACKETS])

    def _start(self, port: Port, known: Capabilities | None = None) -> None:
        self._in_flight.clear()
        self._rise.restart()
        self._stop_answered, self._suspicion = False, ""
        self._line.open(port)
        try:
            self._shake_hands(known)
        except BaseException:
            self._line.close()
            raise

    def _recover(self, lost: LineLostError) -> None:
        # A board still in its session would refuse the next HELLO.
        self._line.stop_blindly()
        self._line.close()
        restart_lost_board(self._start_again, lost)

    def _start_again(self) -> None:
        port = reopen_port(self._line.name, RECOVER_S, self._identity, self._pause)
        self._start(port, self.capabilities)

    def _send(self, sequence: ScanSequence, times: int) -> int:
        parts = self._encoded(sequence, times)
        first = self._number + 1
        for part in parts:
            self._number += 1
            self._wait_for_room()
            self._send_part(sequence, part, times)
        return first

    def _send_part(self, sequence: ScanSequence, part: ScanPart, times: int) -> None:
        """Send a sequence, or a part of one, which is due when the part before has begun; what
        rises is noted once, with the first."""
        ppb = parts_per_billion(sequence.intensity)
        strength_ppb = self._gate.limits.strength_of(sequence)
        due_ns = max(self._due_ns, self._clock.now_ns()) if part.first else self._due_ns
        if self._is_late(due_ns) or not (
            part.first
            or not sequence.drives
            or self._rise.permits(strength_ppb, self._clock.now_ns())
        ):
            self._drop_late()
        with self._line.news:
            self._in_flight[self._number] = part.payload, self._clock.now_ns()
            self._in_flight_due_ns, self._in_flight_ppb = due_ns, (ppb, strength_ppb)
            self._in_flight_ns = 1000 * sequence.period_us * times * sequence.drives
            self._rises = not part.first
            self._again_s = self._line.now_s() + AGAIN_S
            self._note_sent(sequence, part, times)
        if not self._write_in_time(self._number, part.payload):
            with self._line.news:
                self._in_flight.pop(self._number, None)
            self._drop_late()

    def _drop_late(self) -> Never:
        """Count a sequence that is not sent; the next one must begin at zero."""
        self._rise.restart()
        self.dropped_late += 1
        raise self._late()

    def _write_in_time(self, number: int, payload: bytes) -> bool:
        """Write the sequence in flight, unless it is too late for it."""
        latest_ns = self._in_flight_due_ns + LATE_NS
        with self._driving():
            went = self._line.send(
                MessageKind.SEQUENCE,
                number,
                payload,
                latest_ns=latest_ns,
                now_ns=self._clock.now_ns,
            )
        if went and self._rises:
            self._rise.note(*self._in_flight_ppb, self._clock.now_ns(), self._in_flight_ns)
        return went

    def _wait_for_room(self) -> None:
        line = self._line
        with line.news:
            if line.wait(
                lambda: (
                    line.fault is not None
                    or len(self._in_flight) < IN_FLIGHT
                    or self._stopped.is_set()
                ),
                line.answer_s,
            ):
                line.raise_fault()
                self._go_on_unless_stopped()
                return
            number = next(iter(self._in_flight))
        what = f"has not acknowledged sequence {number} within {line.answer_s:g} s"
        raise line.lost(what)

    def _send_again(self) -> None:
        """Send a sequence without an ACK once more, unless it is too late for it.

        It has the same number: the board recognizes it if only the ACK was lost.
        """
        if self._suspicion:
            self._line.fail(self._latch(self._suspicion))
            return
        if self._stopped.is_set():
            return
        # Nothing newer can go out between the look and the write.
        with self._driving():
            with self._line.news:
                now_s = self._line.now_s()
                if not self._in_flight or now_s < self._again_s:
                    return
                self._again_s = now_s + AGAIN_S
                number, (payload, _) = next(iter(self._in_flight.items()))
                self._repeated.append(number)
                self._unsafe_refused += 1
            self._write_in_time(number, payload)

    def _interrupt(self) -> None:
        self._line.overtake()

    def _stop(self) -> None:
        self._line.overtake()
        if not self._line.opened:
            return
        if self._line.fault is not None or not self._line.session.begun:
            self._line.stop_blindly()
            return
        try:
            self._line.ask(MessageKind.STOP)
            self._stop_answered = True
        except BoardError:
            # A lost board has been reported, or will be at the next send.
            if self._line.fault is None:
                raise

    def _close(self) -> None:
        try:
            # A halt does not wait; after a fault there is nothing to check.
            if self._stop_answered and not self._halted and self._line.fault is None:
                self._check_zero()
        finally:
            self._line.close()

    def _check_zero(self) -> None:
        """Latch the board if it delivers slots after it has confirmed a stop."""
        try:
            slots = self._checked_account()[1]
            time.sleep(AFTER_ZERO_S)
            if self._checked_account()[1] != slots:
                raise self._latch("the board delivered pulses after it had confirmed zero")
        except BoardFaultError:
            raise
        except BoardError:
            # It has confirmed zero; what has become of the line since then changes nothing.
            return

    def drain(self, timeout_s: float = ANSWER_S) -> None:
        line, deadline = self._line, self._line.now_s() + timeout_s
        while self._status()[7] and line.now_s() < deadline:
            with line.news:
                line.wait(lambda: False, 0.002)

    @property
    def refused_packets(self) -> int:
        return self._line.refused

    # -- packets of the board ----------------------------------------------

    def _shake_hands(self, known: Capabilities | None) -> None:
        self._line.begin(lambda offer: self._take_offer(offer, known), self._stopped)
        self._set_up()
        self.notes += slow_line_notes(self._status)

    def _receive(self, message: Message) -> None:
        """Handle an unrequested packet."""
        if message.state & protocol.SWITCH_OPEN and self._has_switch:
            self._line.fail(self._emergency())
        match message.kind:
            case MessageKind.ACK if len(message.payload) == protocol.ACK.size:
                if (sent_ns := self._answered(message)) is not None:
                    self._note_start(message, sent_ns, self._clock.now_ns())
            case MessageKind.NAK:
                self._refused(message)
            case _:
                super()._receive(message)

    def _answered(self, message: Message) -> int | None:
        """Return when the sequence that this answers was sent; count it if it answers none."""
        if (answered := self._in_flight.pop(message.about, None)) is not None:
            return answered[1]
        if message.about not in self._repeated:
            self._line.session.refuse()
        return None

    @property
    def _has_switch(self) -> bool:
        return hasattr(self, "capabilities") and self.capabilities.emergency_switch

    def _emergency(self) -> EmergencyStopError:
        return EmergencyStopError(
            f"the emergency switch of the board at {self._line.name} was opened: all electrodes "
            "are at zero; close it, then begin again"
        )

    def _refused(self, message: Message) -> None:
        why, rule, words = reason_of(message)
        if why == Refusal.EMERGENCY:
            self._line.fail(self._emergency())
            return
        if why in (Refusal.GARBLED, Refusal.OLD, Refusal.FOREIGN):
            # Our own part of it is sent again; REPORT counts the rest.
            return
        if self._answered(message) is None:
            return
        self.refused += 1
        line = self._line
        if why in (Refusal.UNSAFE, Refusal.MALFORMED):
            self._unsafe_refused += 1
            # Clocks differ: what rose too fast for the board's restarts at zero.
            fault = line.lost if rule == Rule.RISE else line.gone
            line.fail(fault(f"refused sequence {message.about} as unsafe: {words}"))
        elif why == Refusal.STOPPED and not line.overtaken:
            line.fail(line.gone("has been stopped or restarted by another program"))
        elif why == Refusal.SILENCE:
            line.fail(line.lost("received nothing for 100 ms"))

    def _aftermath(self) -> str:
        done = f", {self.acknowledged} sequences acknowledged"
        if not hasattr(self, "capabilities"):
            return done
        zero_ms = self.capabilities.time_to_zero_ms
        return f"{done}; it shorts all electrodes within {zero_ms:g} ms of silence"
