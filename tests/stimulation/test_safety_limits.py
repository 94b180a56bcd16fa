"""Limits as whole numbers, and what they take of a profile."""

import numpy as np
import pytest

from smarttouch.profile import list_profiles, load_profile
from smarttouch.stimulation.safety_limits import (
    SafetyLimits,
    decimal,
    parts_per_billion,
    rms_ma_cm2,
)


def test_a_limit_is_the_decimal_that_a_person_wrote():
    # The nearest double to 2.3 lies below it: 2,299 µA would be the limit.
    limits = SafetyLimits(2, 2.3, 200, 0.5, 200, 0.8, 0.5, 2.3)
    assert limits.current_ua.tolist() == [2300, 2300]
    assert decimal(0.1) * 10 == 1


@pytest.mark.parametrize(
    ("intensity", "ppb"), [(0.0, 0), (1.0, 10**9), (0.5, 5 * 10**8), (1e-300, 1), (0.1, 10**8 + 1)]
)
def test_intensity_is_rounded_up(intensity, ppb):
    assert parts_per_billion(intensity) == ppb


@pytest.mark.parametrize(("rate_hz", "period_us"), [(200, 5000), (30, 33_334), (0.1, 10**7)])
def test_the_shortest_period_keeps_the_rate(rate_hz, period_us):
    assert SafetyLimits(2, 2.3, 200, 0.5, rate_hz, 0.8, 0.5, 2.3).period_us == period_us


def test_density_is_that_of_the_paper_s_pulse():
    assert rms_ma_cm2(load_profile("electric-mouse")) == pytest.approx(30.6, abs=0.1)


@pytest.mark.parametrize("name", list_profiles())
def test_the_smallest_of_charge_density_and_shannon_counts(name):
    profile = load_profile(name)
    limits = SafetyLimits.of(profile)
    area_cm2 = profile.electrodes.area_mm2 / 100
    charge_uc = limits.charge_pc / 1e6
    assert (charge_uc <= 0.5).all()
    assert (charge_uc / area_cm2 <= 100).all()
    assert (charge_uc**2 / area_cm2 <= 10**1.75).all()


def test_a_small_electrode_is_bound_by_its_area():
    limits = SafetyLimits(2, 5.0, 200, 0.5, 200, 0.8, 0.5, 2.4, area_mm2=0.2)
    assert limits.charge_pc.tolist() == [200_000, 200_000]


def test_each_shape_of_an_array_is_bound_by_its_own_area(changed):
    array = {
        "layout": "free",
        "positions_mm": [[0, 0], [0, 0]],
        "shapes": ["disc", "annulus"],
        "sizes_mm": [[0.5, 0.0], [8.0, 6.0]],
    }
    limits = SafetyLimits.of(changed(load_profile("electric-mouse"), {"array": array}))
    area_cm2 = np.pi / 400 * np.array([0.25, 28.0])
    assert limits.charge_pc[0] == pytest.approx(1e8 * area_cm2[0], abs=1)
    assert limits.charge_pc[0] < limits.charge_pc[1] == 500_000
