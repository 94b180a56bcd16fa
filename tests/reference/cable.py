"""The linear cable equation in time: a fiber below threshold (Eq. 1, Appendix A)."""

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.fft import dct, idct


def cable_response(
    activating: ArrayLike,
    spacing_mm: float,
    length_constant_mm: float,
    time_constant_us: float,
    waveform: ArrayLike,
    step_us: float,
    initial_mv: ArrayLike | None = None,
) -> NDArray[np.float64]:
    """Return the membrane potential after each step (T, N), mV relative to rest.

    Solves Eq. 1 of the paper, −(λ²/τ) V″ + dV/dt + V/τ = (λ²/τ) AF(r) s(t), at points
    ``spacing_mm`` apart, for an activating function (N,) in mV/mm² (Eq. 2; positive
    depolarizes; per mA cathodic where the waveform (T,), held for one step each, is in mA).
    Sealed ends let no current through: V′ = 0 half a spacing beyond the outer points; where a
    fiber truly ends, that adds Ψ′ /
    ``spacing_mm`` at the first point and subtracts it at the last. Between points the second
    difference stands for V″; in time the answer is exact, as every mode of the cable, here the
    cosines of the discrete cosine transform, relaxes exponentially on its own.
    """
    drive = np.asarray(activating, dtype=np.float64)
    held = np.asarray(waveform, dtype=np.float64)
    start = np.zeros_like(drive) if initial_mv is None else np.asarray(initial_mv, np.float64)

    count = drive.size
    curvature = (2 * np.sin(np.pi * np.arange(count) / (2 * count)) / spacing_mm) ** 2
    # In units of 1/τ, so that the steady answer of a mode is its drive over its rate.
    rate = 1 + length_constant_mm**2 * curvature
    decay = np.exp(-rate * step_us / time_constant_us)
    gain = (1 - decay) / rate * length_constant_mm**2 * dct(drive, norm="ortho")

    modes = np.empty((held.size, count))
    mode = dct(start, norm="ortho")
    for index, value in enumerate(held):
        mode = decay * mode + gain * value
        modes[index] = mode
    return np.asarray(idct(modes, axis=1, norm="ortho"))
