"""Every pattern is scanned, as often as it should be, and the host knows how often.

``SMARTTOUCH_PATTERNS=2000 pytest tests/boards/test_in_step.py`` for the long run, and figures.
"""

import os
import random

import numpy as np
import pytest
from tests.boards.told import MS, ToldKit

from smarttouch.boards.probe import one_each
from smarttouch.scan.safety import SafetyLimits

PATTERNS = int(os.environ.get("SMARTTOUCH_PATTERNS", "300"))
LIMITS = SafetyLimits(8, 3.0, 200, 0.5, 200, 0.6, 0.5, 2.4)
PERIOD_US = 20_000


def patterns(count, seed=1, period_us=PERIOD_US):
    """Return sequences, each another set of electrodes or another height than that before."""
    rng = random.Random(seed)
    found = []
    for step in range(count):
        sites = sorted(rng.sample(range(8), rng.randint(1, 4)))
        found.append(
            one_each(
                LIMITS, 500 + 10 * (step % 150), 100, 0.5, step * 10**9, cathodic=False,
                sites=sites, discharge_us=50, period_us=period_us,
            )
        )  # fmt: skip
    return found


def wanted(sequence):
    own = np.abs(sequence.current_ua[np.arange(sequence.slots), sequence.site].astype(int))
    counts = np.rint(own / 9.99).astype(int)
    counts -= np.where((counts & 0xFF) >= 0xF4, (counts & 0xFF) - 0xF3, 0)
    return frozenset(zip(sequence.site.tolist(), counts.tolist(), strict=True))


@pytest.mark.parametrize("firmware", ["936c6c0", "71adee2", "newest"])
@pytest.mark.parametrize("phase_us", [0, 4_900, 11_300, 19_500])
@pytest.mark.parametrize("drift", [-100e-6, 0.0, 100e-6])
def test_every_pattern_is_scanned_once(monkeypatch, firmware, phase_us, drift):
    kit = ToldKit(monkeypatch, LIMITS, firmware, phase_ns=1000 * phase_us, drift=drift)
    sequences = patterns(PATTERNS)
    start = kit.clock.time_ns
    report = kit.run([(start + 20 * MS * i, each, 1) for i, each in enumerate(sequences)])
    assert kit.scans() == [wanted(each) for each in sequences]
    assert (report.slots, report.pulses) == (kit.books.slots, kit.books.pulses)
    assert report.most_pulses == report.pulses
    assert (kit.driver.acknowledged, kit.driver.refused, kit.driver.replaced) == (PATTERNS, 0, 0)
    assert kit.books.unsafe == 0
    took = (kit.clock.time_ns - start) / (20 * MS * PATTERNS)
    print(f"{firmware} {phase_us} {drift}: {took:.3f} periods a pattern")
    assert took < 1.05
