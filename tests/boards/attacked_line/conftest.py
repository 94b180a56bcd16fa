"""Host, board, and an attacker on their line, in one thread with a simulated clock."""

import contextlib
import random
import struct
import zlib
from collections import Counter
from types import SimpleNamespace

import numpy as np
import pytest
from cobs import cobs

from smarttouch.base.clock import LATE_NS
from smarttouch.base.errors import BoardError
from smarttouch.boards.board import Board
from smarttouch.boards.link import HALF
from smarttouch.boards.link.link_driver import LinkDriver, LinkSession
from smarttouch.emulator.firmware_base import DeliveryLog
from smarttouch.emulator.link_board import LinkFirmware
from smarttouch.emulator.link_packets import BoardSession
from smarttouch.profile.profile_tables import Output
from smarttouch.stimulation.safety_gate import SafetyLimits

from ...support.scans import unproved

MS = 1_000_000
LIMITS = SafetyLimits(4, 3.0, 200, 0.5, 200, 0.8, 0.5, 2.4)
HELLO, BEGIN, CAPABILITIES = 0x01, 0x06, 0x81
FAULTS = ("drop", "twice", "later", "behind", "again", "foreign", "flip", "cut")


class KeptBooks(DeliveryLog):
    """Delivery log that also keeps the sequence number, currents and time of each pulse."""

    def enter(self, number, slot, site, delivered, width_us, residual_uc, time_us, **more):
        super().enter(number, slot, site, delivered, width_us, residual_uc, time_us, **more)
        self.kept.append((number, tuple(np.rint(delivered.current_ua).astype(int)), time_us))


def parse(piece):
    """Return body, kind, number and session of a frame, or None if its bytes are damaged."""
    try:
        body = cobs.decode(piece)
    except cobs.DecodeError:
        return None
    if len(body) < 27 or zlib.crc32(body[:-4]) != int.from_bytes(body[-4:], "little"):
        return None
    _, kind, number, _, session = struct.unpack_from("<BBIBQ", body)
    return body, kind, number, session


class Stream:
    """Record of all frames that arrive in one direction, which tells old frames from new ones.

    A frame is old if it arrived before, if it is not from the session opened last, or if a frame
    with a higher number has arrived.
    """

    def __init__(self):
        self.waiting, self.seen, self.sent, self.session, self.newest = b"", set(), [0], 0, 0

    def open(self, session):
        """Change to ``session`` if the true sender opened it after the current session."""
        if session in self.sent[self.sent.index(self.session) + 1 :]:
            self.session, self.newest = session, 0

    def knows(self, frame):
        """Return whether a frame has arrived before."""
        return cobs.decode(frame[:-1]) in self.seen

    def judge(self, piece):
        """Add bytes. If they complete a valid frame, return its kind and whether it is old."""
        if not piece.endswith(b"\0"):
            self.waiting += piece
            return None
        whole, self.waiting = self.waiting + piece[:-1], b""
        parsed = parse(whole)
        if parsed is None:
            return None
        body, kind, number, session = parsed
        again = body in self.seen
        self.seen.add(body)
        if kind == BEGIN:
            self.open(session)
        if kind in (HELLO, CAPABILITIES):
            return kind, again
        old = again or session != self.session or number < self.newest
        if session == self.session:
            self.newest = max(self.newest, number)
        return kind, old


class Middle:
    """Attacker on one direction of a line: drops, repeats, delays, mixes and breaks frames."""

    def __init__(self, chance):
        self.random, self.share = chance, 0.0
        self.record, self.foreign, self.due, self.counts = [], [], [], Counter()
        self.withheld, self._held = None, b""

    def pass_on(self, frame, now_ns):
        """Take a frame, perhaps attack it, and set the time at which it arrives."""
        self.record.append(frame)
        if self.withheld is not None:
            self.withheld.append(frame)
            return
        held, self._held = self._held, b""
        out = [(now_ns, frame)]
        if self.random.random() < self.share:
            fault = self.random.choice(FAULTS)
            self.counts[fault] += 1
            at = self.random.randrange(len(frame))
            flipped = frame[:at] + bytes([frame[at] ^ 1 << self.random.randrange(8)])
            out = {
                "drop": [],
                "twice": out * 2,
                "later": [(now_ns + self.random.randrange(400) * MS, frame)],
                "behind": [],
                "again": [*out, (now_ns, self.old(self.record))],
                "foreign": [(now_ns, self.old(self.foreign)), *out],
                "flip": [(now_ns, flipped + frame[at + 1 :])],
                "cut": [(now_ns, frame[:at])],
            }[fault]
            self._held = frame if fault == "behind" else b""
        self.due += [*out, (now_ns, held)]

    def old(self, frames):
        """Return a zero byte, which ends an incomplete frame, and then one of ``frames``."""
        return b"\0" + self.random.choice(frames) if frames else b""

    def arrived(self, now_ns):
        """Return the bytes that are due, cut after each frame; the last piece can be incomplete."""
        if not self.due:
            return []
        data = b"".join(piece for due_ns, piece in self.due if due_ns <= now_ns)
        self.due = [each for each in self.due if each[0] > now_ns]
        *whole, rest = data.split(b"\0")
        return [piece + b"\0" for piece in whole] + [rest] * bool(rest)


