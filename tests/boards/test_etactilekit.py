"""To the byte: what an eTactileKit receives, and that no change is trusted without its echo; how
often it scans each pattern.

``pytest tests/boards/test_etactilekit.py --runs 2000 -s`` for the long run, and figures.
"""

import random
from dataclasses import replace

import numpy as np
import pytest

from smarttouch.base.errors import BoardError, LineLostError
from smarttouch.boards.board import Board
from smarttouch.boards.kits.etactilekit import ETactileKitDriver
from smarttouch.boards.probe_scans import one_each
from smarttouch.emulator.skin import EmulatedFinger
from smarttouch.profile.device import Output
from smarttouch.stimulation.safety_gate import SafetyLimits
from tests.boards.fresh import deliver
from tests.boards.manual_kit import MS, ManualClock, ManualKit, proved

from ..support.checks import raises
from ..support.full import WHOLE

LIMITS = SafetyLimits(4, 5.0, 200, 0.5, 200, 0.8, 0.5, 4.0)
PATTERNS = 150 if WHOLE else 40
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


ZERO = [(QUIET + PING, b"\x04"), load(NOTHING)]
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

    def make(output=None, limits=LIMITS):
        driver = ETactileKitDriver("x", limits, output)
        clock = ManualClock(late_us=0)
        board = Board(driver, limits, output, clock=clock, claimed_time=True)
        board._line.pause = lambda _: None
        return board

    return make


def test_a_run_to_the_byte(script, make):
    # 220 counts at 9.99 µA, as in the board's own example. A scan may be under way when the pulses
    # are stopped: readings before its end and after it.
    seen, half, both = readings(0, 2000, 0, 0), readings(0, 1000, 0, 0), readings(0, 900, 1000, 0)
    script(
        *OPEN, *SETTINGS, load(heights(0, 220, 0, 0)), go(), stop(seen), ask(NOTHING),
        load(heights(0, 110, 110, 0)), go(seen), stop(half), ask(both), *ZERO,
    )  # fmt: skip
    with make() as board:
        deliver(board, anodic(0, 0), anodic(2200), anodic(1100, 2, (1, 2)))
        (sequence, volts), (_, more) = board.take_volts()
        assert sequence.site.tolist() == [1]
        assert volts == pytest.approx([2000 * 0.0893])
        assert more == pytest.approx([1000 * 0.0893] * 2)
        assert (board.acknowledged, board.refused, board.replaced) == (3, 0, 0)
        report = board.report()
    assert (report.sequences, report.slots, report.pulses, report.most_pulses) == (3, 3, 12, 24)


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
        *OPEN, *SETTINGS, (load(heights(0, 100, 0, 0))[0], b""), *silent, (QUIET + PING, b""),
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
    zero = [(QUIET + PING, b"\x06"), (load(bytes(12))[0], b"\x06")]
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


EIGHT = SafetyLimits(8, 3.0, 200, 0.5, 200, 0.6, 0.5, 2.4)
FIRMWARES = pytest.mark.parametrize("firmware", ["71adee2", "newest"])


def pulses(step, level_ua, sites, limits=EIGHT, **more):
    given = {"cathodic": False, "discharge_us": 50, "period_us": 20_000} | more
    return one_each(limits, level_ua, 100, 0.5, step * 10**9, sites=sites, **given)


def patterns(count, seed=1, limits=EIGHT):
    """Return sequences, each another set of electrodes or another height than that before."""
    rng = random.Random(seed)
    return [
        pulses(step, 500 + 10 * (step % 150), sorted(rng.sample(range(8), 1 + step % 4)), limits)
        for step in range(count)
    ]


def wanted(*sequences):
    """Return the heights in counts of the electrodes that each sequence pulses."""
    found = []
    for each in sequences:
        own = np.abs(each.current_ua[np.arange(each.slots), each.site].astype(int))
        counts = np.rint(own / 9.99).astype(int)
        counts -= np.where((counts & 0xFF) >= 0xF4, (counts & 0xFF) - 0xF3, 0)
        found.append(frozenset(zip(each.site.tolist(), counts.tolist(), strict=True)))
    return found


