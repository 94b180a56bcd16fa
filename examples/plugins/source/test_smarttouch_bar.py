"""Contract tests of the bar source, and tests of its speed."""

import numpy as np
import pytest
from smarttouch_bar import open_bar

import smarttouch as st
from smarttouch.testing import SourceContract


class TestBar(SourceContract):
    longest_s = 10.0

    def make(self, profile: st.Profile) -> st.OpticalSource:
        return open_bar("", profile)

    def test_it_moves_to_the_right(self, profile: st.Profile) -> None:
        with open_bar("2", profile, speed_mm_s=20.0) as source:
            centers = [np.flatnonzero(source.read(t * 10**8).image[0] < 100).mean() for t in (1, 2)]
        optics = profile.optics
        moved_mm = (centers[1] - centers[0]) / optics.sensor_columns * optics.field_width_mm
        assert moved_mm == pytest.approx(2.0, abs=0.1)

    @pytest.mark.parametrize("speed_mm_s", [0.0, -1.0, 1001.0])
    def test_speeds_that_cannot_be(self, profile: st.Profile, speed_mm_s: float) -> None:
        with pytest.raises(st.SourceError, match="mm/s"):
            open_bar("1", profile, speed_mm_s=speed_mm_s)
