"""Drivers without hardware: emulators in this or another process, and a store in memory."""

import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import quote
from weakref import finalize

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.errors import BoardError
from smarttouch.base.posix import HAS_POSIX
from smarttouch.base.urls import refuse_rest
from smarttouch.boards import link as protocol
from smarttouch.boards.driver import Driver, Line
from smarttouch.boards.link import MessageKind
from smarttouch.boards.link.link_driver import LinkDriver, LinkSession
from smarttouch.boards.reports import Capabilities
from smarttouch.emulator import link_board_limits
from smarttouch.emulator.firmware_base import DeliveryLog
from smarttouch.emulator.link_board import LinkFirmware
from smarttouch.emulator.link_board_limits import Room
from smarttouch.profile.profile_tables import Output
from smarttouch.stimulation.safety_gate import ProvedSequence, SafetyLimits
from smarttouch.stimulation.scan_sequence import ScanSequence

_HEARTBEAT_NS = protocol.SILENCE_MS * 1_000_000 // 2  # longest pause between packets of the host
_STEP_NS = 20_000  # while the host waits for an answer, simulated time advances in these steps
_LONGEST_GAP_NS = 1000 * (link_board_limits.KEPT_US + link_board_limits.SECOND_US)
"""Longest simulated pause between sequences. A longer pause would have the same effect: after this
pause, the ramp restarts, and the limits per second do not count pulses before the pause."""

Pulses = tuple[NDArray[np.uint32], NDArray[np.float32], NDArray[np.int16]]
"""Three arrays that describe N delivered pulses. They have the number of the sequence, (N,); the
width, (N,) µs; and the currents, (N, E) µA, positive cathodic."""


@dataclass
class _PulseLog(DeliveryLog):
    """Delivery log that stores pulses in memory until `take` returns them."""

    _pulses: list[tuple[int, float, NDArray[np.int16]]] = field(default_factory=list, repr=False)

    def keep(self, number: int, width_us: float, current_ua: NDArray[np.float64]) -> None:
        self._pulses.append((number, width_us, np.rint(current_ua).astype(np.int16)))

    def take(self) -> Pulses:
        records, self._pulses = self._pulses, []
        current_ua = np.array([current for _, _, current in records], np.int16)
        return (
            np.array([number for number, _, _ in records], np.uint32),
            np.array([width for _, width, _ in records], np.float32),
            current_ua.reshape(len(records), self.electrodes),
        )


class _DirectSession(LinkSession):
    """Session with firmware that runs in the same thread and on the same simulated clock."""

    def power_up(self, firmware: LinkFirmware) -> None:
        self._firmware, self._now_ns, self._sent_ns = firmware, 0, 0

    def _listen(self) -> None:
        """Start no thread: `_feed` processes the answers to each packet immediately."""
        self.put, self.now_ns = self._feed, lambda: self._now_ns

    def now_s(self) -> float:
        return self._now_ns / 1e9

    def wait(self, condition: Callable[[], bool], timeout_s: float) -> bool:
        end_ns = self._now_ns + int(1e9 * timeout_s)
        while not condition():
            if self._now_ns >= end_ns:
                return False
            self.wait_until(self._now_ns + _STEP_NS)
        return True

    def _feed(self, packet: bytes, proved: ProvedSequence | None) -> None:
        with self.line.current(proved):
            self._sent_ns = self._now_ns
            self.take(self._firmware.feed(packet, self._now_ns))

    def wait_until(self, end_ns: int) -> None:
        """Advance the simulated time, and send the heartbeats that become due."""
        while end_ns - self._sent_ns > _HEARTBEAT_NS:
            self._now_ns = self._sent_ns + _HEARTBEAT_NS
            self.send(MessageKind.HEARTBEAT)
        self._now_ns = end_ns
        self.take(self._firmware.advance(end_ns))


