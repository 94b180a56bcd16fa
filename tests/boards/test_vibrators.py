"""Drive of vibrators, in a file or on a simulated sound device."""

import contextlib
import errno
import os
import sys
import threading
import types
import wave
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from smarttouch.base.errors import BoardError, BoardStoppedError
from smarttouch.boards.vibrators.vibrator_board import VibratorBoard, make_vibrators
from smarttouch.boards.vibrators.vibrator_output import GLIDE_S, Waveform, vibrator_of
from smarttouch.profile import load_profile
from smarttouch.stimulation.safety_gate import SafetyLimits
from smarttouch.stimulation.scan_sequence import ScanSequence

from ..raising import raises
from . import test_contract
from .fresh import deliver

pytestmark = pytest.mark.usefixtures("patient_boards")

MS = 1_000_000
SECOND = 1000 * MS
PERIOD_US = 20_000


def shaken(amplitude, time_ns=0, period_us=PERIOD_US, intensity=1.0):
    """Return a sequence without slots that lets all sites, or each, vibrate."""
    none = np.zeros(0, np.uint16)
    vibration = np.broadcast_to(np.float32(amplitude), 64).copy()
    current = np.zeros((0, 64), np.int16)
    return ScanSequence(
        current, none, none, none, period_us, intensity, SECOND + time_ns, vibration
    )


@contextlib.contextmanager
def opened(board):
    """Open a board and let a second of silence pass: what comes may be as strong as it likes."""
    with board:
        board.send(shaken(0.0, -SECOND, intensity=0.0))
        yield board


def read(path):
    """Return the samples of a WAV file, (n, C) in [−1, 1], and how many are in a second."""
    with wave.open(str(path)) as file:
        assert file.getsampwidth() == 2
        data = np.frombuffer(file.readframes(file.getnframes()), "<i2")
        return data.reshape(-1, file.getnchannels()) / 32767, file.getframerate()


@pytest.fixture
def make(tmp_path, profile):
    def make(query="", electrodes=profile.electrodes):
        limits = SafetyLimits.of(profile)
        return VibratorBoard(f"{tmp_path / 'out.wav'}{query}", limits, electrodes=electrodes)

    return make


@pytest.fixture
def wav(tmp_path):
    """Return a reader of what was written after the second of silence."""

    def after_silence():
        samples, rate_hz = read(tmp_path / "out.wav")
        assert not samples[:rate_hz].any()
        return samples[rate_hz:], rate_hz

    return after_silence


