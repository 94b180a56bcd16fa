"""Limits as whole numbers, and what they take of a profile."""

import numpy as np
import pytest

from smarttouch.profile import load_profile
from smarttouch.stimulation.safety_limits import (
    SafetyLimits,
    decimal,
    rms_ma_cm2,
)


def test_a_limit_is_the_decimal_that_a_person_wrote():
    # The nearest double to 2.3 lies below it: 2,299 µA would be the limit.
    limits = SafetyLimits(2, 2.3, 200, 0.5, 200, 0.8, 0.5, 2.3)
    assert limits.current_ua.tolist() == [2300, 2300]
    assert decimal(0.1) * 10 == 1


def test_density_is_that_of_the_paper_s_pulse():
    assert rms_ma_cm2(load_profile("electric-mouse")) == pytest.approx(30.6, abs=0.1)


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
