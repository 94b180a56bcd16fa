"""Output of vibrator waveforms: a file, by the time of the sequences, or a sound device."""

import contextlib
import importlib
import os
import struct
import threading
import time
from abc import ABC, abstractmethod
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from smarttouch.boards.waveform import GLIDE_S, Waveform
from smarttouch.errors import BoardError, SmartTouchError
from smarttouch.files import owner_only, unwritable

FULL_SCALE = 32_767
_PIECE = 1 << 14  # samples written at once, so that a long pause does not fill the memory
_LARGEST_BYTES = 0xFFFF_0000  # largest WAV file
GRACE_NS = 50_000_000  # most delay of a sequence without a gap; a period if shorter


class Shaking(ABC):
    """Interface of waveform outputs, driven by amplitudes and times."""

    time_to_zero_ms: float = 0.0
    notes: list[str]  # list of warnings for the user

    @abstractmethod
    def open(self, waveform: Waveform, rate_hz: int) -> None:
        """Start without vibration."""

    @abstractmethod
    def shake(
        self, amplitude: NDArray[np.float32], time_ns: int, period_ns: int, times: int
    ) -> None:
        """Vibrate, (C,) in [0, 1], for a number of periods or until the next call."""

    @abstractmethod
    def silence(self) -> None:
        """Stop vibrating, from any thread."""

    @abstractmethod
    def close(self) -> None:
        """Stop vibrating and close."""

    @abstractmethod
    def drain(self, timeout_s: float) -> None:
        """Wait until all requested vibration is over, or the time is."""


class WavShaking(Shaking):
    """WAV file on the time of the sequences, silent between them; readable at any time, even if the
    program is killed."""

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
                with contextlib.suppress(OSError):
                    stream.close()

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
        header = _wav_header(self._waveform.channels, self._rate_hz, self._written)
        try:
            if count == 0:
                self._stream.write(header)
            self._stream.write(samples.tobytes())
            self._stream.flush()
            os.pwrite(self._stream.fileno(), header, 0)
        except OSError as error:
            raise self._unwritable(error) from None

    def _unwritable(self, error: OSError) -> SmartTouchError:
        return unwritable(BoardError, self._path, error)


def _wav_header(channels: int, rate_hz: int, samples: int) -> bytes:
    """Return the header of a WAV file of 16-bit samples."""
    frame = 2 * channels
    size = samples * frame
    if size > _LARGEST_BYTES:
        raise BoardError(
            "the WAV file of the vibrators is full, it holds 4 GB: lower its rate",
            about="file",
            remedy="rate",
        )
    sound = struct.pack("<HHIIHH", 1, channels, rate_hz, rate_hz * frame, frame, 16)
    whole = struct.pack("<4sI4s4sI", b"RIFF", 36 + size, b"WAVE", b"fmt ", len(sound))
    return whole + sound + struct.pack("<4sI", b"data", size)


class AudioShaking(Shaking):
    """Output to a sound device, by number or part of its name (the default one if empty); silent
    once no sequence is left."""

    time_to_zero_ms = 2 * GRACE_NS / 1e6

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
                samplerate=rate_hz,
                device=self._device,
                channels=waveform.channels,
                dtype="float32",
                latency="low",
                callback=self._fill,
            )
            self._stream.start()
        except (self._sound.PortAudioError, ValueError) as error:
            self.close()
            reason = str(error).partition("\n")[0].rstrip(".")
            raise BoardError(
                f"cannot play {waveform.channels} vibrators on the sound device "
                f"{self._device or 'of this computer'}: {reason}; see python3 -m sounddevice",
                about="sound device",
                remedy="python3 -m sounddevice",
            ) from None

    def shake(
        self, amplitude: NDArray[np.float32], time_ns: int, period_ns: int, times: int
    ) -> None:
        if not self._stream.active:
            raise BoardError(
                "the sound device of the vibrators is gone: connect it again", about="sound device"
            )
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
        return importlib.import_module("sounddevice")
    except ImportError:
        raise BoardError(
            "vibrators:audio needs sounddevice: install it with pip install 'smarttouch[audio]', "
            "or write a file with vibrators:FILE.wav",
            about="sounddevice",
            remedy="pip install 'smarttouch[audio]'",
        ) from None
    except OSError:
        raise BoardError(
            "vibrators:audio needs PortAudio: install it with apt install libportaudio2, or write "
            "a file with vibrators:FILE.wav",
            about="PortAudio",
            remedy="apt install libportaudio2",
        ) from None