class World:
    """One emulated board, its successive hosts, and an attacker on each direction of the line."""

    def __init__(self, seed):
        self.random = random.Random(seed)
        self.books = KeptBooks(4)
        self.books.kept = []
        session = BoardSession(self.draw)
        self.firmware = LinkFirmware("weighted", self.books, session=session, ramp_ms=0)
        self.to_board, self.to_host = Middle(self.random), Middle(self.random)
        self.heard, self.said = Stream(), Stream()
        self.now_ns, self.host, self.written, self.half = 0, None, b"", 0
        self.replayed, self.given_up = Counter(), 0
        self.opens_ns = None

    def draw(self):
        return self.random.randrange(1, 2**32)

    def make_board(self):
        """Return the `Board` of a new host, on the line of the emulated board."""
        output = Output(kind="weighted")
        driver = LinkDriver("the middle", LIMITS, output)
        # A session without a thread: `step` does its periodic work.
        driver._session = SteppedSession(self, driver)
        clock = SimpleNamespace(now_ns=lambda: self.now_ns)
        return Board(
            driver, LIMITS, output, clock=clock, on_a_finger=False, claimed_time=True,
            simulated_time=True,
        )  # fmt: skip

    def wait(self, time_ms):
        for _ in range(time_ms):
            self.step()

    # -- port of the host -----------------------------------------------------

    def write(self, data):
        *whole, self.written = (self.written + data).split(b"\0")
        for frame in filter(None, whole):
            _, kind, _, session = parse(frame)
            self.half = session if kind == HELLO else self.half
            if kind == BEGIN and session not in self.heard.sent:
                self.heard.sent.append(session)
            self.to_board.pass_on(frame + b"\0", self.now_ns)

    def close(self):
        if self.random.random() < 0.5:
            self.firmware.hang_up(self.now_ns)

    # -- simulated time and line ----------------------------------------------

    def step(self):
        self.now_ns += MS
        if self.opens_ns is not None and self.now_ns >= self.opens_ns:
            self.firmware.switch_open = True
        if self.host is not None:
            self.host.idle()
        self.answer(self.firmware.advance(self.now_ns))
        for piece in self.to_board.arrived(self.now_ns):
            self.reach_board(piece)
        for piece in self.to_host.arrived(self.now_ns):
            if self.host is not None:
                self.reach_host(piece)

    def answer(self, data):
        for frame in filter(None, data.split(b"\0")):
            *_, session = parse(frame)
            if session & HALF == self.half and session not in self.said.sent:
                self.said.sent.append(session)
            self.to_host.pass_on(frame + b"\0", self.now_ns)

    def refused(self):
        return self.books.old_packets + self.books.foreign_packets

    def reach_board(self, piece):
        before = self.refused()
        self.answer(self.firmware.feed(piece, self.now_ns))
        judged = self.heard.judge(piece)
        if judged is not None and judged[1]:
            self.replayed["board"] += 1
            # While the emergency switch is open, each BEGIN is answered, but changes nothing.
            kept_shut = judged[0] == BEGIN and self.firmware.switch_open
            if judged[0] != HELLO and not kept_shut:
                assert self.refused() == before + 1, "the board did not count an old frame"

    def reach_host(self, piece):
        before, listening = self.host.refused, self.host.number > HALF
        self.host.take(piece)
        if self.host.number > HALF:
            assert self.host.number in self.said.sent
            self.said.open(self.host.number)
        judged = self.said.judge(piece)
        if judged is not None and judged[1] and listening:
            self.replayed["host"] += 1
            assert self.host.refused == before + 1, "the host did not count an old frame"


class SteppedSession(LinkSession):
    """Session of the host without a thread: while it waits, it advances simulated time."""

    def __init__(self, world, driver):
        super().__init__(driver._receive, world.draw)
        self._world, self._driver = world, driver

    def _listen(self):
        self._world.host, self._world.said.waiting = self, b""

    def idle(self):
        if not self.line.is_stopped:
            # Suppress the error here: the next call on the board raises it.
            with contextlib.suppress(BoardError):
                self._driver.idle()

    def now_s(self):
        return self._world.now_ns / 1e9

    def wait(self, condition, timeout_s):
        end_ns = self._world.now_ns + timeout_s * 1e9
        while not condition():
            if self._world.now_ns >= end_ns:
                return False
            self._world.step()
        return True


def write(board, sequence, times=1):
    """Let a driver write a sequence that no gate has proved and no ramp has limited."""
    now_ns, number = board.clock.now_ns(), board.driver._number + 1
    board.driver.write(
        unproved(sequence, times, number, now_ns, now_ns + LATE_NS, board._gate.session)
    )


@pytest.fixture
def make_world(monkeypatch):
    """Return a function that makes a `World`; the driver opens the `World` made last."""

    def make(seed):
        world = World(seed)
        monkeypatch.setattr("smarttouch.boards.driver.open_port", lambda *_: world)
        monkeypatch.setattr("smarttouch.boards.driver.reopen_port", lambda *_: world)
        return world

    return make