def unlike(scans):
    """Return the scans that differ from the one before."""
    return [scan for i, scan in enumerate(scans) if not i or scan != scans[i - 1]]


@FIRMWARES
@pytest.mark.parametrize(("electrodes", "phase_us", "drift", "late_us", "wire_us", "periods"), [
    (8, 0, 100e-6, 200, 100, 1.15),
    (8, 19_500, -100e-6, 200, 100, 1.15),
    # Long scans, and a slow line.
    (32, 4_900, 0.0, 200, 100, 1.2),
    (48, 11_300, 70e-6, 200, 1000, 1.6),
    # A busy host, whose waits are too long by milliseconds.
    (8, 7_000, 0.0, 3000, 2000, 2.0),
])  # fmt: skip
def test_every_pattern_is_scanned_once_or_twice(
    monkeypatch, firmware, electrodes, phase_us, drift, late_us, wire_us, periods, runs
):
    count, limits = runs or PATTERNS, replace(EIGHT, electrodes=electrodes)
    kit = ManualKit(
        monkeypatch, limits, firmware, phase_ns=1000 * phase_us, drift=drift,
        late_us=late_us, wire_us=wire_us,
    )  # fmt: skip
    kit.line.has_newer = lambda: True
    sequences, start_ns = patterns(count, limits=limits), kit.clock.time_ns
    report = kit.run([(start_ns, each, 1) for each in sequences])
    scans, took = kit.scans(), (kit.clock.time_ns - start_ns) / (20 * MS)
    assert unlike(scans) == wanted(*sequences)
    assert report.pulses <= kit.books.pulses <= report.most_pulses
    assert report.most_pulses <= 2.1 * report.pulses
    assert (kit.host.acknowledged, kit.host.refused, kit.books.unsafe) == (count, 0, 0)
    print(f"{len(scans) / count:.3f} scans and {took / count:.3f} periods for each pattern")
    # Its settings take some periods.
    assert took < 7 + periods * count
    # Never faster than the period that was proved.
    assert len(scans) <= took
    assert not kit.board._stuck


@FIRMWARES
@pytest.mark.parametrize(("times", "level_ua"), [(1, 800), (7, 800), (30, 800), (3, 10)])
def test_what_repeats_is_scanned_once_more_at_most(monkeypatch, firmware, times, level_ua):
    """Also what is too weak to measure, and what lasts longer than a board waits for its host."""
    kit = ManualKit(monkeypatch, EIGHT, firmware, phase_ns=3 * MS, drift=60e-6)
    sequence, start_ns = pulses(0, level_ua, [1, 4]), kit.clock.time_ns
    report = kit.run([(start_ns + i * times * 20 * MS, sequence, times) for i in range(20)])
    assert set(kit.scans()) == set(wanted(sequence))
    assert 20 * times <= report.sequences * times <= len(kit.scans()) <= 20 * (times + 1)
    # Each pulse of a slot is one of each of its electrodes.
    assert report.pulses <= 8 * kit.books.slots <= report.most_pulses


@FIRMWARES
def test_another_polarity_and_rate_are_set_in_between(monkeypatch, firmware):
    kit = ManualKit(monkeypatch, EIGHT, firmware, phase_ns=5 * MS)
    sequences = [
        pulses(step, 800 + 20 * step, [step % 8], cathodic=step % 4 > 1, period_us=period_us)
        for step, period_us in enumerate(([20_000] * 8 + [10_000] * 8) * 2 + [20_000] * 8)
    ]
    report = kit.run([(kit.clock.time_ns, each, 1) for each in sequences])
    assert unlike(kit.scans()) == wanted(*sequences)
    assert report.pulses <= kit.books.pulses <= report.most_pulses
