"""Frequency and thresholds that the spikes of many fingers give, in both anatomies.

Of 20 fingers each, at the middle electrode, full pulses: PC spikes for RA spikes, each for its
density; the 75 % thresholds of frequency that follow; and the current at which the first afferent
fires.
"""

import numpy as np
import pytest

import smarttouch as st
from smarttouch.experiments.observers import Interval, Nerve, believable_hz
from tests.experiments.simulated import ratio_of, weber_fraction

RA, SAI, PC = st.Afferent
MIDDLE = 27
STANDARDS_HZ = (30, 45, 60, 75, 90, 100, 120)


LEVELS = np.arange(0.2, 1.005, 0.02)


@pytest.mark.timeout(0)
@pytest.mark.parametrize("anatomy", ["paper", "branched"])
def test_frequency_and_detection(row, quick, profile, bank, anatomy):
    limits = {}
    ratios, delivered_ma = {RA: [], PC: []}, {each: [] for each in (RA, SAI, PC)}
    for seed in range(1, 3 if quick else 21):
        finger = st.Finger(profile, seed, anatomy)
        for mode, found in ratios.items():
            found.append(ratio_of(finger, bank, mode, MIDDLE))
        for mode, found in delivered_ma.items():
            found.append(first_felt_ma(finger, bank.kernels(mode)[MIDDLE]))
    for mode, found in ratios.items():
        weber = {
            f"{hz} Hz": spread([weber_fraction(hz, ratio) for ratio in found])
            for hz in STANDARDS_HZ
        }
        limits[mode] = np.median([believable_hz(ratio) for ratio in found])
        row(
            "75 % threshold of frequency, median and middle 90 % of fingers",
            {
                "anatomy": anatomy,
                "mode": mode.name,
                "PC for RA, median (least to most)": (
                    f"{np.median(found):.2f} ({min(found):.2f} to {max(found):.2f})"
                ),
                "believed up to, Hz": f"{limits[mode]:.0f}",
            }
            | weber,
        )
    for mode, found in delivered_ma.items():
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
    assert limits[RA] == pytest.approx(65)
    # With axons that branch too few PC fire among the many RA.
    assert (limits[PC] > 100) == (anatomy == "paper")


def spread(values):
    """Return a median with the middle 90 %, in words; inf where there is no threshold."""
    middle, low, high = np.quantile(values, (0.5, 0.05, 0.95), method="nearest")
    return f"{middle:.2f} ({low:.2f} to {high:.2f})"


def first_felt_ma(finger, kernel):
    """Return the weakest current at which an afferent fires, mA; NaN where none does."""
    full_ma = finger.profile.full_ma[MIDDLE]
    current_ua = np.rint(1000 * LEVELS[:, None] * full_ma * kernel).astype(np.int16)
    time_s, width_us = np.arange(len(LEVELS)) * 0.02, np.full(len(LEVELS), 200, np.float32)
    fired = Nerve(finger).of(Interval(time_s, width_us, current_ua)).fired.any(axis=0)
    return LEVELS[fired.argmax()] * full_ma if fired.any() else np.nan
