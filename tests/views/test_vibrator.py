"""Tests that a vibrator plays the vibration of each sequence, then soon falls silent."""

import sys
import types
import wave

import numpy as np
import pytest

import smarttouch as st
from smarttouch.running.step_records import Step, StepResult
from smarttouch.stimulation.scan_sequence import ScanSequence
from smarttouch.views.vibrator import FADE_S, HOLD_S, RATE_HZ

PERIOD_S = 0.02
STEEPEST = 2 * np.pi * 250 / RATE_HZ + 1 / (FADE_S * RATE_HZ)


def result(vibration, time_s=0.0, period_s=PERIOD_S, number=1):
    """Return a step with two sites. The second site vibrates, unless ``vibration`` is None."""
    none = np.zeros(0, np.uint16)
    shaken = None if vibration is None else np.array([0, vibration], np.float32)
    sequence = ScanSequence(
        np.zeros((0, 2), np.int16), none, none, none, round(1e6 * period_s), 1.0,
        round(1e9 * time_s), shaken,
    )  # fmt: skip
    return StepResult(Step(None, None, sequence, st.RunConfig(mode="color").mode), number, 0.0)


def read(path):
    with wave.open(str(path)) as file:
        assert file.getparams()[:3] == (1, 2, RATE_HZ)
        return np.frombuffer(file.readframes(file.getnframes()), "<i2") / 0x7FFF


def level(samples, start_s, end_s):
    part = samples[round(start_s * RATE_HZ) : round(end_s * RATE_HZ)]
    return np.abs(part).max(initial=0)


@pytest.fixture
def played(tmp_path):
    """Return a function that plays steps into a file and returns the samples."""

    def play(*results):
        vibrator = st.Vibrator(tmp_path / "pc.wav")
        vibrator.prepare(None)
        for each in results:
            vibrator.step(each)
        while_open = read(tmp_path / "pc.wav")
        vibrator.close()
        vibrator.close()
        samples = read(tmp_path / "pc.wav")
        # If the program is killed, its file lacks only the final fade to silence.
        assert len(samples) - len(while_open) == FADE_S * RATE_HZ
        assert np.abs(np.diff(samples, prepend=0, append=0)).max() < STEEPEST + 1e-3
        return samples

    return play


def test_it_plays_250_hz_at_the_strength_of_each_sequence(played):
    steps = [result(0.6 if 10 <= k < 60 else 0.3, k * PERIOD_S) for k in range(70)]
    samples = played(*steps)
    assert len(samples) == (1.4 + FADE_S) * RATE_HZ
    lasting = samples[round(0.21 * RATE_HZ) : round(1.19 * RATE_HZ)]
    hz = np.fft.rfftfreq(len(lasting), 1 / RATE_HZ)
    assert hz[np.abs(np.fft.rfft(lasting)).argmax()] == pytest.approx(250, abs=1)
    assert level(samples, 0.21, 1.19) == pytest.approx(0.6, abs=0.01)
    assert level(samples, 1.21, 1.39) == pytest.approx(0.3, abs=0.01)


@pytest.mark.parametrize(("last", "ends_s"), [
    (result(None, 0.02), 0.02), (result(0.0, 0.02), 0.02),
    (result(1.0, 0.02, number=None), 0.02), (result(1.0, 0.02, period_s=1.0), 0.02 + HOLD_S),
], ids=["RA alone", "pause", "lost", "long"])  # fmt: skip
def test_it_is_silent_within_100_ms_of_the_last_vibration(played, last, ends_s):
    samples = played(result(1.0), last, result(None, 0.5))
    assert level(samples, 0.01, ends_s) > 0.9
    assert ends_s + FADE_S < 0.02 + 0.1
    assert level(samples, ends_s + FADE_S + 1e-4, 1) == 0


class FakeSound(types.ModuleType):
    """Fake of the library sounddevice; the test requests samples by `play`."""

    def __init__(self):
        super().__init__("sounddevice")
        self.active = True

    # This method replaces the class of the same name in sounddevice.
    def OutputStream(self, rate_hz, callback, **options):  # noqa: N802
        assert (rate_hz, options["channels"]) == (RATE_HZ, 1)
        self._fill = callback
        return self

    def start(self): ...

    def close(self):
        self.active = False

    def play(self, seconds):
        out = np.full((round(seconds * RATE_HZ), 1), np.nan, np.float32)
        self._fill(out, len(out), None, None)
        return out[:, 0]


def test_a_sound_card_plays_until_80_ms_after_the_last_step(monkeypatch):
    sound, now_s = FakeSound(), 5.0
    monkeypatch.setitem(sys.modules, "sounddevice", sound)
    monkeypatch.setattr("time.monotonic", lambda: now_s)
    vibrator = st.Vibrator("sound:")
    vibrator.prepare(None)
    assert not sound.play(0.01).any()
    vibrator.step(result(0.5))
    now_s += 0.079
    assert np.abs(sound.play(0.01)).max() == pytest.approx(0.5, abs=0.01)
    now_s += 0.002
    assert not sound.play(0.01)[round(FADE_S * RATE_HZ) :].any()
    sound.active = False
    with pytest.raises(st.SmartTouchError, match="gone"):
        vibrator.step(result(0.5))
    vibrator.close()


def test_what_is_missing_for_sound_is_one_sentence(monkeypatch):
    monkeypatch.setitem(sys.modules, "sounddevice", None)
    with pytest.raises(st.SmartTouchError, match="pip install sounddevice"):
        st.Vibrator("sound:").prepare(None)