class SimulatedDriver(LinkDriver):
    """Driver of ``simulated:``, a ``link`` board emulated in this thread on a simulated clock. Its
    firmware and packets are those of ``emulator:``. A sequence begins at its time stamp, or later
    if the previous sequence ends later. `write` computes all pulses without waiting."""

    room: Room = Room()  # capacity of the board
    _session: _DirectSession

    def __init__(
        self, rest: str, limits: SafetyLimits, output: Output | None = None, **_: Any
    ) -> None:
        super().__init__("simulated", limits, output)
        refuse_rest("simulated:", rest, BoardError)
        self.port = None
        self._session = _DirectSession(self._receive)
        self._books = _PulseLog(limits.electrodes)
        self._numbers = [0]  # `ProvedSequence.number` of each SEQUENCE packet

    def take_pulses(self) -> Pulses:
        """Return all pulses delivered since the last call."""
        packets, width_us, current_ua = self._books.take()
        return np.array(self._numbers, np.uint32)[packets.astype(np.intp)], width_us, current_ua

    def open(self, line: Line, limits: SafetyLimits) -> Capabilities:
        can = super().open(line, limits)
        # Wait for the first ALIVE packet, which reports the finger's force.
        self._session.wait_until(protocol.ALIVE_MS * 1_000_000)
        return can

    def _connect(self) -> None:
        self._books = _PulseLog(self._limits.electrodes)
        self._firmware = LinkFirmware(
            "weighted" if self._output is None else self._output.kind,
            self._books,
            ramp_ms=link_board_limits.RAMP_MS,
            room=self.room,
        )
        self._line.name = "simulated:"
        self._session.power_up(self._firmware)
        self._number, self._numbers = 0, [0]
        self._stamp_ns = self._ahead_ns = 0
        """Time stamp of the last sequence, and the offset of time stamps from simulated time."""

    def write(self, proved: ProvedSequence) -> None:
        session, sequence = self._session, proved.sequence
        with self._line.current():
            session.wait_until(self._start_ns(sequence.time_ns))
            end_ns = session.now_ns() + sequence.period_us * proved.times * 1000
            before = self._number
            try:
                super().write(proved)
            finally:
                # The driver has sent one packet for each part of the scan.
                self._numbers += [proved.number] * (self._number - before)
            session.wait_until(end_ns)
        if session.fault is not None:
            raise session.fault
        if self._suspicion:
            raise self._line.fault(self._suspicion)

    def _start_ns(self, stamp_ns: int) -> int:
        """Return the simulated time at which a sequence with this time stamp begins, ns."""
        now_ns, before_ns, self._stamp_ns = self._session.now_ns(), self._stamp_ns, stamp_ns
        if not self._number or stamp_ns < before_ns:
            # Begin the sequence now. It is the first one, or its time stamp is earlier than that of
            # the previous sequence.
            self._ahead_ns = stamp_ns - now_ns
        gap_ns = stamp_ns - self._ahead_ns - now_ns
        self._ahead_ns += max(0, gap_ns - _LONGEST_GAP_NS)
        return now_ns + min(max(0, gap_ns), _LONGEST_GAP_NS)

    def zero(self) -> None:
        # `current` locks the line, so a stop from another thread waits until `write` returns.
        with self._line.current():
            super().zero()


class MemoryDriver(Driver):
    """Driver without a device: ``memory:``. It stores all sequences since `open` in a list."""

    def __init__(
        self, rest: str, limits: SafetyLimits, output: Output | None = None, **_: Any
    ) -> None:
        refuse_rest("memory:", rest, BoardError)
        self._kind = "weighted" if output is None else output.kind
        self.sequences: list[ScanSequence] = []

    def open(self, line: Line, limits: SafetyLimits) -> Capabilities:
        self._line = line
        if not line.reopened:
            self.sequences.clear()
        return Capabilities(
            limits.electrodes, self._kind, limits.current_ma, max_slots=0xFFFF,
            time_to_zero_ms=0.0, firmware="memory", recharges=self._kind == "weighted",
        )  # fmt: skip

    def write(self, proved: ProvedSequence) -> None:
        with self._line.current(proved):
            self.sequences.append(proved.sequence)

    def zero(self) -> None:
        """Do nothing: no current flows."""


