"""To the byte: what an eTactileKit receives, and that no change is trusted without its echo."""

from dataclasses import replace

import pytest

from smarttouch.base.errors import BoardError, LineLostError
from smarttouch.boards.board import Board
from smarttouch.boards.kits import etactilekit
from smarttouch.boards.kits.etactilekit import ETactileKitDriver
from smarttouch.boards.probe_scans import one_each
from smarttouch.emulator.skin import EmulatedFinger
from smarttouch.profile.device import Output
from smarttouch.stimulation.safety_gate import SafetyLimits
from tests.boards.fresh import deliver
from tests.boards.manual_kit import MS, ManualClock, ManualKit, proved

from ..support.checks import raises

LIMITS = SafetyLimits(4, 5.0, 200, 0.5, 200, 0.8, 0.5, 4.0)
PING, END, LOAD = b"\xf4", bytes(3), b"\xfb\x02\xfe"
NOTHING = bytes(8)
AT_REST = (
    b"\xfc\0" + END + b"\xf9\0\0\xf8\0\0" + b"\xfb\0\0" + END + b"\xfa\x01\0" + END
    + b"\xf7\0" + END + b"\xf6\x0a\0" + END
)  # fmt: skip
ZEROS = (bytes(514), b"")
WAKE = [ZEROS, (AT_REST, b""), (b"\xf5", b"\x01")]
QUIET = b"\xfb\x02\xfb\x02"
HELLO = [
    *WAKE, (PING + b"\xf5", b"\0\x01"), (QUIET + b"\xf9\0\0\xf8\0\0\xfc\x04" + PING, b"\x04"),
]  # fmt: skip


def readings(*counts):
    return b"".join(count.to_bytes(2, "little") for count in counts)


heights = readings


def load(payload):
    return (b"\xfb\x02\xfe" + payload + PING, b"\x04")


def go(before=NOTHING):
    return (b"\xff\xfb\0" + PING, before + b"\x04")


def ask(now):
    return (b"\xff" + PING, now + b"\x04")


def stop(now=NOTHING):
    return (b"\xff" + QUIET + PING, now + b"\x04")


ZERO = [stop(), load(NOTHING)]
OPEN = [*HELLO, *ZERO]


ONCE = (
    QUIET + END + b"\xf9\0" + END + b"\xf8\0" + END + b"\xf6\x0a\0" + END + b"\xfd\x01" + END
    + b"\xfa\x64\0" + END + b"\xf7\x32" + END
)  # fmt: skip
SETTINGS = [load(NOTHING), (ONCE * 2 + (b"\xf6\x32\0" + END) * 2 + PING, b"\x04")]


def anodic(level_ua, step=1, sites=(1,), cathodic=False, width=100, period_us=20_000):
    return one_each(
        LIMITS, level_ua, width, float(level_ua > 0), step * 10**9, cathodic=cathodic,
        sites=list(sites), discharge_us=50, period_us=period_us,
    )  # fmt: skip


@pytest.fixture
def make(monkeypatch):
    """Return a maker of boards on a clock that the test sets, and that are never idle."""
    monkeypatch.setattr(ETactileKitDriver, "idle_s", 600.0)
    # One look at the readings is good enough to know when the board scans.
    monkeypatch.setattr(etactilekit, "WIDE_NS", 10 * MS)

    def make(output=None, limits=LIMITS):
        driver = ETactileKitDriver("x", limits, output, firmware="71adee2")
        clock = ManualClock(late_us=0)
        board = Board(driver, limits, output, clock=clock, claimed_time=True)
        board._line.pause = lambda _: None
        return board

    return make


def test_a_run_to_the_byte(script, make):
    # 220 counts at 9.99 µA, as in the board's own example. The second look at the readings
    # tells of its pulse.
    seen = readings(0, 2000, 0, 0)
    script(
        *OPEN, *SETTINGS, load(heights(0, 220, 0, 0)), go(), ask(NOTHING), ask(seen), stop(seen),
        load(heights(0, 110, 110, 0)), go(seen), stop(readings(0, 1000, 1000, 0)), *ZERO,
    )  # fmt: skip
    with make() as board:
        deliver(board, anodic(0, 0), anodic(2200), anodic(1100, 2, (1, 2)))
        (sequence, volts), (_, more) = board.take_volts()
        assert sequence.site.tolist() == [1]
        assert volts == pytest.approx([2000 * 0.0893])
        assert more == pytest.approx([1000 * 0.0893] * 2)
        assert (board.acknowledged, board.refused, board.replaced) == (3, 0, 0)
        report = board.report()
    assert (report.sequences, report.slots, report.pulses, report.most_pulses) == (3, 3, 12, 12)


@pytest.mark.parametrize(("event", "lifted"), [("0 lift", True), ("0 touch", False)])
def test_a_finger_that_is_gone_is_known_by_the_load_beside_it(monkeypatch, event, lifted):
    limits = SafetyLimits(8, 3.0, 200, 0.5, 200, 0.6, 0.5, 2.4)
    kit = ManualKit(monkeypatch, limits, finger=EmulatedFinger(8, [event]), dummy_ohm=66e3)
    sequence = one_each(
        limits, 2000, 100, 1.0, 0, cathodic=False, sites=[1], discharge_us=50, period_us=20_000
    )
    kit.run([(kit.clock.time_ns + i * 20 * MS, sequence, 1) for i in range(5)])
    assert kit.host.lifted == lifted


def test_a_board_that_never_echoes_again_is_reported(script, make):
    ping = (QUIET + bytes(4) + PING, b"")
    silent = [ZEROS, ping, ping]
    script(
        *OPEN, *SETTINGS, (load(heights(0, 100, 0, 0))[0], b""), *silent, (stop()[0], b""),
        *silent,
    )  # fmt: skip
    board = make()
    board.open()
    deliver(board, anodic(0, 0), anodic(1000))
    # Even if nothing is sent any more: its last pattern may still be running.
    with raises(LineLostError, names="board"):
        board.close()


def test_a_scan_that_is_too_long_for_its_period_never_leaves():
    """4 outputs of 260 µs are more than 1 ms; their parser would stand still for ever."""
    driver = ETactileKitDriver("x", LIMITS)
    with raises(BoardError, value=1000, allowed=1040):
        driver.check(proved(replace(anodic(1000, width=200), period_us=1000)))


def test_wiring_decides_how_many_outputs_there_are(script, make):
    output = Output(kind="one-against-all", wiring=(5, 3, 0, 1))
    hello = [*HELLO[:-1], (HELLO[-1][0].replace(b"\xfc\x04", b"\xfc\x06"), b"\x06")]
    zero = [(stop()[0], bytes(12) + b"\x06"), (load(bytes(12))[0], b"\x06")]
    script(*hello, *zero, *zero)
    with make(output):
        pass


def test_a_line_that_loses_one_command_after_another_is_not_driven(monkeypatch):
    """What is lost in pieces could be completed by foreign bytes."""
    kit = ManualKit(monkeypatch, LIMITS)
    write = kit.port.write
    # The query behind a pattern is lost, and never one that asks whether the board is there.
    kit.port.write = lambda data: write(data[:-1] if data[:3] == LOAD else data)
    with raises(BoardError, names="safely"):
        kit.run([(step * 10**9, anodic(1000 + 10 * step), 1) for step in range(1, 9)])
    assert kit.scans() == []
