"""Lines at the nerve: pictures of what afferents report, and figures over fingers."""

import numpy as np
import pytest

from smarttouch.base.afferent import Afferent
from smarttouch.kernels.bank import load_bank
from smarttouch.physiology.finger import Finger
from smarttouch.profile import load_profile
from smarttouch.reading.delivered_lines import DeliveredLine, nerve_figures, read_at_nerve
from smarttouch.running.delivered_line import LinePicture
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
        {1: Pose(4.0, 0.0), 2: Pose(10.0, 0.0), 3: Pose(16.0, 0.0)}, {2: answer},
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
        line.picture, 20.0, line.poses, {}, line.numbers[:0], line.width_us[:0],
        line.current_ua[:0],
    )  # fmt: skip
    found = read_at_nerve([nothing], Finger(profile, 1, "paper"), [Afferent.RA])
    assert not found.pictures[0].values().any()
    assert np.isnan(found.silent_points)


def test_figures_over_fingers(delivered):
    profile, line = delivered
    readings = [read_at_nerve([line], Finger(profile, s, "paper"), [Afferent.RA]) for s in (1, 2)]
    figures = nerve_figures(readings, [0.5, 0.1])
    assert figures["at_nerve"] == {"median": pytest.approx(0.3), "worst_tenth": 0.5}
    assert set(figures) == {"at_nerve", "wrong_class", "misplaced", "silent_points"}
