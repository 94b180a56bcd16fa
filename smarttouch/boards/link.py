"""Driver of boards that speak our own protocol over a serial line."""

import contextlib
import os
import threading
import time
from typing import Any

import serial

from smarttouch.boards import protocol
from smarttouch.boards.board import Board, BoardReport, Capabilities
from smarttouch.boards.protocol import Kind, Packet, Refusal
from smarttouch.errors import BoardError
from smarttouch.scan.safety import SafetyLimits
from smarttouch.scan.sequence import ScanSequence

HEARTBEAT_S = 0.04
"""Longest silence of the host: the board gives up after 0.1 s."""
SILENCE_S = 0.5
"""Silence of the board, which answers every heartbeat, after which it counts as gone."""
ANSWER_S = 1.0
IN_FLIGHT = 1
"""Sequences sent but not yet begun: the board has one place for those."""
PIECE = 4096
"""Bytes written at once: a stop waits for one piece, not for a whole packet."""
_LINE_ERRORS = (OSError, serial.SerialException, TypeError)
"""What pyserial raises when a port vanishes, or is closed by another thread."""


def open_link(rest: str, limits: SafetyLimits, **options: Any) -> "LinkBoard":
    """Make the driver for ``link:PORT``."""
    if not rest:
        raise BoardError("link: needs a port, for example link:/dev/ttyACM0")
    return LinkBoard(rest, limits, output=options.get("output"))


