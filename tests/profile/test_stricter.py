"""Two profiles are combined: for each limit, the stricter value applies."""

import numpy as np
import pytest

from smarttouch.base.errors import ProfileError
from smarttouch.profile import load_profile
from smarttouch.profile.profile import stricter
from smarttouch.stimulation.safety_limits import SafetyLimits


def with_limits(profile, **limits):
    return profile.model_copy(update={"limits": profile.limits.model_dump() | limits})


def with_output(profile, masked):
    return profile.model_copy(update={"output": profile.output.model_dump() | {"masked": masked}})


def comfortable(profile, comfort_ma, threshold_ma=None):
    perception = profile.perception.model_dump() | {"comfort_ma": comfort_ma}
    if threshold_ma is not None:
        perception["threshold_ma"] = threshold_ma
    return profile.model_copy(update={"perception": perception})


@pytest.mark.parametrize(
    ("key", "strict", "wide"),
    [
        ("current_ma", 2.5, 5.0), ("total_ma", 4.0, 10.0), ("total_ma", 4.0, None),
        ("pulse_us", 200.0, 200.0), ("charge_uc", 0.49, 0.5), ("rate_hz", 60.0, 200.0),
        ("duty", 0.4, 0.8), ("density_uc_cm2", 70.0, 100.0), ("session_s", 60.0, 3600.0),
        ("session_mc", 5.0, 1800.0), ("ramp_s", 2.0, 0.5),
    ],
)  # fmt: skip
def test_the_lower_limit_holds_whoever_has_it(profile, key, strict, wide):
    """The order of the profiles does not matter; of two ramps, the longer one is stricter."""
    one, other = (with_limits(profile, **{key: value}) for value in (strict, wide))
    assert getattr(stricter(other, one).limits, key) == strict
    assert getattr(stricter(one, other).limits, key) == strict
    assert stricter(other, one).shares == other.shares


def test_the_same_limits_leave_a_profile_as_it_is(profile):
    again = type(profile).model_validate(profile.model_dump())
    assert stricter(profile, again) is profile


def test_currents_of_single_electrodes(profile):
    own = comfortable(profile, tuple(np.linspace(1.4, 2.4, 64)))
    other = comfortable(profile, tuple(np.linspace(2.4, 1.4, 64)), 1.0)
    both = stricter(own, other)
    np.testing.assert_allclose(both.full_ma, np.minimum(own.full_ma, other.full_ma), atol=2e-3)
    assert (both.full_ma <= np.minimum(own.full_ma, other.full_ma) + 1e-6).all()
    np.testing.assert_allclose(both.threshold_ma, 1.0)
    lowered = comfortable(profile, (2.4,) * 63 + (1.3,))
    lowered = stricter(profile, with_limits(lowered, electrode_ma=(2.4,) * 63 + (1.4,)))
    assert lowered.limits.electrode_ma[63] == 1.4
    assert lowered.full_ma[63] == pytest.approx(1.3, abs=2e-3)


def test_limits_that_lower_the_pulse_lower_what_is_comfortable(profile):
    """The result has the shorter pulse and the lower comfort level, and keeps all limits."""
    shorter = profile.model_copy(
        update={
            "limits": profile.limits.model_dump() | {"pulse_us": 100.5, "charge_uc": 0.2},
            "pulse": profile.pulse.model_dump() | {"width_us": 100},
            "perception": profile.perception.model_dump() | {"comfort_ma": (2.0,) * 64},
        }
    )
    both = stricter(profile, shorter)
    assert both.pulse.width_us == 100
    assert both.full_ma.max() == pytest.approx(2.0, abs=2e-3)
    SafetyLimits.of(both)


def test_masks_add_up(profile):
    both = stricter(with_output(profile, (3, 5)), with_output(profile, (5, 9)))
    assert both.output.masked == (3, 5, 9)


def test_another_array_lowers_all_electrodes_to_its_least(profile):
    other_array = load_profile("kajimoto-61")
    currents = np.full(len(other_array.electrodes), 2.0)
    currents[7] = 1.5
    masked = with_output(comfortable(other_array, tuple(currents), 1.2), (2,))
    both = stricter(profile, masked)
    assert both.full_ma.max() == pytest.approx(1.5, abs=2e-3)
    assert (len(both.electrodes), both.output.masked) == (64, ())


def test_what_no_pulse_fits_is_refused(profile):
    with pytest.raises(ProfileError):
        stricter(with_output(profile, (62,)), with_output(profile, tuple(range(62))))
