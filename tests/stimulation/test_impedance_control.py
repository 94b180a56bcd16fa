"""Impedance control holds charge or energy while impedance drifts, and keeps all limits."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from smarttouch.base.afferent import Afferent
from smarttouch.base.tactile_image import TactileImage
from smarttouch.kernels.bank import load_bank
from smarttouch.profile import Profile, load_profile
from smarttouch.stimulation.impedance_control import ImpedanceControl
from smarttouch.stimulation.safety_gate import SafetyGate, SafetyLimits
from smarttouch.stimulation.scan_sequence import ScanTiming
from smarttouch.stimulation.scheduler import ScanScheduler

from ..support.full import WHOLE, sample
from ..support.scans import open_level

COMPLIANCE_V = 300.0
KOHM = 50.0


def with_pulse(name, width_us, **more):
    """Return a shipped profile with other pulses and limits; its kernels remain valid."""
    table = load_profile(name).model_dump()
    table["pulse"]["width_us"] = width_us
    for key, value in more.items():
        for inner in table.values():
            if isinstance(inner, dict) and key in inner:
                inner[key] = value
    return Profile.model_validate(table)


MOUSE = with_pulse("electric-mouse", 80)
SWITCHED = with_pulse("smarttouch-4x4", 100)


class Finger:
    """Simulated finger with one resistance per electrode, driven with impedance control."""

    def __init__(self, profile, hold, timing=None):
        self.impedance = ImpedanceControl(profile, hold, COMPLIANCE_V)
        self.scan = ScanScheduler(
            profile, load_bank(profile), (Afferent.RA,), profile.pulse.rate_hz, timing
        )
        self.kohm = np.full(len(profile.electrodes), KOHM)
        self.time_ns = 0

    def touch(self, activation=1.0, intensity=1.0, adapted=True):
        """Return the requested and the sent scan, and each slot's charge in µC and voltage in V."""
        self.time_ns += 20_000_000
        rows = np.zeros((3, len(self.kohm)), np.float32)
        rows[Afferent.RA] = activation
        image, impedance = TactileImage(rows, self.time_ns, 1.0), self.impedance
        asked = self.scan.schedule(image, intensity)
        sent = self.scan.schedule(image, intensity, impedance=impedance) if adapted else asked
        peak_ma = np.abs(sent.current_ua.astype(float)).max(axis=1) / 1000
        volts = np.minimum(self.kohm[sent.site] * peak_ma, COMPLIANCE_V)
        self.impedance.observe(sent, volts.astype(np.float32))
        delivered_uc = volts / self.kohm[sent.site] * sent.width_us / 1000
        return asked, sent, delivered_uc, volts


def charges_uc(scan):
    """Return the charge of the strongest electrode of each slot, (S,) µC."""
    return np.abs(scan.current_ua.astype(float)).max(axis=1) * scan.width_us / 1e6


@pytest.mark.parametrize("profile", [MOUSE, SWITCHED], ids=lambda profile: profile.name)
def test_charge_is_held_while_an_electrode_dries(profile):
    """Impedance quadruples in 4 s. Without control, a 300 V source then delivers a third less."""
    finger, plain = Finger(profile, "charge"), Finger(profile, "charge")
    lost, lost_plain = [], []
    for step in range(250):
        for each in (finger, plain):
            each.kohm[9] = KOHM * 4 ** min(1.0, step / 200)
        asked, _, delivered, _ = finger.touch()
        site = int(np.flatnonzero(asked.site == 9)[0])
        lost.append(1 - delivered[site] / charges_uc(asked)[site])
        _, _, unheld, _ = plain.touch(adapted=False)
        lost_plain.append(1 - unheld[site] / charges_uc(asked)[site])
        others = np.delete(delivered / charges_uc(asked), site)
        assert others == pytest.approx(1, abs=1e-6)
    assert np.abs(lost).max() < 0.015
    assert lost_plain[-1] > 0.3
    assert finger.impedance.limited == ()


def test_where_pulses_cannot_be_longer_that_is_reported():
    finger = Finger(MOUSE, "charge")
    finger.kohm[9] = 2000.0
    for _ in range(30):
        _, sent, _, _ = finger.touch()
    slot = np.flatnonzero(sent.site == 9)
    assert finger.impedance.limited == (9,)
    assert sent.width_us[slot] == 200
    finger.kohm[9] = KOHM
    for _ in range(30):
        finger.touch()
    assert finger.impedance.limited == ()


