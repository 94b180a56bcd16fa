"""An eTactileKit scans each pattern as often as requested, and the host counts the scans.

``pytest tests/boards/test_etactilekit.py --runs 2000 -s`` runs longer and prints figures.
"""

import random
from dataclasses import replace

import numpy as np
import pytest

from smarttouch.base.errors import BoardError, LineLostError
from smarttouch.boards.kits.etactilekit_protocol import LOAD, PING, QUIET, READINGS
from smarttouch.emulator.skin import EmulatedFinger
from smarttouch.stimulation.safety_gate import SafetyLimits
from tests.boards.simulated_time_kit import MS, ManualKit, proved

from ..support.checks import raises
from ..support.full import WHOLE
from ..support.scans import one_each

PATTERNS = 150 if WHOLE else 50
LIMITS = SafetyLimits(8, 3.0, 200, 0.5, 200, 0.6, 0.5, 2.4)
PERIOD_US = 20_000
FIRMWARES = pytest.mark.parametrize("firmware", ["71adee2", "newest"])


def patterns(count, seed=1):
    """Return sequences that each differ from the one before in electrodes or current."""
    rng = random.Random(seed)
    found = []
    for step in range(count):
        sites = sorted(rng.sample(range(8), rng.randint(1, 4)))
        found.append(pulses(500 + 10 * (step % 150), sites, step))
    return found


def pulses(level_ua, sites, step=0, limits=LIMITS, width_us=100, intensity=0.5, **more):
    """Return a sequence of anodic pulses on some electrodes."""
    given = {"cathodic": False, "discharge_us": 50, "period_us": PERIOD_US} | more
    return one_each(limits, level_ua, width_us, intensity, step * 10**9, sites=sites, **given)


def unlike(scans):
    """Return the scans without consecutive duplicates."""
    return [scan for i, scan in enumerate(scans) if not i or scan != scans[i - 1]]


def wanted(sequence):
    own = np.abs(sequence.current_ua[np.arange(sequence.slots), sequence.site].astype(int))
    counts = np.rint(own / 9.99).astype(int)
    counts -= np.where((counts & 0xFF) >= 0xF4, (counts & 0xFF) - 0xF3, 0)
    return frozenset(zip(sequence.site.tolist(), counts.tolist(), strict=True))


@FIRMWARES
@pytest.mark.parametrize("named", [True, False])
@pytest.mark.parametrize(
    ("phase_us", "drift"), [(0, 100e-6), (4_900, -100e-6), (11_300, 0.0), (19_500, 100e-6)]
)
def test_every_pattern_is_scanned_once(monkeypatch, firmware, named, phase_us, drift, runs):
    runs = runs or PATTERNS
    kit = ManualKit(
        monkeypatch, LIMITS, firmware, phase_ns=1000 * phase_us, drift=drift, named=named
    )
    sequences = patterns(runs)
    start = kit.clock.time_ns
    report = kit.run([(start + 20 * MS * i, each, 1) for i, each in enumerate(sequences)])
    assert kit.scans() == [wanted(each) for each in sequences]
    assert (report.slots, report.pulses) == (kit.books.slots, kit.books.pulses)
    assert report.most_pulses == report.pulses
    assert (kit.host.acknowledged, kit.host.refused) == (runs, 0)
    assert kit.books.unsafe == 0
    took = (kit.clock.time_ns - start) / (20 * MS)
    print(f"{firmware}, {phase_us} µs, drift {drift}: {took:.1f} periods for {runs} patterns")
    # The driver needs a few more periods until it knows when the board scans.
    assert took < runs + 7
    kit.assert_located()


@FIRMWARES
@pytest.mark.parametrize("width_us", [100, 200])
def test_long_scans_leave_enough_time_between_them(monkeypatch, firmware, width_us):
    """A scan of 48 outputs takes 38 % of the period, or 62 % if ``width_us`` is 200."""
    limits = SafetyLimits(48, 3.0, 200, 0.5, 200, 0.6, 0.5, 2.4)
    kit = ManualKit(monkeypatch, limits, firmware, phase_ns=3 * MS, drift=70e-6)
    rng, start = random.Random(1), kit.clock.time_ns
    sequences = [
        pulses(900, rng.sample(range(48), 2), step, limits, width_us) for step in range(60)
    ]
    report = kit.run([(start + 20 * MS * i, each, 1) for i, each in enumerate(sequences)])
    assert kit.scans() == [wanted(each) for each in sequences]
    assert (report.pulses, report.most_pulses) == (48 * 120, 48 * 120)
    assert kit.clock.time_ns - start < 1.15 * 20 * MS * 60
    assert not kit.board._stuck
    kit.assert_located()


