"""Tests of the electrode sweep."""

from collections import Counter

from smarttouch.profile import load_profile
from smarttouch.running.display import Display
from smarttouch.running.electrode_walk import ElectrodeReached, Walk, run_walk
from smarttouch.running.step_records import OnEvent

from ..support.scans import board_without_finger


class TwitchingClock:
    """Clock that is late after each wait: by the delays in a list, and then always by 90 ms."""

    def __init__(self, pauses_ns):
        self.time_ns, self.pauses_ns = 10**12, pauses_ns

    def now_ns(self):
        self.time_ns += 1000
        return self.time_ns

    def wait_until(self, deadline_ns, _stop):
        self.time_ns = max(self.time_ns, deadline_ns)
        self.time_ns += self.pauses_ns.pop(0) if self.pauses_ns else 90_000_000


def walked(clock, profile="etactilekit-32", **options):
    """Return the sequences of a sweep, and the texts of its ElectrodeReached events."""
    profile, events = load_profile(profile), []
    display = Display(board_without_finger(profile, clock=clock), profile)
    walk = Walk(display.profile, 0.3, **options)
    run_walk(walk, display, listeners=[OnEvent(events.append)])
    reached = [str(each) for each in events if isinstance(each, ElectrodeReached)]
    return display.board.driver.sequences, reached


def peaks_ua(sequences):
    return [int(abs(each.current_ua).max(initial=0)) for each in sequences]


def test_a_computer_that_is_slow_skips_no_electrode():
    """Each step is 90 ms late. In real time, an electrode's 0.15 s would end without a pulse."""
    sequences, reached = walked(TwitchingClock([]), seconds=0.15)
    assert len(reached) == 32
    pulses = Counter(int(site) for each in sequences if each.current_ua.any() for site in each.site)
    assert set(pulses) == set(range(32))
    assert min(pulses.values()) >= 4


def test_each_electrode_rises_from_zero_against_all_others():
    sequences, _ = walked(TwitchingClock([0] * 1000), seconds=0.2, sites=[3, 9])
    peaks = peaks_ua(sequences)
    each = [0, 96, 192, 288, *[300] * 6]
    assert peaks == each * 2
    for sequence in sequences:
        assert sequence.slots <= 1
        assert not sequence.current_ua.sum()
        if sequence.slots:
            others = sorted(abs(sequence.current_ua[0]))[:-1]
            assert others[-1] - others[0] <= 1


def test_after_a_pause_the_current_rises_from_zero_again():
    clock = TwitchingClock([0] * 9 + [10**9] + [0] * 10**4)
    sequences, _ = walked(clock, seconds=0.8, sites=[0])
    peaks = peaks_ua(sequences)
    assert peaks[:5] == [0, 96, 192, 288, 300]
    assert peaks[9:16] == [300, 0, 96, 192, 288, 300, 300]


def test_masked_electrodes_are_named_and_left_out(profile, changed):
    masked = changed(profile, {"output.masked": (0, 2)})
    sequences, reached = walked(TwitchingClock([0] * 10**4), masked, seconds=0.1)
    assert len({int(site) for each in sequences for site in each.site}) == 62
    assert [each.partition(":")[0] for each in reached[:3]] == [f"electrode {i}" for i in range(3)]
    assert not {0, 2} & {int(site) for each in sequences for site in each.site}
    assert not any(each.current_ua[:, [0, 2]].any() for each in sequences)


def test_each_electrode_until_it_is_left():
    profile, steps = load_profile("etactilekit-32"), []
    display = Display(board_without_finger(profile, clock=TwitchingClock([0] * 10**4)), profile)
    walk = Walk(display.profile, 0.3)

    def leave(result):
        steps.append(result)
        if len(steps) % 10 == 0:
            walk.go_on()

    run_walk(walk, display, listeners=[leave])
    assert [int(site) for each in steps[9::10] for site in each.sequence.site] == list(range(32))
    assert len(steps) == 32 * 10
