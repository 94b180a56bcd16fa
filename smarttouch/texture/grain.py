"""Grain of a texture: the pitch that dominates its spectrum."""

import cv2
import numpy as np
from numpy.typing import NDArray

_SIDE = 512
"""Pixels of the image for the spectrum."""
_FEWEST_CYCLES = 5.0
"""Fewest periods across the shorter side; with fewer it is a shape and no texture."""
_PROMINENT = 0.25
"""Share of the variance, but for that of the light, that a single one must carry to dominate: three
directions at one pitch, as of a honeycomb, have a third each. An estimate of ours."""
_LIGHT_CYCLES = 2.5
"""Cycles across the longer side below which changes are of the light."""
_COARSEST_MM = 10.0
"""Coarsest pitch of a texture; beyond, ridges are felt one by one."""
_AROUND = 2
"""Bins of a peak on each side: the main lobe of a Hann window."""


def dominant_pitch_mm(height: NDArray[np.float32], mm_per_pixel: float) -> float | None:
    """Return the pitch that dominates a relief, (H, W), mm; None if none does.

    By Welch's windowed periodogram (1967), in two dimensions: a pitch dominates if the main lobe of
    one spatial frequency, and of its mirror image, carry at least a quarter of the variance.
    """
    shrink = min(1.0, _SIDE / max(height.shape))
    if shrink < 1:
        size = [max(2, round(side * shrink)) for side in height.shape[::-1]]
        height = np.asarray(cv2.resize(height, size, interpolation=cv2.INTER_AREA), np.float32)
        mm_per_pixel /= shrink
    rows, columns = height.shape
    window = np.hanning(rows)[:, None] * np.hanning(columns)
    mean = float((height * window).sum() / max(window.sum(), 1e-12))
    power = np.fft.fftshift(np.abs(np.fft.fft2((height - mean) * window, (_SIDE, _SIDE))) ** 2)
    cycles = np.fft.fftshift(np.fft.fftfreq(_SIDE))
    by_y, by_x = np.meshgrid(cycles, cycles, indexing="ij")
    frequency = np.hypot(by_x, by_y)
    searched = np.where(frequency * min(rows, columns) >= _FEWEST_CYCLES, power, 0.0)
    row, column = divmod(int(searched.argmax()), _SIDE)
    # Padding has widened the lobe.
    lobe = np.hypot((by_x - by_x[row, column]) * columns, (by_y - by_y[row, column]) * rows)
    own = power * (lobe <= _AROUND)
    # Uneven light is not counted, however strong it is.
    total = float(power[frequency * max(rows, columns) >= _LIGHT_CYCLES].sum())
    if not total or 2 * float(own.sum()) < _PROMINENT * total:
        return None
    pitch_mm = mm_per_pixel * float(own.sum()) / float((own * frequency).sum())
    return pitch_mm if pitch_mm <= _COARSEST_MM else None
