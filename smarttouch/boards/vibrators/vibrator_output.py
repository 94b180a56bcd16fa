"""Waveforms of vibrators, and their output: a file or a sound device."""

import contextlib
import threading
import time
import wave
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.electrodes import ElectrodeArray
from smarttouch.base.errors import BoardError, SmartTouchError
from smarttouch.base.files import owner_only, unwritable
from smarttouch.base.lazy_names import import_extra

PC_HZ = 250.0  # most sensitive frequency of the Pacinian corpuscle (paper, Section I and V)
GLIDE_S = 0.004
"""Time from one amplitude to the next, however different: one cycle at 250 Hz.
An estimate of ours: short against what a finger resolves in time, long enough to make no click."""


class Waveform:
    """Sinusoids of one frequency and phase, each with its own amplitude, sampled piece by piece:
    the phase runs on, and an amplitude glides to a new one in `GLIDE_S`."""

    def __init__(self, channels: int, carrier_hz: float, rate_hz: int) -> None:
        self._step = carrier_hz / rate_hz
        self._turns = 0.0
        self._glide_samples = max(1, round(GLIDE_S * rate_hz))
        self._from = np.zeros(channels, np.float32)
        self._to = np.zeros(channels, np.float32)
        self._glided = self._glide_samples

    @property
    def channels(self) -> int:
        return len(self._to)

    @property
    def at_rest(self) -> bool:
        """True if all further samples are zero, unless an amplitude is set."""
        return self._glided >= self._glide_samples and not self._to.any()

    def glide_to(self, amplitude: NDArray[np.float32]) -> None:
        """Change the amplitudes, (C,) in [0, 1], gradually from the next sample on."""
        if not np.array_equal(amplitude, self._to):
            self._from, self._to = self._amplitude(self._glided), amplitude.copy()
            self._glided = 0

    def render(self, count: int) -> NDArray[np.float32]:
        """Return the next samples, (count, C) in [−1, 1]."""
        turns = self._turns + self._step * np.arange(count)
        # Whole turns are dropped: a long run must not lose the fraction in rounding.
        self._turns = (self._turns + self._step * count) % 1.0
        carrier = np.sin(2 * np.pi * turns).astype(np.float32)
        amplitude = self._amplitude(self._glided + np.arange(count)[:, None])
        self._glided = min(self._glided + count, self._glide_samples)
        return np.asarray(carrier[:, None] * amplitude, np.float32)

    def _amplitude(self, glided: int | NDArray[np.intp]) -> NDArray[np.float32]:
        """Return the amplitudes a number of samples after they were set."""
        part = np.minimum(np.asarray(glided) / self._glide_samples, 1)
        share = ((1 - np.cos(np.pi * part)) / 2).astype(np.float32)
        return np.asarray(self._from + share * (self._to - self._from), np.float32)


def vibrator_of(electrodes: ElectrodeArray, rows: int, columns: int) -> NDArray[np.intp]:
    """Return the vibrator of each site, (E,): the nearest of ``rows`` by ``columns`` vibrators,
    each in the middle of an equal part of the array, row by row from the top left. A sparse grid is
    enough, as PC are few and answer far around them (paper, Section V)."""
    width_mm, height_mm = electrodes.extent_mm
    x_mm = ((np.arange(columns) + 0.5) / columns - 0.5) * width_mm
    y_mm = ((np.arange(rows) + 0.5) / rows - 0.5) * height_mm
    place_mm = np.stack(np.meshgrid(x_mm, y_mm), axis=-1).reshape(-1, 2)
    away_mm = electrodes.position_mm[:, None] - place_mm
    return np.asarray(np.hypot(away_mm[..., 0], away_mm[..., 1]).argmin(axis=1))


FULL_SCALE = 32_767
_PIECE = 1 << 14  # samples written at once, so that a long pause does not fill the memory
_LARGEST_BYTES = 0xFFFF_0000  # largest WAV file
GRACE_NS = 50_000_000  # most delay of a sequence without a gap; a period if shorter


