"""Proofs of what no currents avoid: they hold for any currents, and so do their opposites."""

import numpy as np
import pytest

from smarttouch.base.afferent import Afferent
from smarttouch.physiology.finger import Finger
from smarttouch.physiology.spikes import SpikeModel
from smarttouch.profile import load_profile

from ..reference.unavoidable import Limits, spared

LIMITS = Limits(1.0, 2.0)


def allowed(random, count):
    """Return currents that sum to zero within the limits, (count, 6)."""
    current_ma = random.normal(size=(count, 6)) * random.choice([0.01, 1.0], (count, 6))
    current_ma -= current_ma.mean(axis=1, keepdims=True)
    most = np.abs(current_ma).max(axis=1)
    total = np.maximum(current_ma, 0).sum(axis=1)
    factor = np.minimum(LIMITS.electrode_ma / most, LIMITS.total_ma / total)
    return current_ma * factor[:, None]


def test_the_most_of_a_row_is_reached_and_never_passed():
    random = np.random.default_rng(1)
    row = random.normal(size=6)
    ranked = np.argsort(row)
    best = np.zeros(6)
    best[ranked[-2:]], best[ranked[:2]] = 1.0, -1.0
    assert LIMITS.allow(best)
    assert LIMITS.most(row)[0] == pytest.approx(best @ row)
    assert (allowed(random, 2000) @ row <= LIMITS.most(row)[0] + 1e-12).all()


def test_a_proof_holds_for_all_currents():
    random = np.random.default_rng(2)
    target = random.normal(2, 1, 6)
    # Between these two lies the target: where it fires, one of them does.
    shift = random.normal(0, 0.3, 6)
    rows = np.array([target, 1.1 * (target + shift), 1.1 * (target - shift)], np.float32)
    current_ma, (proof,) = spared(rows, np.array([0]), np.array([1, 2]), LIMITS)
    assert current_ma is None
    assert proof.bound(rows, LIMITS) == pytest.approx(1.1, abs=1e-4)
    drive = allowed(random, 20_000) @ rows.T
    fires = drive[:, 0] >= 1
    assert fires.sum() > 100
    assert drive[fires, 1:].max(axis=1).min() >= proof.bound(rows, LIMITS)


def test_prices_that_prove_nothing_are_not_believed():
    rows = np.eye(3, 6, dtype=np.float32) * 4
    current_ma, proofs = spared(rows, np.array([0]), np.array([1, 2]), LIMITS)
    assert not proofs
    assert LIMITS.allow(current_ma)
    assert (rows @ current_ma)[0] >= 1 - 1e-6
    assert (rows @ current_ma)[1:].max() < 1
    same = rows[:1] * np.array([[1.0], [1.1]], np.float32)
    current_ma, (proof,) = spared(same, np.array([0]), np.array([1]), LIMITS)
    assert current_ma is None
    assert proof.bound(same, LIMITS) >= 1
    with pytest.raises(AssertionError):
        proof._replace(price=-proof.price).bound(same, LIMITS)
    assert proof._replace(gain=100.0).bound(same, LIMITS) < 1


def test_a_known_finger_can_be_spared_all_but_the_point():
    profile = load_profile("smarttouch-4x4")
    limits = Limits(profile.limits.current_ma, float(profile.limits.total_ma or 10))
    finger = Finger(profile, 3, "paper")
    rows, starts = finger.rows
    owner = np.repeat(np.arange(len(starts)), np.diff(np.append(starts, len(rows))))
    away_mm = np.linalg.norm(finger.receptor_mm - profile.electrodes.position_mm[5], axis=1)
    own = finger.classes == Afferent.RA
    near = own & (away_mm <= profile.electrodes.pitch_mm / 2)
    amiss = ~own | (away_mm > profile.electrodes.pitch_mm)
    targets, passing = (np.flatnonzero(each[owner]) for each in (near, amiss))
    current_ma, _ = spared(rows, targets, passing, limits, 0.9)
    assert limits.allow(current_ma)
    width_us = np.array([profile.pulse.width_us])
    felt = SpikeModel(finger).drive(current_ma[None] * 1000, width_us)[:, 0]
    assert felt[near].max() >= 1 - 1e-3
    assert felt[amiss].max() < 0.92