@FIRMWARES
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("named", [True, False])
def test_what_a_busy_host_cannot_determine_is_a_range(monkeypatch, firmware, seed, named, runs):
    """Waits end milliseconds late, and sequences come at random times; each pattern is scanned."""
    runs = runs or PATTERNS
    kit = ManualKit(
        monkeypatch, LIMITS, firmware, seed=seed, late_us=3000, phase_ns=7 * MS * seed,
        wire_us=2000, named=named,
    )  # fmt: skip
    sequences = patterns(runs // 3, seed)
    rng, time_ns, jobs = random.Random(seed), kit.clock.time_ns, []
    for each in sequences:
        jobs.append((time_ns, each, rng.choice([1, 1, 1, 5])))
        time_ns += int(rng.uniform(5, 45) * MS)
    report = kit.run(jobs)
    shown = unlike(kit.scans())
    assert shown == [wanted(each) for each in sequences]
    assert report.pulses <= kit.books.pulses <= report.most_pulses
    assert report.most_pulses <= 2 * report.pulses


@FIRMWARES
@pytest.mark.parametrize("times", [1, 7])
def test_the_same_pattern_again_is_scanned_again(monkeypatch, firmware, times):
    kit = ManualKit(monkeypatch, LIMITS, firmware, phase_ns=3 * MS, drift=60e-6)
    (sequence,) = patterns(1)
    start = kit.clock.time_ns
    report = kit.run([(start + i * times * 20 * MS, sequence, times) for i in range(60)])
    assert kit.scans() == [wanted(sequence)] * 60 * times
    assert (report.pulses, report.most_pulses) == (kit.books.pulses, kit.books.pulses)


def test_what_is_too_weak_to_measure_is_scanned_and_reported_as_a_range(monkeypatch):
    kit = ManualKit(monkeypatch, LIMITS, phase_ns=3 * MS)
    weak = [pulses(10, [step % 8], step, intensity=0.1) for step in range(60)]
    start = kit.clock.time_ns
    report = kit.run([(start + i * 20 * MS, each, 1) for i, each in enumerate(weak)])
    shown = unlike(kit.scans())
    assert shown == [wanted(each) for each in weak]
    assert report.pulses <= kit.books.slots * 8 <= report.most_pulses
    assert report.slots >= 60


@FIRMWARES
def test_another_polarity_and_rate_are_set_in_between(monkeypatch, firmware):
    kit = ManualKit(monkeypatch, LIMITS, firmware, phase_ns=5 * MS)
    sequences = [
        pulses(800 + 20 * step, [step % 8], step, cathodic=step % 4 > 1, period_us=period_us)
        for step, period_us in enumerate(([20_000] * 8 + [10_000] * 8) * 2 + [20_000] * 8)
    ]
    start = kit.clock.time_ns
    report = kit.run([(start, each, 1) for each in sequences])
    shown = unlike(kit.scans())
    assert shown == [wanted(each) for each in sequences]
    assert report.pulses <= kit.books.pulses <= report.most_pulses
    assert kit.books.sequences < 50


def test_voltages_are_those_of_each_scan(monkeypatch):
    kit = ManualKit(monkeypatch, LIMITS)
    kit.run([(20 * MS * i, pulses(2000 - 1000 * i, [1, 2][: 1 + i]), 1) for i in range(2)])
    (one, first_v), (two, second_v) = kit.host.take_volts()
    assert (one.site.tolist(), two.site.tolist()) == ([1], [1, 2])
    assert first_v == pytest.approx([kit.books.max_volts], abs=0.1)
    assert second_v == pytest.approx([first_v[0] / 2] * 2, rel=0.05)


@pytest.mark.parametrize(("event", "lifted"), [("0 lift", True), ("0 touch", False)])
def test_a_finger_that_is_gone_is_known_by_the_load_beside_it(monkeypatch, event, lifted):
    kit = ManualKit(monkeypatch, LIMITS, finger=EmulatedFinger(8, [event]), dummy_ohm=66e3)
    kit.run([(kit.clock.time_ns + i * 20 * MS, pulses(2000, [1]), 1) for i in range(5)])
    assert kit.host.lifted == lifted


def test_a_board_that_never_echoes_again_is_reported(monkeypatch):
    kit = ManualKit(monkeypatch, LIMITS)
    kit.run([(0, pulses(1000, [1]), 1)])
    kit.port.write = len
    # `zero` must raise an error as well, because the board may still repeat its last pattern.
    for act in (lambda: kit.driver.write(proved(pulses(1010, [1]))), kit.driver.zero):
        with raises(LineLostError, names="board") as lost:
            act()
        assert "lift the finger" in str(lost.value)
    # After the watchdog has set the board to zero, the finger is not in danger.
    kit.port.at_zero = True
    assert "finger" not in str(kit.line.lost("is silent"))


def test_a_line_that_loses_one_command_after_another_is_not_driven(monkeypatch):
    """Bytes of a later command could complete a command that has lost a byte."""
    kit = ManualKit(monkeypatch, LIMITS)
    write = kit.port.write
    # Only the query after each pattern is lost, not the queries that look for the board.
    kit.port.write = lambda data: write(data[:-1] if data[: len(LOAD)] == LOAD else data)
    with raises(BoardError, names="safely"):
        kit.run([(10**9 * step, pulses(1000 + 10 * step, [1]), 1) for step in range(1, 9)])
    assert kit.scans() == []


def test_a_stop_whose_answer_is_lost_leaves_a_range(monkeypatch):
    kit = ManualKit(monkeypatch, LIMITS)
    write, lost = kit.port.write, [READINGS + QUIET + PING]
    kit.port.write = lambda data: write(data[:-1] if data in lost and lost.pop() else data)
    start = kit.clock.time_ns
    report = kit.run([(start + 20 * MS * i, each, 1) for i, each in enumerate(patterns(20))])
    assert lost == []
    assert report.pulses <= kit.books.pulses <= report.most_pulses
    assert kit.host.acknowledged == 20


def test_a_scan_that_is_too_long_for_its_period_never_leaves(monkeypatch):
    """8 outputs of 160 µs take 1.28 ms, longer than the period: the parser would never run."""
    kit = ManualKit(monkeypatch, LIMITS)
    with raises(BoardError, value=1000, allowed=1280):
        kit.driver.write(proved(replace(pulses(1000, [1]), period_us=1000)))
