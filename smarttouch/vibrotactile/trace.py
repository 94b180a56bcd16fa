"""Trace of a surface on the skin: force and displacement over time."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from smarttouch.errors import SmartTouchError

Array = NDArray[np.float64]

SAMPLE_HZ = 4000.0
"""Lowest sampling rate: four samples a cycle at 1 kHz, above PC's band."""
HIGHEST_SAMPLE_HZ = 20_000.0
LONGEST_S = 600.0


@dataclass(frozen=True, eq=False)
class Trace:
    """Force and displacement at one place of the skin, evenly sampled from time 0."""

    displacement_um: Array  # (N,) float64, µm: into the skin, from where it is at rest
    force_n: Array  # (N,) float64, N: static and slowly changing pressure
    sample_hz: float = SAMPLE_HZ
    title: str = "a trace"

    def __post_init__(self) -> None:
        if self.displacement_um.shape != self.force_n.shape or self.displacement_um.ndim != 1:
            raise SmartTouchError(
                f"a trace of {self.displacement_um.shape} displacements and {self.force_n.shape} "
                "forces: give as many of both, in one row",
                about="samples",
            )
        if len(self.force_n) < 2:
            raise SmartTouchError(
                f"{self.title} has {len(self.force_n)} samples: give two or more", about="samples"
            )
        if not (np.isfinite(self.displacement_um).all() and np.isfinite(self.force_n).all()):
            raise SmartTouchError(
                f"{self.title} has a sample that is not a finite number: leave such samples out",
                about="samples",
            )
        if self.duration_s > LONGEST_S:
            raise _too_long(self.title, self.duration_s)

    @property
    def duration_s(self) -> float:
        return len(self.force_n) / self.sample_hz

    @property
    def time_s(self) -> Array:
        """Time of each sample, (N,) s."""
        return np.asarray(np.arange(len(self.force_n)) / self.sample_hz)


def sampled(
    time_s: ArrayLike,  # (N,) s: rising; the first becomes 0
    displacement_um: ArrayLike | None = None,  # (N,) µm: into the skin; 0 if not given
    force_n: ArrayLike | None = None,  # (N,) N: 0 if not given
    title: str = "a trace",
) -> Trace:
    """Return the trace of unevenly timed samples, resampled evenly.

    Between samples it runs straight. The new rate is that of most samples, but
    between `SAMPLE_HZ` and `HIGHEST_SAMPLE_HZ`.
    """
    time = np.asarray(time_s, np.float64)
    nothing = np.zeros_like(time)
    rows = [
        nothing if row is None else np.asarray(row, np.float64)
        for row in (displacement_um, force_n)
    ]
    if len(time) < 2 or any(row.shape != time.shape for row in rows):
        raise SmartTouchError(
            f"{title} has {len(time)} times for {len(rows[0])} displacements and {len(rows[1])} "
            "forces: give as many of each, two or more",
            about="samples",
        )
    steps = np.diff(time)
    if not (np.isfinite(time).all() and (steps > 0).all()):
        worst = int(np.argmin(np.where(np.isfinite(steps), steps, -math.inf)))
        raise SmartTouchError(
            f"{title}: times must rise, and sample {worst + 1} at {time[worst + 1]:g} s does not: "
            "sort them and give each once",
            about="samples",
        )
    if time[-1] - time[0] > LONGEST_S:
        raise _too_long(title, float(time[-1] - time[0]))
    sample_hz = float(np.clip(1 / np.median(steps), SAMPLE_HZ, HIGHEST_SAMPLE_HZ))
    count = max(2, round((time[-1] - time[0]) * sample_hz) + 1)
    even = time[0] + np.arange(count) / sample_hz
    displacement, force = (np.interp(even, time, row) for row in rows)
    return Trace(displacement, force, sample_hz, title)


def _too_long(title: str, seconds: float) -> SmartTouchError:
    message = f"{title} lasts {seconds:g} s: at most {LONGEST_S:g}, cut it"
    return SmartTouchError(message, about="duration_s")
