"""A link board on a clock of the test's own, and the host whose session it has begun."""

import numpy as np

from smarttouch.base.wire.framing import Deframer
from smarttouch.boards.link.protocol import HostSession, MessageKind, decode
from smarttouch.emulator.firmware import DeliveryLog
from smarttouch.emulator.link_firmware import LinkFirmware
from tests.boards.payloads import limits_payload, sequence_payload

MS = 1_000_000


class LinkRig:
    """A board, and a session begun at time zero, under limits, where they are not None.

    What it said unasked is in ``alive``.
    """

    def __init__(
        self, electrodes=4, output="weighted", *, folder=None, books=DeliveryLog, begun=True,
        limits=b"", finger=None, ramp_ms=0, **given,
    ):  # fmt: skip
        self.output, self.alive = output, []
        self.limits = limits_payload(electrodes) if limits == b"" else limits
        self.books = books(electrodes, folder)
        if ramp_ms is not None:
            given["ramp_ms"] = ramp_ms
        self.board = LinkFirmware(output, self.books, finger, **given)
        self.host = HostSession()
        if begun:
            self.begin(0)

    def begin(self, now_ms):
        self.host = HostSession()
        (self.can,) = self.say(now_ms, MessageKind.HELLO)
        (begun,) = self.say(now_ms, MessageKind.BEGIN)
        assert (self.can.kind, begun.kind) == (MessageKind.CAPABILITIES, MessageKind.BEGUN)
        if self.limits is not None:
            (answer,) = self.say(now_ms, MessageKind.LIMITS, payload=self.limits)
            assert (answer.kind, answer.payload) == (MessageKind.LIMITED, b"\1")

    def say(self, now_ms, kind, about=0, payload=b""):
        return self.feed(now_ms, self.host.encode(kind, about, payload))

    def feed(self, now_ms, data):
        return self.taken(self.board.feed(data, round(now_ms * MS)))

    def advance(self, now_ms):
        return self.taken(self.board.advance(round(now_ms * MS)))

    def taken(self, data):
        """Return the packets in what a board says; those that no session takes are read, too."""
        packets = [self.host.take(packet) or decode(packet) for packet in Deframer().feed(data)]
        self.alive += [packet for packet in packets if packet.kind == MessageKind.ALIVE]
        return [packet for packet in packets if packet.kind != MessageKind.ALIVE]

    def send(
        self, now_ms, current, *, number=1, width=100, discharge=50, period=10_000, output="",
        times=1, measure=False, recharge=None, recharge_us=0,
    ):  # fmt: skip
        current = np.asarray(current, np.int16)
        column = np.ones(len(current), np.uint16)
        payload = sequence_payload(
            output or self.output, period, column * width, column * discharge, column, current,
            times, measure, recharge, recharge_us,
        )  # fmt: skip
        return self.say(now_ms, MessageKind.SEQUENCE, number, payload)