class TestTheFile:
    def test_a_level_is_250_hz_at_that_level_and_silence_around_it(self, make, wav):
        with opened(make()) as board:
            for index in range(150):
                level = 0.6 if 50 <= index < 100 else 0.0
                board.send(shaken(level, index * PERIOD_US * 1000))
        samples, rate_hz = wav()
        assert samples.shape == (3 * rate_hz, 4)
        before, during, after = np.split(samples, 3)
        glide = round(GLIDE_S * rate_hz)
        assert not before.any()
        assert not after[glide + 1 :].any()
        level = during[glide:]
        spectrum = np.abs(np.fft.rfft(level * np.hanning(len(level))[:, None], axis=0))
        hz = np.fft.rfftfreq(len(level), 1 / rate_hz)
        assert hz[spectrum.argmax(axis=0)] == pytest.approx(250, abs=1.5)
        near = np.abs(hz - 250) < 10
        assert (spectrum[~near].max(axis=0) < 1e-3 * spectrum.max(axis=0)).all()
        # Of a sinusoid that is sampled evenly over whole cycles.
        assert np.sqrt(2 * (level[: 32 * 240] ** 2).mean(axis=0)) == pytest.approx(0.6, rel=0.01)
        assert np.abs(level).max(axis=0) == pytest.approx(0.6, rel=0.01)

    def test_a_vibrator_shakes_as_the_strongest_of_its_sites(self, make, wav, profile):
        vibration = np.zeros(64, np.float32)
        vibration[[0, 9]] = 0.25, 0.5
        vibration[63] = 1.0
        with opened(make()) as board:
            board.send(shaken(vibration, period_us=100_000))
        samples, rate_hz = wav()
        peaks = np.abs(samples[round(GLIDE_S * rate_hz) : 800]).max(axis=0)
        assert peaks == pytest.approx([0.5, 0, 0, 1], rel=0.01)

    def test_without_the_places_of_sites_all_shake_alike(self, make, wav):
        vibration = np.zeros(64, np.float32)
        vibration[5] = 0.5
        with opened(make("?grid=1x3", electrodes=None)) as board:
            board.send(shaken(vibration, period_us=100_000))
        samples, _ = wav()
        assert np.abs(samples[100:800]).max(axis=0) == pytest.approx([0.5] * 3, rel=0.01)

    def test_its_time_is_that_of_the_sequences(self, make, wav):
        with opened(make("?grid=1x1&rate=10000")) as board:
            board.send(shaken(1.0))
            board.send(shaken(1.0, 500 * MS))
        samples, rate_hz = wav()
        loud = np.flatnonzero(np.abs(samples[:, 0]) > 0.5)
        assert rate_hz == 10_000
        assert loud.min() < 50
        assert not ((loud > 250) & (loud < 5000)).any()
        assert 5000 < loud[loud > 250].min() < 5050
        assert len(samples) == 5000 + 200 + round(GLIDE_S * rate_hz) + 1

    def test_a_stop_ends_it_within_a_period(self, make, wav):
        with opened(make("?grid=1x1")) as board:
            board.send(shaken(1.0), times=50)
            thread = threading.Thread(target=board.stop)
            thread.start()
            thread.join(5)
            with raises(BoardStoppedError):
                board.send(shaken(1.0, 500 * MS))
        samples, rate_hz = wav()
        assert len(samples) / rate_hz <= 0.02 + GLIDE_S + 0.001
        assert samples[-1] == 0

    def test_it_can_be_read_while_it_is_written(self, make, wav):
        with opened(make()) as board:
            for index in range(10):
                board.send(shaken(0.5, index * PERIOD_US * 1000))
                # All but the newest sequence, which may yet be cut short.
                assert len(wav()[0]) == index * 160

    def test_a_full_disk_is_named(self, make, monkeypatch):
        def refuse(*_):
            raise OSError(28, "No space left on device")

        with opened(make()) as board:
            board.send(shaken(0.5))
            with monkeypatch.context() as patch:
                patch.setattr("wave.Wave_write.writeframes", refuse)
                with raises(BoardError) as error:
                    board.send(shaken(0.5, 20 * MS))
                assert os.strerror(errno.ENOSPC) in str(error.value)

    def test_a_file_that_cannot_be_written_is_named(self, profile):
        board = VibratorBoard("/nowhere/out.wav", SafetyLimits.of(profile))
        path = Path("/nowhere/out.wav")
        with raises(BoardError, value=path):
            board.open()

    @pytest.mark.parametrize(("rest", "about", "value", "allowed"), [
        ("", "board", "", (".wav", "audio")),
        ("out.mp3", "board", "out.mp3", (".wav", "audio")),
        ("out.wav?volume=3", "?volume", "volume", ("grid", "hz", "rate")),
        ("out.wav?grid", "?grid", "grid", None),
        ("out.wav?grid=2", "?grid", "2", None),
        ("out.wav?grid=0x3", "?grid", "0x3", None),
        ("out.wav?grid=9x9", "grid", None, 64),
        ("out.wav?hz=30", "hz", "30", (60, 800)),
        ("out.wav?rate=fast", "?rate", "fast", None),
        ("out.wav?rate=500", "rate", 500, (1000, 192_000)),
        ("out.wav?hz=800&rate=3000", "rate", 3000, 3200),
    ])  # fmt: skip
    def test_errors_of_a_url_are_reported(self, profile, rest, about, value, allowed):
        with raises(BoardError, value=value, allowed=allowed):
            VibratorBoard(rest, SafetyLimits.of(profile))


