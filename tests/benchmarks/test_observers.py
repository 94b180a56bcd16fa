"""Frequency and thresholds that the spikes of many fingers give, in both anatomies.

Run with::

    pytest tests/benchmarks/test_observers.py --benchmark-only -n0

Of 20 fingers each, at the middle electrode, full pulses: PC spikes for RA spikes, each for its
density; the 75 % thresholds of frequency that follow; and the current at which the first afferent
fires.
"""

import numpy as np
import pytest

import smarttouch as st
from smarttouch.psychophysics.observers.interval import Interval
from smarttouch.psychophysics.observers.nerve import Nerve
from smarttouch.psychophysics.observers.observer import SimulatedObserver
from smarttouch.psychophysics.observers.percept import FrequencySense

from ..psychophysics.observers.weber import weber_fraction

RA, SAI, PC = st.Afferent
MIDDLE = 27
STANDARDS_HZ = (30, 45, 60, 75, 90, 100, 120)


@pytest.mark.timeout(0)
@pytest.mark.parametrize("anatomy", ["paper", "branched"])
def test_frequency(row, quick, profile, bank, anatomy):
    sense, limits = FrequencySense(), {}
    found = {RA: [], PC: []}
    for seed in range(1, 3 if quick else 21):
        observer = SimulatedObserver(st.Finger(profile, seed, anatomy), bank)
        for mode, ratios in found.items():
            ratios.append(observer.ratio(mode, MIDDLE))
    for mode, ratios in found.items():
        weber = {
            hz: float(np.median([weber_fraction(sense, hz, ratio) for ratio in ratios]))
            for hz in STANDARDS_HZ
        }
        limits[mode] = np.median([sense.believable_hz(ratio) for ratio in ratios])
        row(
            "75 % threshold of frequency, median of fingers",
            {
                "anatomy": anatomy,
                "mode": mode.name,
                "PC for RA, median (least to most)": (
                    f"{np.median(ratios):.2f} ({min(ratios):.2f} to {max(ratios):.2f})"
                ),
                "believed up to, Hz": f"{limits[mode]:.0f}",
            }
            | {f"{hz} Hz": f"{each:.2f}" for hz, each in weber.items()},
        )
    assert limits[RA] == pytest.approx(65)
    # With axons that branch too few PC fire among the many RA.
    assert (limits[PC] > limits[RA]) == (anatomy == "paper")


@pytest.mark.timeout(0)
@pytest.mark.parametrize("anatomy", ["paper", "branched"])
def test_detection(row, quick, profile, bank, anatomy):
    levels = np.arange(0.2, 1.005, 0.02)
    for mode in (RA, SAI, PC):
        found = []
        for seed in range(1, 3 if quick else 21):
            full_ua = 1000 * profile.full_ma[MIDDLE] * bank.kernels(mode)[MIDDLE]
            current_ua = np.rint(levels[:, None] * full_ua).astype(np.int16)
            train = Interval(
                np.arange(len(levels)) * 0.02, np.full(len(levels), 200, np.float32), current_ua
            )
            fired = Nerve(st.Finger(profile, seed, anatomy)).of(train).fired.any(axis=0)
            found.append(
                levels[fired.argmax()] * profile.full_ma[MIDDLE] if fired.any() else np.nan
            )
        felt = np.array(found)[np.isfinite(found)]
        row(
            "Current at which the first afferent fires, mA",
            {
                "anatomy": anatomy,
                "mode": mode.name,
                "median": f"{np.median(felt):.2f}",
                "least to most": f"{felt.min():.2f} to {felt.max():.2f}",
                "fingers where none does": f"{len(found) - len(felt)} of {len(found)}",
            },
        )
        assert 0 < np.median(felt) < profile.full_ma[MIDDLE]
