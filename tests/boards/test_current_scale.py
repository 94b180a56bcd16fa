"""The scale of a board's current lies in a band around its nominal, or nothing is sent."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from smarttouch.base.errors import BoardError
from smarttouch.boards.kits.current_scale import BAND, NOMINAL_UA, measured_scale
from smarttouch.boards.open import make_board
from smarttouch.boards.probe_scans import one_each
from smarttouch.profile.device import Output
from smarttouch.stimulation.safety_gate import SafetyLimits

from ..support.checks import raises

KINDS = tuple(NOMINAL_UA)
ELECTRODES = {"kajimoto61": 61, "etactilekit": 8}
WIDTH_US = {"kajimoto61": 50, "etactilekit": 200}


def board_of(kind, ua_per_count, **changes):
    count = ELECTRODES[kind]
    fields = {"current_ma": 3.0, "pulse_us": 200, "charge_uc": 0.5, "rate_hz": 100, "duty": 0.6}
    limits = SafetyLimits(count, **fields | {"ramp_s": 0.5, "full_ma": 2.8} | changes)
    output = Output(kind="one-against-all", ua_per_count=ua_per_count)
    return make_board(f"{kind}:/dev/nowhere", limits, output), limits


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    "factor", [1e-6, 0.001, 1 / 4.09, 0.5, 1 - BAND - 0.001, 1 + BAND + 0.001, 2.0, 4.09, 1000, 1e6]
)
def test_a_scale_beyond_the_band_is_refused_before_anything_is_opened(kind, factor):
    scale_ua = factor * NOMINAL_UA[kind]
    # There is no such port: to open it would be another error.
    with raises(BoardError, names="output.ua_per_count", value=scale_ua):
        board_of(kind, scale_ua)


def counts_of(kind, board, current_ua, limits):
    sequence = one_each(
        limits, current_ua, WIDTH_US[kind], 1.0, 10**9, cathodic=False, sites=[1],
        discharge_us=150, period_us=20_000,
    )  # fmt: skip
    data = board.driver.encode(sequence)
    if kind == "kajimoto61":
        return 16 * data[2]
    return int(np.frombuffer(data, "<u2")[1])


@given(ratio=st.floats(1 - BAND, 1 + BAND), kind=st.sampled_from(KINDS), part=st.floats(0, 1))
def test_counts_keep_current_and_charge_by_either_scale(ratio, kind, part):
    limit_ma = 2.4 if kind == "kajimoto61" else 2.0
    own = tuple([limit_ma] * ELECTRODES[kind])
    board, limits = board_of(kind, ratio * NOMINAL_UA[kind], electrode_ma=own, charge_uc=0.3)
    assert board.driver.ua_per_count == pytest.approx(ratio * NOMINAL_UA[kind])
    wanted_ua = int(part * 1000 * min(limit_ma, 300 / WIDTH_US[kind]))
    counts = counts_of(kind, board, wanted_ua, limits)
    for scale_ua in (NOMINAL_UA[kind], board.driver.ua_per_count):
        assert counts * scale_ua <= 1000 * limit_ma * (1 + 1e-9)
        assert counts * scale_ua * WIDTH_US[kind] <= 0.3e6 * (1 + 1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_a_scale_that_is_too_low_does_not_raise_the_largest_current(kind):
    nominal, _ = board_of(kind, None)
    low, limits = board_of(kind, (1 - BAND) * NOMINAL_UA[kind])
    most = 2500 if kind == "etactilekit" else 3000
    assert counts_of(kind, low, most, limits) == counts_of(kind, nominal, most, limits)
    # Well below the limit what was measured is believed.
    ratio = counts_of(kind, low, 1500, limits) / counts_of(kind, nominal, 1500, limits)
    assert ratio == pytest.approx(1 / (1 - BAND), rel=0.05)


@pytest.mark.parametrize(("volts", "ohm", "current_ma"), [
    (0.0, 1000, 1), (-1.0, 1000, 1), (math.nan, 1000, 1), (math.inf, 1000, 1), (1.0, math.nan, 1),
    (1.0, math.inf, 1), (1.0, 0, 1), (1.0, 1000, math.nan), (1.0, 1000, -1), (1000.0, 1000, 1),
    (1.0, 1, 1), (0.001, 1000, 1), (1.0, 1000, 1000), (2.0, 1000, 1), (1e-320, 1e308, 1),
    (1.31, 1000, 1),
])  # fmt: skip
def test_impossible_readings_are_refused(volts, ohm, current_ma):
    with raises(BoardError):
        measured_scale("link", None, volts, ohm, current_ma)
