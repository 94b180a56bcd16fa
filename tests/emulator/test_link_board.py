"""Tests of the emulated link board in simulated time: limits, sessions and kernels.

Tests in ``firmware/tests`` compare which packets the emulator, the C core and a reference refuse.
"""

import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from firmware.tests.core_and_emulator import Emulated, Talk
from firmware.tests.random_histories import sequence_of
from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import BoardFaultError
from smarttouch.base.wire.framing import Deframer, frame_packet
from smarttouch.boards import link as protocol
from smarttouch.boards.link import (
    ALIVE_MS,
    HALF,
    LATE_MS,
    LONGEST_PACKET_MS,
    Message,
    MessageKind,
    decode,
    digest_of,
    encode,
)
from smarttouch.boards.link.link_driver import LinkDriver
from smarttouch.boards.link.sequence_encoding import KernelImage
from smarttouch.emulator import link_board_limits
from smarttouch.emulator.firmware_base import RECHARGE, DeliveryLog
from smarttouch.emulator.link_board import LinkFirmware
from smarttouch.emulator.link_board_limits import Room
from smarttouch.emulator.link_packets import MOST_HOSTS, BoardSession
from smarttouch.emulator.skin import EmulatedFinger
from smarttouch.stimulation.safety_gate import SafetyLimits
from smarttouch.stimulation.scan_sequence import KernelLists, KernelTable, ScanSequence

from ..support.checks import raises

MS = 1_000_000
E = 6


