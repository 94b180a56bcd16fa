"""Recordings, pictures, markers and vibrators, which instruments share with every run."""

import sys

import numpy as np
import pytest
from PIL import Image
from scipy.io import wavfile

from smarttouch.running.check_recording import check_recording
from smarttouch.running.recording_reader import Recording

from ..views.test_lsl_markers import FakeLsl

FAST = "live texture:grating:4mm?motion=sweep:?speed_mm_s=120 --board simulated: --quiet"


def test_vibrators_shake_what_was_recorded(program_here, tmp_path, changed):
    mixed = "live vibration:tone:30Hz,8um+tone:250Hz,2um?seconds=1 --board simulated: --quiet"
    program_here(f"{mixed} --vibrators v.wav?grid=1x1 --record a.mcap").flawless()
    rate_hz, wave = wavfile.read(tmp_path / "v.wav")
    spectrum = np.abs(np.fft.rfft(wave.astype(np.float64)))
    assert np.fft.rfftfreq(len(wave), 1 / rate_hz)[spectrum.argmax()] == pytest.approx(250, abs=2)
    recording = Recording(tmp_path / "a.mcap")
    assert recording.settings["vibrators"] == "v.wav?grid=1x1"
    shaken = [each.step.sequence.vibration for each in recording.steps()]
    assert max(each.max() for each in shaken) > 0.8
    assert check_recording(tmp_path / "a.mcap").exact
    slower = changed(recording.profile, {"limits.ramp_s": 0.9})
    told = {each.what for each in check_recording(tmp_path / "a.mcap", profile=slower).differences}
    assert "vibration" in told


def test_the_picture_of_a_mouse_has_its_few_pulses_in_full(program_here, tmp_path):
    # Twenty frames a second: ten pulses open the level, and the others are in full.
    felt = "--felt felt.png --finger paper"
    program_here(f"{FAST.replace('grating:4mm', 'text:I')} --rate 20 {felt}").fine()
    picture = np.asarray(Image.open(tmp_path / "felt.png").convert("L"))
    touched = picture[picture.shape[0] // 2 + 40 :]
    assert np.percentile(touched, 0.5) < 60


def test_a_run_sends_markers(program_here, monkeypatch):
    lsl = FakeLsl()
    monkeypatch.setitem(sys.modules, "pylsl", lsl)
    program_here(f"{FAST} --seconds 1 --stream lsl:").fine()
    pulses, frames, events = (
        [sample for _, sample in lsl.pushed[f"smarttouch-{name}"]]
        for name in ("pulses", "frames", "events")
    )
    assert len(pulses) == len(frames) == 100
    assert sum(sample[1] for sample in pulses) > 100
    assert ["intensity 1.00"] in events
    # What ended it, and last of all what was delivered.
    assert any("1 s" in each for (each,) in events)
    assert events[-1][0].startswith("dose ")