class WavOutput:
    """WAV file on the time of the sequences, silent between them; readable at any time, even if the
    program is killed.

    `open` starts it without vibration, `shake` vibrates, (C,) in [0, 1], for a number of periods or
    until the next call, `silence` stops from any thread, `drain` waits for the end of what was
    asked for. A `SoundOutput` has the same methods.
    """

    time_to_zero_ms: float = 0.0
    notes: list[str]  # warnings for the user

    def __init__(self, path: str) -> None:
        self._path = Path(path)
        # Reentrant: a signal handler may stop while its own thread is writing.
        self._lock = threading.RLock()
        self._stream: BinaryIO | None = None

    def open(self, waveform: Waveform, rate_hz: int) -> None:
        try:
            self._stream = open(self._path, "wb", opener=owner_only)  # noqa: SIM115, until closing
        except OSError as error:
            raise self._unwritable(error) from None
        self._file = wave.open(self._stream, "wb")  # noqa: SIM115, until closing
        self._file.setparams((waveform.channels, 2, rate_hz, 0, "NONE", ""))
        self._waveform, self._rate_hz = waveform, rate_hz
        self._begin_ns: int | None = None
        self._written = self._once = self._end = 0
        self._write(0)

    def shake(
        self, amplitude: NDArray[np.float32], time_ns: int, period_ns: int, times: int
    ) -> None:
        with self._lock:
            if self._begin_ns is None:
                self._begin_ns = time_ns
            start = max(self._written, self._sample(time_ns))
            self._write_until(min(self._end, start))
            if start > self._written:
                self._waveform.glide_to(np.zeros_like(amplitude))
                self._write_until(start)
            self._waveform.glide_to(amplitude)
            # Written once its duration is known.
            self._once = self._sample(time_ns + period_ns)
            self._end = self._sample(time_ns + times * period_ns)

    def silence(self) -> None:
        with self._lock:
            if self._stream is None:
                return
            # A stopped repetition was sent at least once.
            self._write_until(min(self._end, self._once))
            self._end = self._written
            if not self._waveform.at_rest:
                self._waveform.glide_to(np.zeros(self._waveform.channels, np.float32))
                self._write_until(self._written + round(GLIDE_S * self._rate_hz) + 1)

    def close(self) -> None:
        with self._lock:
            stream, self._stream = self._stream, None
            if stream is not None:
                for each in (self._file, stream):
                    with contextlib.suppress(OSError):
                        each.close()

    def drain(self, timeout_s: float) -> None:
        """Do nothing: its time is simulated."""

    def _sample(self, time_ns: int) -> int:
        """Return the sample at a time since the first sequence."""
        return round((time_ns - (self._begin_ns or 0)) * self._rate_hz / 1_000_000_000)

    def _write_until(self, sample: int) -> None:
        while self._written < sample:
            self._write(min(_PIECE, sample - self._written))

    def _write(self, count: int) -> None:
        """Write samples, and a header that matches the file."""
        assert self._stream is not None
        samples = np.rint(FULL_SCALE * self._waveform.render(count)).astype("<i2")
        self._written += count
        if 2 * self._waveform.channels * self._written > _LARGEST_BYTES:
            raise BoardError("the WAV file of the vibrators is full, it holds 4 GB: lower its rate")
        try:
            self._file.writeframes(samples.tobytes())
            self._stream.flush()
        except OSError as error:
            raise self._unwritable(error) from None

    def _unwritable(self, error: OSError) -> SmartTouchError:
        return unwritable(BoardError, self._path, error)


class SoundOutput:
    """Output to a sound device, by number or part of its name (the default one if empty); silent
    once no sequence is left."""

    time_to_zero_ms: float = 2 * GRACE_NS / 1e6
    notes: list[str]

    def __init__(self, device: str) -> None:
        self._device: int | str | None = int(device) if device.isdecimal() else device or None
        self._sound = _import_sounddevice()
        self._lock = threading.Lock()
        self._stream: Any = None

    def open(self, waveform: Waveform, rate_hz: int) -> None:
        self._waveform, self._rate_hz = waveform, rate_hz
        self._rest = np.zeros(waveform.channels, np.float32)
        self._left = self._late = 0
        self._silenced, self._over_s = True, 0.0
        try:
            self._stream = self._sound.OutputStream(
                samplerate=rate_hz, device=self._device, channels=waveform.channels,
                dtype="float32", latency="low", callback=self._fill,
            )  # fmt: skip
            self._stream.start()
        except (self._sound.PortAudioError, ValueError) as error:
            self.close()
            reason = str(error).partition("\n")[0].rstrip(".")
            raise BoardError(
                f"cannot play {waveform.channels} vibrators on the sound device "
                f"{self._device or 'of this computer'}: {reason}; see python3 -m sounddevice"
            ) from None

    def shake(
        self, amplitude: NDArray[np.float32], time_ns: int, period_ns: int, times: int
    ) -> None:
        if not self._stream.active:
            raise BoardError("the sound device of the vibrators is gone: connect it again")
        over_ns = times * period_ns
        with self._lock:
            self._silenced = False
            self._waveform.glide_to(amplitude)
            self._left = round((over_ns + min(period_ns, GRACE_NS)) * self._rate_hz / 1e9)
            self._over_s = time.monotonic() + over_ns / 1e9

    def silence(self) -> None:
        # Without the lock, which a signal's own thread may hold, and without `_left`, which the
        # sound device's thread may be about to write.
        self._silenced, self._over_s = True, 0.0

    def drain(self, timeout_s: float) -> None:
        time.sleep(min(timeout_s, max(0.0, self._over_s - time.monotonic())))

    def close(self) -> None:
        stream, self._stream = self._stream, None
        if stream is None:
            return
        self.silence()
        with contextlib.suppress(self._sound.PortAudioError):
            # Wait until the end of the glide has been played.
            time.sleep(min(0.5, float(stream.latency) + 2 * GLIDE_S))
            stream.stop()
            stream.close()
        if self._late:
            self.notes.append(f"the sound device of the vibrators fell behind {self._late} times")

    def _fill(self, out: NDArray[np.float32], frames: int, _time: Any, status: Any) -> None:
        """Render the samples for the sound device, on its own thread."""
        with self._lock:
            self._late += bool(status)
            shaken = 0 if self._silenced else min(frames, self._left)
            out[:shaken] = self._waveform.render(shaken)
            if shaken < frames:
                self._waveform.glide_to(self._rest)
                out[shaken:] = self._waveform.render(frames - shaken)
            self._left = max(0, self._left - shaken)


def _import_sounddevice() -> Any:
    try:
        return import_extra(
            "sounddevice", "vibrators:audio, as vibrators:FILE.wav does not,", "audio", BoardError
        )
    except OSError:
        raise BoardError(
            "vibrators:audio needs PortAudio: install it with apt install libportaudio2, or write "
            "a file with vibrators:FILE.wav"
        ) from None
