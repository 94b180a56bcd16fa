"""A walk through the electrodes, one after the other."""

import itertools
from collections import Counter

from smarttouch.boards.memory import MemoryBoard
from smarttouch.cli import walk as module
from smarttouch.cli.walk import walk
from smarttouch.profile import load_profile
from smarttouch.scan.safety import SafetyLimits


def test_a_computer_that_stands_still_skips_no_electrode(monkeypatch):
    """Every look at the clock is a second later: an electrode's time is over before it pulsed."""
    profile = load_profile("etactilekit-32")
    seconds = itertools.count(1)
    monkeypatch.setattr(module.time, "monotonic", lambda: float(next(seconds)))
    monkeypatch.setattr(module.time, "monotonic_ns", lambda: next(seconds) * 10**9)
    monkeypatch.setattr(module.time, "sleep", lambda _: None)
    monkeypatch.setattr(module, "read_key", lambda: "")
    with MemoryBoard("", SafetyLimits.of(profile), profile.output) as board:
        assert walk(board, profile, 0.3, 0.15) == 32
        pulses = Counter(
            int(site) for each in board.sequences if each.current_ua.any() for site in each.site
        )
    assert set(pulses) == set(range(32))
    assert min(pulses.values()) >= 4
