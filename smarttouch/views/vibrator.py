"""Vibrator signal that stimulates PC afferents, as a WAV file or through a sound card."""

import time
import wave
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.errors import SmartTouchError
from smarttouch.base.files import owner_only, unwritable
from smarttouch.running.step_records import Listener, RunContext, StepResult

CARRIER_HZ = 250.0  # best frequency of the Pacinian corpuscle (paper, Sections I and V)
RATE_HZ = 48_000
HOLD_S = 0.08  # longest vibration; with fade-out and sound card delay, at most 0.1 s
FADE_S = 0.004  # time from zero to full amplitude: one cycle of the carrier, to avoid clicks
_NEEDS = "sound: needs a sound card; pip install sounddevice; on Linux apt install libportaudio2"


class Vibrator(Listener):
    """Listener that stimulates PC afferents with a vibrator, not with current (paper, Section V).

    The signal is a sinusoid of 250 Hz. Its amplitude is the largest PC activation of the sequence;
    1 is full scale. The vibration lasts until the next sequence, at most 80 ms.

    Parameters
    ----------
    target : str or Path
        A new WAV file, valid even if the run is killed, or ``"sound:"`` for the sound card.
    """

    vibrates_pc = True

    def __init__(self, target: str | Path) -> None:
        super().__init__()
        self._target = target
        self._output: _WavFile | _SoundCard | None = None
        if target != "sound:" and (Path(target).suffix != ".wav" or "vibrators:" in str(target)):
            raise SmartTouchError(
                f"{target} is no vibrator: give a WAV file such as pc.wav, or 'sound:' (sound card)"
            )

    def prepare(self, run: RunContext) -> None:
        self._output = _SoundCard() if self._target == "sound:" else _WavFile(Path(self._target))

    def step(self, result: StepResult) -> None:
        """Play the vibration of a sequence that was sent."""
        sequence = result.sequence
        if self._output is not None and result.number is not None:
            amplitude = 0.0 if sequence.vibration is None else float(sequence.vibration.max())
            self._output.play(amplitude, sequence.time_ns / 1e9, sequence.period_us / 1e6)

    def close(self) -> None:
        """Fade out, and close the file or the sound card."""
        output, self._output = self._output, None
        if output is not None:
            output.close()


class _Carrier:
    _turns = _level = 0.0

    def render(self, count: int, amplitude: float) -> NDArray[np.float64]:
        """Return the next samples, (count,) in [−1, 1], with continuous phase and amplitude."""
        time_s = np.arange(count + 1) / RATE_HZ
        levels = self._level + np.clip(amplitude - self._level, -time_s / FADE_S, time_s / FADE_S)
        turns = self._turns + CARRIER_HZ * time_s
        self._level, self._turns = float(levels[-1]), float(turns[-1] % 1)
        return np.asarray(levels * np.sin(2 * np.pi * turns))[:count]


class _WavFile(_Carrier):
    def __init__(self, path: Path) -> None:
        try:
            # Unbuffered, so that the file is valid after each write.
            self._stream = open(path, "xb", buffering=0, opener=owner_only)  # noqa: SIM115
        except OSError as error:
            raise unwritable(SmartTouchError, path, error) from None
        self._file = wave.open(self._stream, "wb")  # noqa: SIM115
        self._file.setparams((1, 2, RATE_HZ, 0, "NONE", ""))
        self._write(0.0, 0)

    def play(self, amplitude: float, start_s: float, period_s: float) -> None:
        for level, end_s in ((0.0, start_s), (amplitude, start_s + min(period_s, HOLD_S))):
            self._write(level, round(end_s * RATE_HZ) - self._file.tell())

    def close(self) -> None:
        with self._stream, self._file:
            self._write(0.0, round(FADE_S * RATE_HZ))

    def _write(self, amplitude: float, count: int) -> None:
        samples = np.rint(0x7FFF * self.render(max(0, count), amplitude)).astype("<i2")
        try:
            self._file.writeframes(samples.tobytes())
        except OSError as error:
            raise unwritable(SmartTouchError, Path(self._stream.name), error) from None


class _SoundCard(_Carrier):
    def __init__(self) -> None:
        self._asked = 0.0, 0.0  # amplitude; end time, s; in one tuple, so that both change at once
        try:
            from sounddevice import OutputStream

            self._stream = OutputStream(RATE_HZ, channels=1, latency="low", callback=self._fill)
            self._stream.start()
        except Exception as error:
            raise SmartTouchError(f"{_NEEDS} ({error})") from None

    def play(self, amplitude: float, _start_s: float, _period_s: float) -> None:
        if not self._stream.active:
            raise SmartTouchError("the vibrator's sound card is gone: connect it again")
        self._asked = amplitude, time.monotonic() + HOLD_S

    def close(self) -> None:
        self._stream.close()

    def _fill(self, samples: NDArray[np.float32], count: int, *_: object) -> None:
        amplitude, until_s = self._asked
        samples[:, 0] = self.render(count, amplitude if time.monotonic() < until_s else 0.0)
