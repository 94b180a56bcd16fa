"""Comfortable intensity levels are logged, and offered again for the same profile and mode."""

import json

import numpy as np
import pytest

from smarttouch.base.errors import ProfileError
from smarttouch.profile.settled_levels import SettledLevels, levels_file, read_levels

from ..support.scans import sequence

SECOND = 10**9


class Run:
    """Run in which a participant stays at one level after another."""

    def __init__(self, profile, most=1.0):
        self.levels, self.time_ns = SettledLevels(profile, most), 0

    def keep(self, level, seconds, mode="RA", force_n=0.8, observed=()):
        """Stay at a level for some seconds. Return the messages that offer an earlier level."""
        offers = []
        for _ in range(round(seconds * 10) + 1):
            offers.append(self.levels.note(self.time_ns, mode, level, force_n, observed))
            self.time_ns += SECOND // 10
        return [offer for offer in offers if offer]


def settle(profile, level, **more):
    run = Run(profile)
    run.keep(level, 11, **more)
    run.levels.save()


def test_a_level_that_is_kept_is_offered_the_next_time(profile):
    run = Run(profile)
    assert run.keep(0.3, 5) + run.keep(0.45, 11) + run.keep(0.6, 5, mode="SAI") == []
    run.levels.save()
    assert Run(profile).levels.offered == {"RA": pytest.approx(0.45)}
    offers = Run(profile).keep(0.0, 1)
    assert offers == ["level 0.45 was comfortable last time in mode RA: press L to rise to it"]


@pytest.mark.parametrize(
    ("level", "seconds", "force_n"), [(0.5, 9, 0.8), (0.5, 60, 0.05), (0.5, 60, 0), (0, 60, 0.8)]
)
def test_a_level_counts_only_after_ten_seconds_of_touch(profile, level, seconds, force_n):
    run = Run(profile)
    run.keep(level, seconds, force_n=force_n)
    run.levels.save()
    assert read_levels(profile) == []


def test_a_level_above_the_most_is_not_offered(profile):
    settle(profile, 0.5)
    assert SettledLevels(profile, 0.49).offered == {}
    assert SettledLevels(profile, 0.5).offered == {"RA": 0.5}


def test_what_is_offered_is_the_same_current_after_a_calibration(profile):
    settle(profile, 0.5)
    perception = profile.perception.model_copy(update={"comfort_ratio": 1.6})
    lower = profile.model_copy(update={"perception": perception})
    share = profile.full_ma.max() / lower.full_ma.max()
    assert share > 1
    assert SettledLevels(lower, 1.0).offered == {"RA": pytest.approx(0.5 * share, abs=1e-3)}
    settle(profile, 1.0)
    assert SettledLevels(lower, 1.0).offered == {}


def test_the_log_has_force_and_impedance_and_is_only_added_to(profile):
    measured = sequence([[1000, -1000, 0, 0], [2000, -2000, 0, 0]]), np.float32([5, 10])
    settle(profile, 0.5, observed=[measured])
    before = levels_file(profile).read_bytes()
    settle(profile, 0.4)
    assert levels_file(profile).read_bytes().startswith(before)
    first, second = read_levels(profile)
    assert (first.level, first.force_n, first.kohm) == (0.5, 0.8, pytest.approx(5))
    assert first.current_ma == 0.5 * profile.full_ma.max()
    assert (second.level, second.kohm) == (0.4, None)


@pytest.mark.parametrize("text", ["{", "[1]", json.dumps({"mode": "RA"}), '{"current_ma": 1}'])
def test_a_damaged_log_is_named(profile, text):
    settle(profile, 0.5)
    with levels_file(profile).open("a") as file:
        file.write(text)
    with pytest.raises(ProfileError, match="is damaged"):
        SettledLevels(profile, 1.0)