@pytest.mark.parametrize("drift", sample([0.25, 4.0]))
def test_energy_is_held_there_and_back(drift):
    """Impedance changes by a factor of 4 and back; no current exceeds its requested value."""
    finger = Finger(MOUSE, "energy")
    _, first, _, volts = finger.touch(0.1)
    energy = np.abs(first.current_ua.astype(float)).max(axis=1) * volts
    for step in [*range(1, 101), *range(100, -1, -1)]:
        finger.kohm[:] = KOHM * drift ** (step / 100)
        asked, sent, _, volts = finger.touch(0.1)
        now = np.abs(sent.current_ua.astype(float)).max(axis=1)
        assert now * volts == pytest.approx(energy, rel=0.05)
        assert (now <= np.abs(asked.current_ua.astype(float)).max(axis=1)).all()
    assert np.array_equal(sent.width_us, asked.width_us)
    assert not finger.impedance.limited


def test_energy_that_would_need_more_than_was_asked_for_is_not_held():
    finger = Finger(MOUSE, "energy")
    finger.touch(0.1)
    finger.kohm[:] = KOHM / 9
    for _ in range(60):
        asked, sent, _, _ = finger.touch(0.1)
    assert np.array_equal(sent.current_ua, asked.current_ua)
    assert np.array_equal(sent.width_us, asked.width_us)
    assert finger.impedance.limited


def test_longer_pulses_lengthen_the_period():
    profile = with_pulse("electric-mouse", 80, rate_hz=86.0, discharge_us=100)
    timing = ScanTiming(slot_extra_us=1, scan_us=5)
    finger = Finger(profile, "charge", timing)
    finger.kohm[:] = 230.0
    for _ in range(20):
        asked, sent, _, _ = finger.touch()
    busy = int(sent.width_us.sum(dtype=int) + sent.discharge_us.sum(dtype=int))
    assert asked.period_us < sent.period_us
    assert sent.period_us == busy + 64 + 5


SAFE = [
    MOUSE,
    SWITCHED,
    load_profile("kajimoto-61"),
    load_profile("etactilekit-32"),
    with_pulse("line-7", 60, duty=0.02, electrode_ma=[1.0] * 7, total_ma=1.2),
]


SAFE_BANKS = {profile.name: load_bank(load_profile(profile.name)) for profile in SAFE}


@pytest.mark.parametrize("profile", SAFE, ids=lambda profile: profile.name)
@pytest.mark.parametrize("hold", ["charge", "energy"])
@given(seed=st.integers(0, 2**32 - 1), density=st.floats(0, 1))
@settings(max_examples=40 if WHOLE else 5)  # each example has six sequences
def test_whatever_is_measured_the_result_is_safe(profile, hold, seed, density):
    rng, count = np.random.default_rng(seed), len(profile.electrodes)
    impedance, gate = (
        ImpedanceControl(profile, hold, COMPLIANCE_V), SafetyGate(SafetyLimits.of(profile)),
    )  # fmt: skip
    bank = SAFE_BANKS[profile.name]
    scan = ScanScheduler(profile, bank, (Afferent.RA,), profile.pulse.rate_hz)
    nothing = TactileImage(np.zeros((3, count), np.float32), 0, 1.0)
    open_level(gate.check, scan.schedule(nothing, 0.0), gate.limits)
    # Use falling intensities, because the gate refuses a sudden rise.
    for step, intensity in enumerate(sorted([*rng.random(5), 0.0], reverse=True), 1):
        rows = np.zeros((3, count), np.float32)
        rows[Afferent.RA] = rng.random(count) * (rng.random(count) < density)
        shown = TactileImage(rows, step * 10**9, 1.0)
        asked, sent = (
            scan.schedule(shown, float(intensity), impedance=each) for each in (None, impedance)
        )
        gate.check(sent)
        less, more = (np.abs(each.current_ua.astype(int)) for each in (sent, asked))
        assert np.all(less <= more)
        assert np.all((sent.current_ua == 0) | (np.sign(sent.current_ua) == asked.state))
        if profile.output.kind != "weighted":
            assert np.array_equal(sent.state, asked.state), "an electrode was switched off"
        if hold == "charge" and asked.slots:
            # Rounding a width changes charge by at most 0.5 µs × current. Limiting it changes more.
            apart = np.abs(charges_uc(sent) - charges_uc(asked)) * 1e6
            most_us = np.minimum(200, 500_000 // np.maximum(less.max(axis=1), 1))
            assert np.all((apart <= less.max(axis=1) / 2 + 1) | (sent.width_us >= most_us))
        volts = rng.choice([0.0, 1.0, 50.0, 270.0, 299.0, 300.0, np.nan], sent.slots)
        impedance.observe(sent, volts.astype(np.float32))
