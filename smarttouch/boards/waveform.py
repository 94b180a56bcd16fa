"""Waveform of vibrators: a carrier with an amplitude that changes without clicks."""

import numpy as np
from numpy.typing import NDArray

from smarttouch.electrodes import ElectrodeArray

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
