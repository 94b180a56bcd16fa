"""The contract of sources of stimuli, run over those that there are."""

import smarttouch as st
from smarttouch import lab
from smarttouch.instruments.color_mix import ColorSource
from smarttouch.testing import StimulusContract


class TestTexture(StimulusContract):
    def make(self, profile):
        texture = lab.open_texture("grating:4mm")
        motion = lab.open_motion_over(texture, "sweep:", profile, speed_mm_s=60)
        return lab.MouseSource(texture, motion, profile, press_n=lab.reading_force_n(profile))


class TestVibration(StimulusContract):
    def make(self, profile):
        trace = lab.open_trace("tone:30Hz,9um+press:0.45N", 0.5)
        mixture = lab.mix_colors(trace, profile, st.load_kernels(profile))
        return ColorSource("a vibration", profile, mixture)
