"""Contract tests of the circle source, and a test of its motion."""

import numpy as np
from smarttouch_circle import CircleSource, open_circle

import smarttouch as st
from smarttouch.testing import StimulusContract


class TestCircle(StimulusContract):
    longest_s = 10.0

    def make(self, profile: st.Profile) -> CircleSource:
        return open_circle("", profile)

    def test_after_half_a_turn_it_is_on_the_other_side(self, profile: st.Profile) -> None:
        place_mm = profile.electrodes.position_mm - profile.electrodes.position_mm.mean(axis=0)
        with open_circle("1", profile) as source:
            strongest = []
            for time_ns in (0, 500_000_000):
                stimulus = source.read(time_ns)
                assert stimulus is not None
                strongest.append(place_mm[np.argmax(stimulus.activation[st.Afferent.RA])])
        assert np.linalg.norm(strongest[0] + strongest[1]) < 3.0