class Rig(Talk):
    """Emulated board, and a host that has begun a session and sent limits."""

    def __init__(self, electrodes=4, output="weighted", **given):
        super().__init__(Emulated(electrodes, output, 0, **given))
        self.books, self.switched = self.board.log, output != "weighted"
        self.begin(SafetyLimits(electrodes, 5.0, 200, 0.5, 200, 0.8, 0.5, 5.0))

    def drive(self, recharge_ua=None, recharge_us=0, **more):
        """Send two pulses of 100 µs, 50 µs apart, and a recharge phase if ``recharge_us`` > 0."""
        current = np.array([[300, -100, -100, -100], [-100, 300, -100, -100]], np.int16)
        column = np.ones(2, np.uint16)
        scan = ScanSequence(current, 100 * column, 50 * column, column, 10_000, 1.0, 0)
        scan = replace(scan, recharge_ua=recharge_ua, recharge_us=recharge_us)
        self.send(scan, 1, switched=self.switched, **more)

    def live(self, time_ms):
        """Advance the time, with heartbeats that confirm the last ALIVE packet."""
        for _ in range(time_ms // 10):
            self.wait(10_000)
            self.say(MessageKind.HEARTBEAT)

    @property
    def ended(self):
        return self.books.state, self.books.reason


@pytest.fixture
def rig():
    return Rig()


def test_its_limits_are_those_of_the_firmware():
    header = Path(__file__).parents[2] / "firmware" / "src" / "st_inside.h"
    named = re.findall(r"#define ST_(M(?:AX|IN)_\w+|STRENGTH|\w+_US) (\d+)", header.read_text())
    others = {
        name for name, value in named if getattr(link_board_limits, name, int(value)) != int(value)
    }
    # Only the largest number of slots differs: the C core accepts more slots than the emulator.
    assert others == {"MAX_SLOTS"}


def test_hello_of_any_version_is_answered_and_nothing_else():
    board = LinkFirmware("weighted", DeliveryLog(4))
    (answer,) = Deframer().feed(board.feed(frame_packet(9, MessageKind.HELLO, 0, b""), 0))
    assert (answer.kind, answer.version) == (MessageKind.CAPABILITIES, protocol.VERSION)
    assert board.feed(frame_packet(9, MessageKind.STATUS, 1, bytes(16)), MS) == b""
    assert board.books.foreign_packets == 1


def test_an_open_electrode_needs_all_the_voltage_there_is():
    rig = Rig(output="one-against-all", finger=EmulatedFinger(4, ["0 open 1"]))
    rig.drive(measure=True)
    (told,) = (each for each in rig.wait(11_000) if each.kind == MessageKind.VOLTAGES)
    volts = np.frombuffer(told.payload, "<u2") / 100  # the unit in the payload is 10 mV
    assert volts[1] == pytest.approx(300, abs=0.02)
    assert volts[0] < 60


@pytest.mark.parametrize(("open_us", "flowed"), [(299, []), (300, [400]), (700, [800])])
def test_what_flowed_of_a_recharge_phase_is_counted(rig, open_us, flowed):
    """The recharge phase begins at 300 µs. The board reads the switch 400 µs after ``open_us``."""
    back = np.array([-10, -10, 10, 10], np.int16)
    rig.drive(recharge_ua=back, recharge_us=1000)
    rig.wait(open_us)
    rig.board.switch(True)
    rig.wait(400)
    assert [each[3] for each in rig.pulses if each[1] == RECHARGE] == flowed


# -- sessions ----------------------------------------------------------------


def test_hellos_that_lead_to_nothing_are_counted():
    session = BoardSession()

    def hello(half, number):
        return session.answer_hello(Message(MessageKind.HELLO, number, half), b"")

    for half in range(1, MOST_HOSTS + 1):
        assert hello(half, 1) is not None
        assert hello(half, 2) is not None
        assert hello(half, 2) is None
    assert (session.old, session.foreign) == (MOST_HOSTS, 0)
    assert hello(99, 1) is not None
    assert session.foreign == 2 * MOST_HOSTS
    (offer,) = Deframer().feed(hello(99, 2))
    begin = Message(MessageKind.BEGIN, 3, decode(offer).session)
    assert session.would_begin(begin)
    session.begin(begin)
    session.live = False
    assert hello(99, 2) is None
    assert (session.old, session.foreign) == (MOST_HOSTS + 1, 2 * MOST_HOSTS)


@pytest.mark.parametrize("noise", ["heartbeat", "hello", "garbage", "half a stop", "half anew"])
def test_what_is_no_sign_of_life(rig, noise):
    """The board times out after the host has ended, even if other bytes still arrive."""
    rig.drive(times=10_000)
    beat = rig.host.encode(MessageKind.HEARTBEAT)
    rig.say(None, data=beat)
    rig.live(50)
    played = {
        "heartbeat": beat,
        "hello": encode(Message(MessageKind.HELLO, 1, rig.host.number & HALF)),
        "garbage": b"\x07garbage",
        "half a stop": b"\0" + rig.host.encode(MessageKind.STOP)[:-2],
        "half anew": b"\0" + rig.host.encode(MessageKind.SEQUENCE, 2, bytes(range(1, 60)))[:-2],
    }[noise]
    for _ in range(100):
        rig.wait(5000)
        rig.say(None, data=played)
    assert rig.ended == ("shorted", "silence")
    assert rig.books.zero_after_ms == pytest.approx(protocol.SILENCE_MS, abs=5)
    # The head of an incomplete sequence counts as a sign of life until the sequence is late.
    fresh_ms = LATE_MS + ALIVE_MS if noise == "half anew" else 0
    assert rig.books.slots <= 2 * ((50 + fresh_ms + protocol.SILENCE_MS) / 10 + 1)


def test_a_long_packet_on_its_way_is_a_sign_of_life_for_a_while(rig):
    rig.drive(times=10_000)
    rig.live(30)
    packet = rig.host.encode(MessageKind.SEQUENCE, 2, bytes(range(1, 251)) * 12)
    for at in range(0, LONGEST_PACKET_MS + 300, 50):
        # The packet never ends: after `LONGEST_PACKET_MS` the board must go to zero.
        assert rig.books.state == "driving" or at >= LONGEST_PACKET_MS
        rig.say(None, data=packet[at : at + 50])
        rig.wait(50_000)
    assert rig.ended == ("shorted", "silence")


def test_a_stop_is_never_too_late(rig, monkeypatch):
    rig.drive(times=10_000)
    # From now on the host ignores all packets of the board.
    monkeypatch.setattr(rig.host, "take", lambda packet: [])
    rig.live(310)
    assert rig.books.state == "driving"
    answer, _ = rig.board.feed(rig.host.encode(MessageKind.STOP), rig.now_us)
    assert [each.kind for each in Deframer().feed(answer)] == [MessageKind.STOPPED]
    assert rig.ended == ("shorted", "stop")


# -- kernels -----------------------------------------------------------------


def made_table(seed=0, kernels=5):
    weights = np.random.default_rng(seed).normal(size=(kernels, E))
    weights -= weights.mean(axis=1, keepdims=True)
    weights[1, 2:] = 0
    weights[1, :2] = 1, -1
    return KernelTable.of({Afferent.RA: weights}, {})


TABLE = made_table()
LIMITS = SafetyLimits(E, 5.0, 200, 0.5, 200, 0.8, 0.5, 5.0)


@pytest.mark.parametrize(("first", "kernel", "amplitude"), [
    ([0, 1], np.array([0], np.uint16), np.array([-4000])),
    ([0, 1], np.array([0], np.uint16), np.array([4000 + 65_536])),
    ([0, 1], np.array([-5]), np.array([4000], np.uint16)),
    ([0, 1], np.array([0, 0], np.uint16), np.array([3000, 1000], np.uint16)),
    ([1, 2], np.array([1, 0], np.uint16), np.array([9, 4000], np.uint16)),
    ([0, 1], np.array([0], np.uint16), np.array([3999], np.uint16)),
])  # fmt: skip
def test_lists_that_would_make_other_currents_go_as_currents(first, kernel, amplitude):
    rig, image = Rig(E, room=Room(kernel_bytes=10_000)), KernelImage.of(TABLE, 10_000, 100)
    rig.give(image)
    one, full = np.array([0], np.uint16), np.array([4000], np.uint16)
    usual = KernelLists(TABLE, np.array([0, 1]), one, full)
    sums = KernelLists(TABLE, np.array(first), kernel, amplitude)
    wanted = (sums if amplitude[0] < 0 else usual).current_ua
    sequence = sequence_of(usual, current_ua=wanted, sums=sums)
    rig.send(sequence, 1, image=image)
    pulses = rig.pulses
    rig.wait(9000)
    assert [each[-1] for each in (*pulses, *rig.pulses)] == wanted.tolist()


def test_a_host_takes_no_table_of_the_same_size_for_its_own():
    image, forged = (KernelImage.of(each, 10_000, 100) for each in (TABLE, made_table(seed=1)))
    for data, session in ((forged.data, 5), (image.data, 4)):
        proof = digest_of(data, session)
        kept = protocol.KEPT.pack(image.identity, len(image.data), 1, proof)
        driver = LinkDriver("x", LIMITS)
        driver.can = SimpleNamespace(kernel_bytes=10_000, most_kernels=100, packet_bytes=1000)
        driver._session = SimpleNamespace(
            number=5, ask=lambda *_, kept=kept: SimpleNamespace(payload=kept)
        )
        driver._line = SimpleNamespace(name="board", fault=BoardFaultError)
        with raises(BoardFaultError, names="kernels"):
            driver.store_kernels(TABLE)
