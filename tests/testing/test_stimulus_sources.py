"""The contract of sources of stimuli, run over those that there are."""

from contextlib import ExitStack

import pytest

import smarttouch as st
from smarttouch import lab
from smarttouch.testing import StimulusContract


class TestTexture(StimulusContract):
    def make(self, profile):
        texture = lab.open_texture("grating:4mm")
        motion = lab.open_motion_over(texture, "sweep:", profile, speed_mm_s=60)
        return lab.MouseSource(texture, motion, profile, press_n=lab.reading_force_n(profile))

    def make_impossible(self, profile):
        lab.open_texture("grating:-4mm")


class TestVibration(StimulusContract):
    def make(self, profile):
        trace = lab.open_trace("tone:30Hz,9um+press:0.45N", 0.5)
        mixture = lab.mix_colors(trace, profile, st.load_kernels(profile))
        return lab.ColorSource("a vibration", profile, mixture)

    def make_impossible(self, profile):
        lab.open_trace("tone:loud")


class TestExperiment(StimulusContract):
    ends = False  # somebody must answer

    @pytest.fixture(autouse=True)
    def _sittings(self, tmp_path):
        self.folder = tmp_path
        with ExitStack() as self.sittings:
            yield

    def make(self, profile):
        made = lab.new_experiment("detection", profile, lab.ExperimentOptions(repetitions=1))
        about = lab.About("detection-RA", made.method, "S1", "", 1)
        path = self.folder / f"{len([*self.folder.iterdir()])}.csv"
        opened = lab.open_experiment(made, profile, lab.TrialTiming(), about, path)
        sitting = self.sittings.enter_context(opened)
        return sitting.source()

    def make_impossible(self, profile):
        lab.new_experiment("frequency", profile, lab.ExperimentOptions(site=64))
