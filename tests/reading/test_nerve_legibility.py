"""Lines at the nerve: pictures of what afferents report, and figures over fingers."""

from dataclasses import replace

import numpy as np
import pytest

from smarttouch.base.afferent import Afferent
from smarttouch.kernels.bank import load_bank
from smarttouch.physiology.finger import Finger
from smarttouch.physiology.response import response_quality
from smarttouch.physiology.spikes import SpikeModel
from smarttouch.profile import load_profile
from smarttouch.reading.delivered_lines import DeliveredLine, read_at_nerve
from smarttouch.running.delivered import LinePicture, delivered_spikes
from smarttouch.sources.source_contract import Pose


@pytest.fixture(scope="module")
def delivered():
    """Return a line of which one electrode's kernel is delivered halfway, and nothing elsewhere."""
    profile = load_profile("smarttouch-4x4")
    kernel = load_bank(profile).kernels(Afferent.RA)[5] * profile.full_ma[5] * 1000
    answer = np.zeros(16, np.float32)
    answer[5] = 1
    line = DeliveredLine(
        LinePicture(profile.electrodes, 20.0), 20.0,
        {1: Pose(4.0, 0.0), 2: Pose(10.0, 0.0), 3: Pose(16.0, 0.0)},
        dict.fromkeys((1, 2, 3), answer > 0), {2: answer},
        np.array([2], np.uint32), np.array([200], np.float32),
        np.round(kernel)[None].astype(np.int16),
    )  # fmt: skip
    return profile, line


def test_what_is_felt_lies_around_the_electrode_that_was_delivered(delivered):
    profile, line = delivered
    found = read_at_nerve([line], Finger(profile, 1, "paper"), [Afferent.RA])
    (picture,) = found.pictures
    x_mm = profile.electrodes.position_mm[5, 0] + np.array([4.0, 10.0, 16.0])
    y_mm = np.full(3, profile.electrodes.position_mm[5, 1] + profile.electrodes.extent_mm[1] / 2)
    first, middle, last = picture.at(x_mm, y_mm)
    assert middle > max(first, last)
    assert found.silent_points == 0
    assert 0 <= found.wrong_class <= 1


def test_a_line_that_is_never_delivered_is_not_felt(delivered):
    profile, line = delivered
    nothing = DeliveredLine(
        line.picture, 20.0, line.poses, line.meant, {}, line.numbers[:0], line.width_us[:0],
        line.current_ua[:0],
    )  # fmt: skip
    found = read_at_nerve([nothing], Finger(profile, 1, "paper"), [Afferent.RA])
    assert not found.pictures[0].values().any()
    assert np.isnan(found.silent_points)


@pytest.mark.parametrize("anatomy", ["paper", "branched"])
def test_patterns_of_lines_before_change_no_spike(anatomy):
    """A page's slots, with one model for all lines and with a new one for each: to the bit."""
    profile = load_profile("smarttouch-4x4")
    finger, rng = Finger(profile, 1, anatomy), np.random.default_rng(1)
    kernels = load_bank(profile).kernels(Afferent.RA) * profile.full_ma[:, None] * 1000
    model, fired = SpikeModel(finger), 0
    for _ in range(4):
        site, level = rng.integers(0, 16, 600), rng.uniform(0.3, 1, 600)
        current_ua = np.rint(kernels[site] * level[:, None]).astype(np.int16)
        numbers, width_us = np.arange(600, dtype=np.uint32) // 6, np.full(600, 200, np.float32)
        slots = numbers, width_us, current_ua, dict.fromkeys(range(100), 20_000)
        shared = delivered_spikes(finger, *slots, model=model)
        alone = delivered_spikes(finger, *slots)
        assert shared.keys() == alone.keys()
        assert all(np.array_equal(shared[each], alone[each]) for each in alone)
        fired += sum(int(each.sum()) for each in alone.values())
    assert fired > 500


def test_silent_is_of_what_was_meant_and_not_of_what_was_delivered(delivered):
    """The measure of `ResponseQuality`, which letters and the window have too."""
    profile, line = delivered
    wide = replace(line, meant={2: np.ones(16, np.bool_)})
    finger = Finger(profile, 1, "paper")
    found = read_at_nerve([wide], finger, [Afferent.RA])
    assert found.silent_points > 0.5
    counts = delivered_spikes(
        finger,
        line.numbers,
        line.width_us,
        line.current_ua,
        {2: round(1e6 / profile.pulse.rate_hz)},
    )[2]
    quality = response_quality(finger, counts, wide.meant[2], [Afferent.RA])
    assert found.silent_points == quality.silent_points
    assert found.misplaced == pytest.approx(quality.misplaced, nan_ok=True)
