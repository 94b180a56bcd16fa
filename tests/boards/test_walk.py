"""A walk through the electrodes, one after the other."""

from collections import Counter

from smarttouch.boards import walk as module
from smarttouch.boards.memory import MemoryBoard
from smarttouch.boards.walk import walk
from smarttouch.profile import load_profile
from smarttouch.stimulation.safety import SafetyLimits


class TwitchingClock:
    """A computer that stands still: after some steps for a second, after others for a little."""

    def __init__(self, pauses_ns):
        self.time_ns, self.pauses_ns = 10**12, pauses_ns

    def now_ns(self):
        self.time_ns += 1000
        return self.time_ns

    def sleep(self, _seconds):
        self.time_ns += self.pauses_ns.pop(0) if self.pauses_ns else 90_000_000


def walked(monkeypatch, board, profile, clock, seconds):
    monkeypatch.setattr(module.time, "sleep", clock.sleep)
    board._clock = clock
    return walk(board, profile, 0.3, seconds, lambda: "", lambda _line: None)


def test_a_computer_that_is_slow_skips_no_electrode(monkeypatch):
    """Every step takes more than twice its time: an electrode's would be over before it pulsed."""
    profile = load_profile("etactilekit-32")
    with MemoryBoard("", SafetyLimits.of(profile), profile.output) as board:
        assert walked(monkeypatch, board, profile, TwitchingClock([]), 0.15) == 32
        pulses = Counter(
            int(site) for each in board.sequences if each.current_ua.any() for site in each.site
        )
    assert set(pulses) == set(range(32))
    assert min(pulses.values()) >= 4


def test_after_a_pause_the_current_rises_from_zero_again(monkeypatch):
    profile = load_profile("etactilekit-32")
    clock = TwitchingClock([40_000_000] * 10 + [10**9] + [40_000_000] * 10**4)
    with MemoryBoard("", SafetyLimits.of(profile), profile.output) as board:
        walked(monkeypatch, board, profile, clock, 0.8)
        first = [sequence for sequence in board.sequences if 0 in sequence.site][:20]
        assert board.dropped_late == 1
    peaks = [int(abs(sequence.current_ua).max(initial=0)) for sequence in first]
    # Silent ones are not among these, nor is the late one.
    assert peaks[:3] == [192, 300, 300]
    assert peaks[8:13] == [300, 300, 192, 300, 300]
