"""The slots of one class: as strong as asked, and within every limit."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from smarttouch.base.afferent import Afferent, Mode
from smarttouch.base.errors import ScheduleError
from smarttouch.base.tactile_image import TactileImage
from smarttouch.kernels.bank import load_bank
from smarttouch.profile import load_profile
from smarttouch.stimulation.pulse_rates import ScanTiming
from smarttouch.stimulation.safety_gate import SafetyGate, SafetyLimits
from smarttouch.stimulation.scheduler import ScanScheduler

from ..support.checks import raises
from ..support.scans import open_level, prove_alone


def image(activation, time_ns=10**9):
    rows = np.zeros((3, 64), np.float32)
    rows[:2] = activation
    return TactileImage(rows, time_ns, 1.0)


@given(
    intensity=st.floats(0, 1, width=32),
    seed=st.integers(0, 2**32 - 1),
    mode=st.sampled_from([each for each in Mode if each is not Mode.COLOR]),
    softness=st.floats(0, 1),
    pressure=st.floats(0, 1),
)
def test_every_sequence_of_every_mode_is_safe(
    profile, bank, intensity, seed, mode, softness, pressure
):
    activation = np.random.default_rng(seed).random(64, np.float32)
    activation[activation < 0.3] = 0
    scan = ScanScheduler(profile, bank, mode.afferents, softness=softness)
    gate = SafetyGate(SafetyLimits.of(profile))
    open_level(gate.check, scan.schedule(image(activation, 0), 0.0), gate.limits)
    gate.check(scan.schedule(image(activation), intensity, pressure))


@pytest.mark.parametrize(("options", "attributes"), [
    ({"rate_hz": 50.0}, {"names": "rate_hz", "value": 50}),
    ({"timing": ScanTiming(whole_hz=True)}, {"names": "mode", "allowed": ("RA", "SAI")}),
    ({"timing": ScanTiming(in_index_order=True)}, {"names": "mode", "allowed": ("RA", "SAI")}),
])  # fmt: skip
def test_where_two_rates_are_not_possible(profile, bank, options, attributes):
    with raises(ScheduleError, **attributes):
        ScanScheduler(profile, bank, Mode.NATURAL.afferents, **options)


@pytest.mark.parametrize("keys", [
    {"perception.comfort_ma": (2.0,) * 8},
    {"limits.electrode_ma": (1.0,) * 8},
])  # fmt: skip
def test_a_comfort_that_is_just_the_limit_stays_within_it(changed, keys):
    """Remainders of rounding never push the strongest electrode above its limit."""
    line = changed(load_profile("line-8"), keys)
    bank = load_bank(line)
    for afferent in Afferent:
        scan = ScanScheduler(line, bank, (afferent,), 10.0)
        rows = np.zeros((3, 8), np.float32)
        rows[afferent] = 1
        for level in np.linspace(0.5, 1, 30):
            prove_alone(line, scan.schedule(TactileImage(rows, 0, 1.0), float(level)))


def test_rounding_of_a_thousand_small_currents_is_no_charge_above_the_limit(profile, bank, changed):
    """2.6 µA round to 3: what 923 electrodes leave over is 370 µA."""
    wide = changed(profile, {"array.rows": 32, "array.columns": 32})
    weights = np.zeros((1024, 1024))
    for site in range(100):
        weights[site, site] = 1
        weights[site, 101:] = -1 / 923
    scan = ScanScheduler(
        wide, replace(bank, weights={Afferent.SAI: weights}), (Afferent.SAI,), 10.0
    )
    rows = np.zeros((3, 1024), np.float32)
    rows[Afferent.SAI, :100] = np.linspace(0.1, 1, 100)
    for intensity in np.linspace(0.1, 1, 10):
        sequence = scan.schedule(TactileImage(rows, 0, 1.0), float(intensity))
        prove_alone(wide, sequence)
        assert sequence.slots == 100
        assert np.abs(sequence.current_ua).max() <= 2500
    strongest = sequence.site.tolist().index(99)
    assert np.abs(sequence.current_ua[strongest] - 2400 * weights[99]).max() < 1.01