class TestTheWaveform:
    @given(
        st.lists(
            st.tuples(
                st.integers(0, 90), st.lists(st.floats(0, 1, width=32), min_size=2, max_size=2)
            ),
            max_size=12,
        )
    )
    def test_pieces_join_without_a_step(self, parts):
        waveform = Waveform(2, 250.0, 8000)
        pieces = []
        for count, amplitude in parts:
            waveform.glide_to(np.array(amplitude, np.float32))
            pieces.append(waveform.render(count))
        samples = np.concatenate([np.zeros((1, 2)), *pieces])
        assert (np.abs(samples) <= 1 + 1e-6).all()
        steepest = 2 * np.pi * 250 / 8000 + np.pi / 2 / (GLIDE_S * 8000)
        assert (np.abs(np.diff(samples, axis=0)) <= steepest).all()

    def test_the_phase_runs_on_whatever_the_pieces_are(self):
        whole, pieced = Waveform(1, 237.0, 8000), Waveform(1, 237.0, 8000)
        for each in (whole, pieced):
            each.glide_to(np.ones(1, np.float32))
        pieces = [pieced.render(count) for count in (1, 499, 0, 3000, 500)]
        np.testing.assert_allclose(np.concatenate(pieces), whole.render(4000), atol=1e-5)

    def test_it_is_at_rest_after_the_glide(self):
        waveform = Waveform(1, 250.0, 8000)
        assert waveform.at_rest
        waveform.glide_to(np.ones(1, np.float32))
        waveform.render(100)
        waveform.glide_to(np.zeros(1, np.float32))
        assert not waveform.at_rest
        waveform.render(round(GLIDE_S * 8000))
        assert waveform.at_rest
        assert not waveform.render(100).any()

    @pytest.mark.parametrize("name", ["electric-mouse", "kajimoto-61", "line-8"])
    def test_each_site_belongs_to_the_nearest_vibrator(self, name):
        electrodes = load_profile(name).electrodes
        nearest = vibrator_of(electrodes, 2, 2)
        x, y = electrodes.position_mm.T
        off_axis = (np.abs(x) > 1e-9) & (np.abs(y) > 1e-9)
        np.testing.assert_array_equal(nearest[off_axis], (2 * (y > 0) + (x > 0))[off_axis])


class FakeSound(types.ModuleType):
    """A sound device that plays nothing by itself: it is asked for samples."""

    class PortAudioError(Exception):
        pass

    def __init__(self, refuse=None):
        super().__init__("sounddevice")
        self.opened, self.refuse = [], refuse

    # Named as sounddevice names it.
    def OutputStream(self, **options):  # noqa: N802
        if self.refuse is not None:
            raise self.refuse
        stream = types.SimpleNamespace(
            active=True, latency=0.0, start=lambda: None, close=lambda: None, stop=lambda: None
        )
        self.opened.append(options)
        self.stream = stream
        return stream

    def play(self, frames, status=None):
        options = self.opened[-1]
        out = np.full((frames, options["channels"]), np.nan, np.float32)
        options["callback"](out, frames, None, status)
        return out


