"""Shared slots by the books of an emulated board: what flowed does what was planned."""

import numpy as np
import pytest

from smarttouch.base.afferent import Afferent
from smarttouch.base.tactile_image import TactileImage
from smarttouch.boards.open import make_board
from smarttouch.kernels.design_problem import Problem
from smarttouch.stimulation.safety_gate import SafetyLimits
from smarttouch.stimulation.scan_sequence import ScanSequence, SlotPolicy
from smarttouch.stimulation.scheduler import ScanScheduler, SchedulerContext


def test_delivered_currents_do_what_was_planned(profile, changed, bank):
    afferent = Afferent.RA
    rng = np.random.default_rng(8)
    scan = ScanScheduler(
        profile, bank, (afferent,), common=SchedulerContext(SlotPolicy((afferent,)))
    )
    sent = {}
    with make_board("simulated:", SafetyLimits.of(profile), profile.output) as board:
        for step in range(60):
            activation = np.zeros((3, 64), np.float32)
            sites = rng.choice(64, rng.integers(2, 30), replace=False)
            activation[afferent, sites] = rng.random(len(sites), np.float32)
            # From zero to full in a second.
            intensity = min(step / 50, 1.0)
            image = TactileImage(activation, step * 20_000_000, 1.0)
            sequence = scan.schedule(image, intensity)
            sent[board.send(sequence)] = sequence, activation[afferent], intensity
        board.drain()
        numbers, width_us, current_ua = board.driver.take_pulses()
        report = board.report()
    limits = profile.limits
    assert report.violations == 0
    assert report.slots == len(numbers) == sum(each.slots for each, _, _ in sent.values())
    assert not current_ua.sum(axis=1, dtype=int).any()
    assert np.abs(current_ua).max() <= 1000 * limits.current_ma
    assert np.abs(current_ua.astype(int)).sum(axis=1).max() <= 2 * 1000 * limits.total_ma
    rows = Problem(changed(profile, {"skin.node_spacing_mm": 0.25}), afferent)
    alone_af = profile.full_ma * (rows.target * bank.kernels(afferent)).sum(axis=1)
    faintest = profile.threshold_ma / profile.full_ma
    shared = 0
    for number, (sequence, activation, intensity) in sent.items():
        mine = numbers == number
        assert np.array_equal(current_ua[mine], sequence.current_ua)
        assert (width_us[mine] == sequence.width_us).all()
        if intensity < 0.2:
            continue
        delivered_ma = current_ua[mine] / 1000
        reached_af = delivered_ma @ rows.target.T
        level = np.where(activation > 0, faintest + (1 - faintest) * activation, np.inf)
        part = reached_af / (intensity * level * alone_af)
        # Each point once, as strongly as its own kernel would, but for the evenness allowed.
        served = np.argsort(-part, axis=0)[0]
        best = part.max(axis=0)[activation > 0]
        assert best.min() > 1 - profile.frames.uneven - 0.01
        assert best.max() < 1 + profile.frames.uneven + 0.01
        others_af = (delivered_ma @ rows.other.T).max(axis=1)
        for slot, points in enumerate(sequence.proof.points.tolist()):
            sites = np.flatnonzero((served == slot) & (activation > 0))
            assert len(sites) == points
            if points > 1:
                shared += 1
                weakest_af = (reached_af[slot] / level)[sites].min()
                assert others_af[slot] <= 1.03 * profile.frames.other * weakest_af
    assert shared > 100


@pytest.mark.parametrize("look", ["report", "take_pulses"])
def test_a_sequence_is_over_when_it_was_sent(profile, look):
    """Also what takes so long that a host must say now and then that it is there."""
    one, limits = np.ones(1, np.uint16), SafetyLimits.of(profile)
    current_ua = np.zeros((1, 64), np.int16)
    with make_board("simulated:", limits, profile.output) as board:
        for time_ns, times in ((0, 1), (10**9, 25), (2 * 10**9, 1)):
            current_ua[0, :2] = (500, -500) if time_ns else 0
            intensity = min(time_ns / 10**9, 1.0)
            board.send(
                ScanSequence(current_ua, 100 * one, 100 * one, one, 20_000, intensity, time_ns),
                times,
            )
        found = board.report() if look == "report" else board.driver.take_pulses()
        if look == "report":
            assert (found.sequences, found.slots, found.violations) == (3, 27, 0)
        else:
            assert found[0].tolist() == [1, *[2] * 25, 3]
        assert (board.acknowledged, board.refused) == (3, 0)
