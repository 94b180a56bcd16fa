"""What runs on the board: a state machine with no clock of its own.

It checks every sequence again, by its own rules and in its own code: a host
that proves its sequences safe must not be the only one who looks.
"""

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smarttouch.boards import protocol
from smarttouch.boards.emulator.books import Books
from smarttouch.boards.emulator.skin import Skin
from smarttouch.boards.protocol import Kind, Output, Packet, Refusal, WireSequence

MAX_CURRENT_UA = 5000
MAX_WIDTH_US = 200
MAX_CHARGE_PC = 500_000
MIN_PERIOD_US = 5000
MAX_SLOTS = 4096
NAME = "SmartTouch board emulator 1"


@dataclass
class _Running:
    number: int
    sequence: WireSequence
    current_ua: NDArray[np.float64]
    start_ns: int
    starts_ns: NDArray[np.int64]
    end_ns: int
    done: int = 0
    begun: bool = False


class Firmware:
    """The board between its serial line and its electrodes.

    Parameters
    ----------
    electrodes : int
        How many outputs it has.
    output : str
        What they can do.
    books : Books
        Where all that flows is written down.
    """

    def __init__(self, electrodes: int, output: Output, books: Books) -> None:
        self._electrodes, self._output, self.books = electrodes, output, books
        self._skin = Skin(electrodes)
        self._deframer = protocol.Deframer()
        self._plan: deque[_Running] = deque()
        self._stopped = True
        self._heard_ns = 0
        self._shorted_since_ns = 0
        self._answers: list[bytes] = []

    @property
    def busy(self) -> bool:
        return bool(self._plan)

    def feed(self, data: bytes, now_ns: int) -> bytes:
        """Take bytes from the host; return what there is to answer."""
        self._advance(now_ns)
        self._heard_ns = now_ns
        for packet in self._deframer.feed(data):
            self._answers.append(self._answer(packet, now_ns))
        self.books.framing_errors = self._deframer.errors
        return self._take_answers()

    def advance(self, now_ns: int) -> bytes:
        """Do all that is due, and fall silent with the host; return what there is to answer."""
        self._advance(now_ns)
        return self._take_answers()

    def _take_answers(self) -> bytes:
        answers = b"".join(self._answers)
        self._answers.clear()
        return answers

    def _advance(self, now_ns: int) -> None:
        deadline_ns = self._heard_ns + protocol.SILENCE_MS * 1_000_000
        self._execute(min(now_ns, deadline_ns))
        if now_ns >= deadline_ns and self._plan:
            dropped = [running.number for running in self._plan if not running.begun]
            self.zero("silence", now_ns)
            self._answers += [_refuse(number, Refusal.SILENCE, "dropped") for number in dropped]

    def hang_up(self, now_ns: int) -> None:
        """The host has closed the line; the next one has to say HELLO."""
        self._advance(now_ns)
        self._answers.clear()
        if not self._stopped:
            self.zero("host closed", now_ns)
            self._stopped = True

    def zero(self, reason: str, now_ns: int) -> None:
        """Drop everything that waits and short all electrodes."""
        self._plan.clear()
        self.books.state, self.books.reason = "shorted", reason
        self.books.zero_after_ms = (now_ns - self._heard_ns) / 1e6

    def _execute(self, until_ns: int) -> None:
        while self._plan:
            running = self._plan[0]
            if not running.begun and running.start_ns <= until_ns:
                running.begun = True
                self._answers.append(protocol.encode(Kind.ACK, running.number))
            due = int(np.searchsorted(running.starts_ns, until_ns, side="right"))
            for slot in range(running.done, due):
                self._deliver(running, slot)
            running.done = max(running.done, due)
            if until_ns < running.end_ns:
                return
            self._plan.popleft()
            self.books.sequences += 1
            if not self._plan:
                self.books.state, self.books.reason = "shorted", "end"

    def _deliver(self, running: _Running, slot: int) -> None:
        sequence, current = running.sequence, running.current_ua[slot]
        start_ns = int(running.starts_ns[slot])
        self._skin.short(max(0, start_ns - self._shorted_since_ns) / 1000)
        width, discharge = int(sequence.width_us[slot]), int(sequence.discharge_us[slot])
        self._skin.pulse(current, width)
        self._skin.short(discharge)
        self._shorted_since_ns = start_ns + (width + discharge) * 1000
        self.books.state = "driving"
        self.books.enter(
            running.number, slot, int(sequence.site[slot]), current, width, self._skin.worst_uc
        )

    def _answer(self, packet: Packet, now_ns: int) -> bytes:
        match packet.kind:
            case Kind.HELLO:
                # A new host starts from zero, whatever the one before left.
                if self._plan:
                    self.zero("hello", now_ns)
                self._stopped = False
                return protocol.encode(Kind.CAPABILITIES, 0, self._capabilities())
            case Kind.SEQUENCE:
                return self._accept(packet, now_ns)
            case Kind.HEARTBEAT:
                return protocol.encode(Kind.ALIVE)
            case Kind.STOP:
                self._stopped = True
                self.zero("stop", now_ns)
                return protocol.encode(Kind.STOPPED)
            case Kind.STATUS:
                return protocol.encode(Kind.REPORT, 0, self._report())
        return b""

    def _accept(self, packet: Packet, now_ns: int) -> bytes:
        if self._stopped:
            return _refuse(packet.number, Refusal.STOPPED, "stopped; say HELLO first")
        if len(self._plan) >= 2:
            return _refuse(packet.number, Refusal.BUSY, "one executing and one waiting")
        try:
            sequence = protocol.decode_sequence(packet.payload)
        except ValueError as error:
            self.books.violations += 1
            return _refuse(packet.number, Refusal.MALFORMED, str(error))
        current = self._currents(sequence)
        complaint = self._complaint(sequence, current)
        if complaint or current is None:
            self.books.violations += 1
            return _refuse(packet.number, Refusal.UNSAFE, complaint or "no currents")
        start_ns = max(now_ns, self._plan[-1].end_ns) if self._plan else now_ns
        lengths = sequence.width_us.astype(np.int64) + sequence.discharge_us
        starts_ns = start_ns + 1000 * (np.cumsum(lengths) - lengths)
        end_ns = start_ns + 1000 * sequence.period_us
        self._plan.append(_Running(packet.number, sequence, current, start_ns, starts_ns, end_ns))
        self._execute(now_ns)
        return b""

    def _currents(self, sequence: WireSequence) -> NDArray[np.float64] | None:
        """Return what will flow, (S, E) µA; a source divides equally among equal electrodes."""
        if sequence.current_ua is not None:
            return sequence.current_ua.astype(np.float64)
        if sequence.state is None or sequence.source_ua is None:
            return None
        share = np.zeros(sequence.state.shape)
        for pole in (1, -1):
            connected = sequence.state == pole
            count = np.maximum(connected.sum(axis=1, keepdims=True), 1)
            share += pole * connected / count
        return share * sequence.source_ua[:, None]

    def _complaint(self, sequence: WireSequence, current: NDArray[np.float64] | None) -> str:
        """Return what is wrong with a sequence, by the board's own rules; empty if nothing."""
        weighted = self._output == "weighted"
        if current is None or sequence.electrodes != self._electrodes:
            return f"{sequence.electrodes} electrodes on a board of {self._electrodes}"
        if weighted != (sequence.current_ua is not None):
            return f"wrong kind of sequence for a {self._output} board"
        if len(sequence.width_us) > MAX_SLOTS:
            return f"{len(sequence.width_us)} slots"
        if sequence.period_us < MIN_PERIOD_US:
            return f"period {sequence.period_us} us"
        width = sequence.width_us.astype(np.int64)
        if int((width + sequence.discharge_us).sum()) > sequence.period_us:
            return "slots do not fit the period"
        if len(width) and not 0 < int(width.min()) <= int(width.max()) <= MAX_WIDTH_US:
            return f"pulse width {int(width.max())} us"
        if np.any(np.abs(current.sum(axis=1)) > 1e-6):
            return "a slot is out of balance"
        peaks = np.abs(current).max(axis=1, initial=0)
        if np.any(peaks > MAX_CURRENT_UA):
            return f"current {peaks.max():.0f} uA"
        if np.any(peaks * width > MAX_CHARGE_PC):
            return f"charge {(peaks * width).max():.0f} pC"
        if sequence.state is not None and self._states_wrong(sequence.state):
            return "a slot without both poles, or with an unknown state"
        return ""

    def _states_wrong(self, state: NDArray[np.int8]) -> bool:
        cathodes, anodes = (state == 1).sum(axis=1), (state == -1).sum(axis=1)
        wrong = (state == 2).any(axis=1) | (cathodes == 0) | (anodes == 0)
        if self._output == "one-against-all":
            wrong |= (state == 0).any(axis=1) | (np.minimum(cathodes, anodes) != 1)
        return bool(wrong.any())

    def _capabilities(self) -> bytes:
        head = protocol.CAPABILITIES.pack(
            self._electrodes,
            protocol.OUTPUTS.index(self._output),
            MAX_CURRENT_UA,
            MAX_SLOTS,
            protocol.SILENCE_MS,
        )
        return head + NAME.encode()

    def _report(self) -> bytes:
        books = self.books
        return protocol.REPORT.pack(
            books.sequences,
            books.slots,
            books.pulses,
            books.violations,
            books.max_current_ma,
            books.max_charge_uc,
            books.max_net_charge_uc,
            len(self._plan),
        )


def _refuse(number: int, reason: Refusal, text: str) -> bytes:
    return protocol.encode(Kind.NAK, number, bytes([reason]) + text.encode())