_STARTS_WITHIN_S = 30.0  # time limit for the start of the process, which busy computers delay
_ENDS_WITHIN_S = 3.0
_FIRST_HOST_S = 5.0  # do not begin to use an older process: without a host, it ends itself at 8 s
_ANSWERS_WITHIN_S = 5.0  # longest allowed silence of the emulator, which a busy computer delays


class EmulatorDriver(LinkDriver):
    """Driver of ``emulator:``, a ``link`` board that is emulated in another process. ``books`` is
    an existing folder for the delivery log. The module `skin` describes the texts of ``events``."""

    def __init__(
        self,
        rest: str,
        limits: SafetyLimits,
        output: Output | None = None,
        books: Path | None = None,
        events: Sequence[str] = (),
    ) -> None:
        refuse_rest("emulator:", rest, BoardError)
        if not HAS_POSIX:
            raise BoardError(
                "an emulated board (emulator:) needs a pseudo-terminal, as on Linux and macOS: "
                "use a simulated board (simulated:)"
            )
        super().__init__("emulator", limits, output)
        self.port = None
        kind = "weighted" if output is None else output.kind
        url = f"link?electrodes={limits.electrodes}&output={kind}&linger=0.2"
        url += f"&ramp_ms={link_board_limits.RAMP_MS}"
        url += "".join(f"&event={quote(event)}" for event in events)
        url += "" if books is None else f"&books={quote(str(books))}"
        self._url = url
        self.process: EmulatorProcess = EmulatorProcess(url)
        self._session.answer_s = self._session.silence_s = _ANSWERS_WITHIN_S

    def _connect(self) -> None:
        if not (self._line.reopened or self.process.is_usable):
            self.process = EmulatorProcess(self._url)
        self._line.connect(self.process.port(self._line))

    def close(self) -> None:
        super().close()
        if not self._line.reopened:
            self._line.disconnect()
            self.process.end()


class EmulatorProcess:
    """Process that emulates a board. The module `devices` describes its URL.

    The constructor starts the process without waiting; `port` waits until it has started. The
    process ends when its host has gone, or when this object is deleted."""

    def __init__(self, url: str) -> None:
        command = [sys.executable, "-m", "smarttouch.emulator", url]
        # A new session, so that Ctrl-C in the terminal does not reach the board.
        self._process = subprocess.Popen(command, stdout=subprocess.PIPE, start_new_session=True)
        self._begun_s, self._port = time.monotonic(), ""
        # Calling `end` or deleting this object ends the process.
        self.end: finalize[..., Any] = finalize(self, _end, self._process, os.getpid())

    @property
    def has_ended(self) -> bool:
        return self._process.poll() is not None

    @property
    def is_usable(self) -> bool:
        """Whether the process is running, and has not waited too long for its first host."""
        waits = self._port or time.monotonic() < self._begun_s + _FIRST_HOST_S
        return self.end.alive and not self.has_ended and bool(waits)

    def port(self, line: Line) -> str:
        """Wait until the process has started, and return the name of its port. Raise an error if
        the board of ``line`` is stopped during the wait."""
        if self.has_ended and self._port:
            raise BoardError("the process of the emulator has ended: open the board again")
        try:
            self._port = self._port or self._printed_port(line)
        except BaseException:
            # End the process, because no host will connect to it.
            self.end()
            raise
        return self._port

    def _printed_port(self, line: Line) -> str:
        output, deadline = self._process.stdout, time.monotonic() + _STARTS_WITHIN_S
        assert output is not None
        while not select.select([output], [], [], 0.02)[0]:
            line.require_running()
            if time.monotonic() > deadline:
                raise BoardError(
                    f"the emulator has not started within {_STARTS_WITHIN_S:g} s: this "
                    "computer is too busy, try again"
                )
        if not (printed := output.readline()):
            status = self._process.wait()
            raise BoardError(f"the emulator exited with status {status}: see its error above")
        return printed.decode().strip()


def _end(process: "subprocess.Popen[bytes]", owner: int) -> None:
    # Only the owner may end the emulator, not a process that was forked from the owner.
    if owner == os.getpid():
        with process:
            process.send_signal(signal.SIGHUP)
            try:
                process.wait(_ENDS_WITHIN_S)
            except subprocess.TimeoutExpired:
                process.kill()
