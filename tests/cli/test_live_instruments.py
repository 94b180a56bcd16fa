"""Tests of ``smarttouch live`` with vibrations and textures, recorded and drawn."""

from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.io import wavfile

from smarttouch.base.errors import PageError, ScheduleError, SmartTouchError, SourceError
from smarttouch.running.recording_reader import RecordedRun
from smarttouch.running.replay_check import assert_replays, check_recording

from .conftest import refused, says


@pytest.fixture
def played(program_here):
    """Return a function that runs a source and returns figures, output and notes."""

    def run(spec, more=""):
        done = program_here(f"live '{spec}' --set paced=no --json f.json {more}").fine()
        return done.figures | {"printed": done.stdout, "noted": done.stderr}

    return run


def test_all_three_on_an_emulated_board(played, tmp_path):
    # At this intensity the limit of net current does not lower the rate of any class.
    spec = "tone:30Hz,9um+tone:250Hz,1.5um+press:0.45N"
    figures = played(f"vibration:{spec}?seconds=1", "--intensity 0.3 --record r.mcap")
    assert figures["ended"] == "the end of the trace"
    assert figures["emulator_violations"] == 0
    # Each of four sites has at least 28 RA pulses (at 30 Hz) and 120 PC pulses (at 125 Hz).
    assert figures["slots"] > 4 * (28 + 120)
    assert "pulses for PC stimulate another class" in figures["noted"]
    assert_replays(tmp_path / "r.mcap")


def test_without_options_a_virtual_hand_strokes_a_grating(played, tmp_path):
    figures = played("texture:", "--intensity 0.7 --felt felt.png --set finger=paper")
    # The hand moves 60 mm and back over ridges 4 mm apart: 64 electrodes cross 15 ridges twice.
    assert figures["slots"] == pytest.approx(2 * 15 * 64, abs=64)
    assert figures["emulator_violations"] == 0
    assert figures["ended"] == "the hand has stopped"
    with Image.open(tmp_path / "felt.png") as picture:
        grey = np.asarray(picture.convert("L"), float)
    # The upper panel shows the texture under the hand, the lower one the delivered current.
    under, delivered = grey[52:260, 24:924], grey[312:520, 24:924]
    assert np.corrcoef(under.ravel(), delivered.ravel())[0, 1] > 0.6


def test_a_vibrator_plays_what_was_recorded(program_here, tmp_path, changed):
    mixed = "live vibration:tone:30Hz,8um+tone:250Hz,2um?seconds=1 --set paced=no"
    program_here(f"{mixed} --set vibrators=v.wav --record a.mcap").flawless()
    rate_hz, wave = wavfile.read(tmp_path / "v.wav")
    spectrum = np.abs(np.fft.rfft(wave.astype(np.float64)))
    assert np.fft.rfftfreq(len(wave), 1 / rate_hz)[spectrum.argmax()] == pytest.approx(250, abs=2)
    recording = RecordedRun(tmp_path / "a.mcap")
    shaken = [each.step.sequence.vibration for each in recording.steps()]
    assert max(each.max() for each in shaken) > 0.8
    assert check_recording(tmp_path / "a.mcap").exact
    slower = changed(recording.profile, {"limits.ramp_s": 0.9})
    differences = check_recording(tmp_path / "a.mcap", profile=slower).differences
    assert any(": vibration" in line for line in differences)


@pytest.mark.parametrize(("arguments", "wrong"), [
    ("vibration:tone:250Hz,2um --profile kajimoto-61",
     says(ScheduleError, "PC", "kajimoto-61", " RA ")),
    ("vibration:tone:30", says(SmartTouchError, "'tone:30'", "tone:30Hz,8um")),
    ("vibration:tone:30Hz,9um --mode PC", says(SourceError)),
    ("vibration:tone:30Hz,9um --json no/f.json", says(value=Path("no/f.json"))),
    ("texture:grating:x", says(PageError, "'grating:x'", "grating:4mm,30deg")),
    ("texture:?motion=page", says(SourceError, "motion=page", "--window")),
    ("texture:?motion=evdev:/dev/null",
     says(SourceError, "/dev/null" if find_spec("evdev") else "smarttouch[mouse]")),
    ("texture: --set rate_hz=300", says(SourceError, value=300, allowed=(10, 200))),
    ("texture: --mode natural",
     says(SourceError, value="natural", allowed=("RA", "SAI", "PC"))),
])  # fmt: skip
def test_what_cannot_be_played_is_one_sentence(program_here, arguments, wrong):
    wrong(refused(program_here(f"live {arguments} --board simulated:")))