class LinkBoard(Board):
    """A board at the far end of a serial line.

    One thread reads what comes, one keeps the board alive while nothing is
    sent. Whatever goes wrong on the line is raised at the next call.

    Parameters
    ----------
    port : str
        Device, or any URL that pyserial knows.
    limits : SafetyLimits
        Of the finger's profile.
    output : str, optional
        Kind of outputs that the profile needs.
    """

    def __init__(self, port: str, limits: SafetyLimits, output: str | None = None) -> None:
        super().__init__(limits)
        self._port_name = port
        self._output = output
        self._number = 0
        self._in_flight: set[int] = set()
        self._fault: str | None = None
        self._closing = threading.Event()
        # Reentrant: a signal handler may call stop while its own thread is writing.
        self._writing = threading.RLock()
        self._overtaken = False
        self._serial: serial.SerialBase | None = None
        self._news = threading.Condition()
        self._answers: dict[int, Packet] = {}
        self._threads: list[threading.Thread] = []

    # -- the contract ------------------------------------------------------

    def _open(self) -> None:
        self._closing.clear()
        self._fault = None
        self._overtaken = False
        self._in_flight.clear()
        self._answers.clear()
        self._serial = self._open_port()
        self._last_heard = self._last_written = time.monotonic()
        self._threads = [
            threading.Thread(target=self._read_all, name="board reader", daemon=True),
            threading.Thread(target=self._keep_alive, name="board heartbeat", daemon=True),
        ]
        for thread in self._threads:
            thread.start()
        try:
            self._shake_hands()
        except BaseException:
            self._close()
            raise

    def _send(self, sequence: ScanSequence) -> int:
        self._number += 1
        packet = protocol.encode_sequence(
            self._number,
            self.capabilities.output,
            sequence.period_us,
            sequence.width_us,
            sequence.discharge_us,
            sequence.site,
            sequence.current_ua,
        )
        with self._news:
            room = self._news.wait_for(
                lambda: self._fault is not None or len(self._in_flight) < IN_FLIGHT, ANSWER_S
            )
            self._raise_fault()
            if not room:
                raise BoardError(
                    f"the board at {self._port_name} has not acknowledged sequence "
                    f"{min(self._in_flight)} within {ANSWER_S:g} s: check the line"
                )
            self._in_flight.add(self._number)
        self._write(packet)
        return self._number

    def _stop(self) -> None:
        # From here on there are no heartbeats: without an answer the board's watchdog ends it.
        self._overtaken = True
        if self._serial is None:
            return
        if self._fault is not None:
            with contextlib.suppress(*_LINE_ERRORS):
                self._serial.write(b"\0" + protocol.encode(Kind.STOP))
            return
        try:
            self._ask(Kind.STOP, Kind.STOPPED)
        except BoardError:
            # A board that is gone has been told of, or will be at the next send.
            if self._fault is None:
                raise

    def _close(self) -> None:
        self._closing.set()
        for thread in self._threads:
            if thread is not threading.current_thread():
                thread.join(ANSWER_S)
        if self._serial is not None:
            with contextlib.suppress(*_LINE_ERRORS):
                self._serial.close()

    def report(self) -> BoardReport:
        return BoardReport(*self._status()[:-1])

    def drain(self, timeout_s: float = ANSWER_S) -> None:
        deadline = time.monotonic() + timeout_s
        while self._status()[-1] and time.monotonic() < deadline:
            time.sleep(0.002)

    # -- the line ----------------------------------------------------------

    def _open_port(self) -> serial.SerialBase:
        try:
            return serial.serial_for_url(
                self._port_name, baudrate=921600, timeout=0.05, write_timeout=0.5, exclusive=True
            )
        except (OSError, ValueError, AttributeError) as error:
            text = str(error)
            if "lock" in text or "busy" in text.lower():
                reason = "it is in use by another program: close that first"
            elif "No such file" in text or getattr(error, "errno", None) == 2:
                reason = "there is no such port: check the cable and the name"
            elif "ermission" in text:
                reason = "permission denied: add yourself to the group of the port (often dialout)"
            else:
                reason = text
            raise BoardError(f"cannot open {self._port_name}: {reason}") from None

    def _shake_hands(self) -> None:
        answer = self._ask(Kind.HELLO, Kind.CAPABILITIES)
        if len(answer.payload) < protocol.CAPABILITIES.size:
            raise BoardError(f"the board at {self._port_name} answers nonsense: check its firmware")
        electrodes, output, current_ua, slots, zero_ms = protocol.CAPABILITIES.unpack_from(
            answer.payload
        )
        if output >= len(protocol.OUTPUTS):
            raise BoardError(f"the board at {self._port_name} has outputs of unknown kind {output}")
        self.capabilities = Capabilities(
            electrodes=electrodes,
            output=protocol.OUTPUTS[output],
            max_current_ma=current_ua / 1000,
            max_slots=slots,
            time_to_zero_ms=zero_ms,
            firmware=answer.payload[protocol.CAPABILITIES.size :].decode("utf-8", "replace"),
        )
        wanted = self._gate.limits.electrodes
        if electrodes != wanted:
            raise BoardError(
                f"the board at {self._port_name} has {electrodes} electrodes, the profile "
                f"{wanted}: use the profile of this board"
            )
        if self._output not in (None, self.capabilities.output):
            raise BoardError(
                f"the board at {self._port_name} is {self.capabilities.output}, the profile needs "
                f"{self._output}: use the profile of this board"
            )

    def _ask(self, question: Kind, answer: Kind) -> Packet:
        with self._news:
            self._answers.pop(answer, None)
        # The zero in front ends whatever half packet stands on the line.
        self._write(b"\0" + protocol.encode(question))
        with self._news:
            self._news.wait_for(
                lambda: self._fault is not None or answer in self._answers, ANSWER_S
            )
            self._raise_fault()
            if answer not in self._answers:
                raise BoardError(
                    f"the board at {self._port_name} does not answer: check that it is on and "
                    f"speaks link version {protocol.VERSION}"
                )
            return self._answers.pop(answer)

    def _status(self) -> tuple[Any, ...]:
        answer = self._ask(Kind.STATUS, Kind.REPORT)
        if len(answer.payload) != protocol.REPORT.size:
            raise BoardError(f"the board at {self._port_name} answers nonsense: check its firmware")
        return protocol.REPORT.unpack(answer.payload)

    def _write(self, packet: bytes) -> None:
        if not self._writing.acquire(timeout=ANSWER_S):
            raise BoardError(f"the line to {self._port_name} is blocked: check the cable")
        try:
            assert self._serial is not None
            for start in range(0, len(packet), PIECE):
                if self._overtaken and len(packet) > PIECE:
                    raise BoardError("the board was stopped: open it again before sending")
                self._serial.write(packet[start : start + PIECE])
            self._last_written = time.monotonic()
        except _LINE_ERRORS as error:
            self._fail(f"cannot be written to ({_reason(error)})")
            self._raise_fault()
        finally:
            self._writing.release()

    def _read_all(self) -> None:
        deframer = protocol.Deframer()
        while not self._closing.is_set():
            try:
                assert self._serial is not None
                data = self._serial.read(self._serial.in_waiting or 1)
            except _LINE_ERRORS as error:
                if not self._closing.is_set():
                    self._fail(f"has vanished ({_reason(error)})")
                return
            for packet in deframer.feed(data):
                self._hear(packet)
            if time.monotonic() - self._last_heard > SILENCE_S:
                self._fail(f"has been silent for {SILENCE_S:g} s")
                return

    def _hear(self, packet: Packet) -> None:
        self._last_heard = time.monotonic()
        with self._news:
            if packet.kind == Kind.ACK and packet.number in self._in_flight:
                self._in_flight.discard(packet.number)
                self.acknowledged += 1
            elif packet.kind == Kind.NAK:
                self._refuse(packet)
            else:
                self._answers[packet.kind] = packet
            self._news.notify_all()

    def _refuse(self, packet: Packet) -> None:
        self._in_flight.discard(packet.number)
        self.refused += 1
        reason = packet.payload[0] if packet.payload else 0
        if reason in (Refusal.UNSAFE, Refusal.MALFORMED):
            text = packet.payload[1:].decode("utf-8", "replace")
            self._fault = self._fault or f"refused sequence {packet.number} as unsafe: {text}"
        elif reason == Refusal.STOPPED and not self._overtaken:
            self._fault = self._fault or "has been stopped or started anew by someone else"

    def _keep_alive(self) -> None:
        beat = protocol.encode(Kind.HEARTBEAT)
        while not self._closing.wait(HEARTBEAT_S / 4):
            if self._fault is not None or self._overtaken:
                return
            if time.monotonic() - self._last_written > HEARTBEAT_S:
                try:
                    self._write(beat)
                except BoardError:
                    return

    def _fail(self, what: str) -> None:
        with self._news:
            self._fault = self._fault or what
            self._news.notify_all()

    def _raise_fault(self) -> None:
        if self._fault is not None:
            zero = getattr(getattr(self, "capabilities", None), "time_to_zero_ms", None)
            ends = (
                "" if zero is None else f"; it shorts all electrodes within {zero:g} ms of silence"
            )
            raise BoardError(
                f"the board at {self._port_name} {self._fault}, "
                f"{self.acknowledged} sequences acknowledged{ends}"
            )


def _reason(error: Exception) -> str:
    number = getattr(error, "errno", None)
    return os.strerror(number) if number else (str(error) or type(error).__name__)