class TestTheSoundDevice:
    @pytest.fixture
    def sound(self, monkeypatch):
        sound = FakeSound()
        monkeypatch.setitem(sys.modules, "sounddevice", sound)
        return sound

    @pytest.fixture
    def board(self, sound, profile):
        return lambda rest: make_vibrators(
            f"vibrators:{rest}", SafetyLimits.of(profile), profile.electrodes
        )

    def test_what_is_asked_for_is_played_and_ends_by_itself(self, sound, board):
        with opened(board("audio")) as vibrators:
            assert not sound.play(480).any()
            vibrators.send(shaken(0.5))
            playing = sound.play(960 + 960)
            assert np.abs(playing[192:]).max(axis=0) == pytest.approx([0.5] * 4, rel=0.01)
            # A period of grace, and the glide.
            ending = sound.play(400)
            assert np.abs(ending[:20]).max() > 0
            assert not ending[193:].any()
        options = sound.opened[0]
        assert (options["samplerate"], options["channels"]) == (48_000, 4)
        assert options["device"] is None

    def test_the_next_sequence_goes_on_without_a_dip(self, sound, board):
        played = []
        with opened(board("audio:3?grid=1x2&rate=44100")) as vibrators:
            for index in range(20):
                vibrators.send(shaken(0.8, index * PERIOD_US * 1000))
                played.append(sound.play(882))
        samples = np.concatenate(played)[176:, 0]
        cycles = samples[: len(samples) // 147 * 147].reshape(-1, 147)
        assert (np.abs(cycles).max(axis=1) > 0.79).all()
        assert sound.opened[0]["device"] == 3

    def test_a_stop_while_a_piece_is_made_is_not_lost(self, sound, board):
        """Whatever the sound device's thread does at that moment."""
        with opened(board("audio")) as vibrators:
            vibrators.send(shaken(1.0), times=1000)
            sound.play(1000)

            class Left(int):
                def __sub__(self, shaken):
                    vibrators.silence()
                    return int(self) - shaken

            vibrators._shaking._left = Left(vibrators._shaking._left)
            sound.play(480)
            sound.play(480)
            assert not sound.play(480).any()

    def test_a_stop_ends_it_with_the_next_piece(self, sound, board):
        with opened(board("audio:USB Sound")) as vibrators:
            vibrators.send(shaken(1.0), times=1000)
            sound.play(1000)
            vibrators.stop()
            assert not sound.play(400)[193:].any()
        assert sound.opened[0]["device"] == "USB Sound"

    def test_a_device_that_is_gone_ends_the_run(self, sound, board):
        with opened(board("audio")) as vibrators:
            vibrators.send(shaken(0.0))
            sound.stream.active = False
            with raises(BoardError, names="sound device"):
                vibrators.send(shaken(0.0, 20 * MS))

    def test_falling_behind_is_noted(self, sound, board):
        with opened(board("audio")) as vibrators:
            for status in (None, "underflow", "underflow"):
                sound.play(10, status)
        (note,) = vibrators.notes
        assert "2 times" in note

    def test_a_device_that_cannot_play_so_is_named(self, sound, board):
        sound.refuse = FakeSound.PortAudioError("Invalid number of channels")
        with raises(BoardError, names="sound device", value=1) as error:
            board("audio:1").open()
        assert "4 vibrators" in str(error.value)
        assert str(sound.refuse) in str(error.value)

    @pytest.mark.parametrize(("missing", "about", "remedy"), [
        (ImportError(), "extra", "pip install 'smarttouch[audio]'"),
        (OSError("PortAudio"), "PortAudio", "apt install libportaudio2"),
    ])  # fmt: skip
    def test_what_is_missing_is_named(self, board, monkeypatch, missing, about, remedy):
        def refuse(name):
            raise missing

        monkeypatch.setattr("smarttouch.base.lazy_names.import_module", refuse)
        with raises(BoardError, names=about) as error:
            board("audio")
        assert remedy in str(error.value)


class TestContract(test_contract.Contract):
    """As every board, but that nothing flows: what it keeps is how it shook."""

    kinds = ("vibration",)

    @pytest.fixture
    def make_board(self, limits, tmp_path):
        def make():
            return VibratorBoard(f"{tmp_path / 'out.wav'}?grid=1x1", limits)

        return make

    def sequence(self, step, level_ua=None, electrodes=None, sites=range(4)):
        from dataclasses import replace

        sent = super().sequence(step, level_ua, electrodes, sites)
        return replace(sent, vibration=np.full(sent.electrodes, 0.125 * (step > 0), np.float32))

    def assert_silent(self):
        assert not read(self.folder / "out.wav")[0][-1].any()

    def test_what_the_device_is_sent_is_what_was_proved(self):
        """It is sent no pulses."""

    def test_what_is_sent_is_delivered(self, make_board):
        with make_board() as board:
            deliver(board, *map(self.sequence, range(5)))
            report = board.report()
            assert (board.acknowledged, board.refused, board.replaced) == (5, 0, 0)
        assert (report.sequences, report.slots, report.max_current_ma) == (5, 0, 0)
        samples, rate_hz = read(self.folder / "out.wav")
        loud = np.abs(samples[:, 0]) > 0.0625
        # Each in its own second, for its own period.
        for step in range(5):
            second = loud[step * rate_hz : (step + 1) * rate_hz]
            assert second[: rate_hz // 100].any() == (step > 0)
            assert not second[rate_hz // 50 :].any()

    def test_a_sequence_is_repeated(self, make_board):
        with make_board() as board:
            board.send(self.sequence(1 - 1))
            board.send(self.sequence(1), times=5)
            board.send(self.sequence(2))
        samples, rate_hz = read(self.folder / "out.wav")
        loud = np.flatnonzero(np.abs(samples[rate_hz : 2 * rate_hz, 0]) > 0.0625)
        assert loud.max() / rate_hz == pytest.approx(0.05, abs=0.004)

    def test_a_newer_sequence_ends_a_repetition(self, make_board):
        with make_board() as board:
            board.send(self.sequence(0))
            board.send(self.sequence(1), times=1000)
            board.send(self.sequence(2))
        samples, rate_hz = read(self.folder / "out.wav")
        assert len(samples) == pytest.approx(2.014 * rate_hz, abs=2)


def test_without_vibration_it_is_still(make, wav):
    from dataclasses import replace

    with opened(make()) as board:
        board.send(replace(shaken(1.0), vibration=None))
    assert not wav()[0].any()
