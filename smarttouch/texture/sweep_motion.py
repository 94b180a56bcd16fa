"""A virtual hand that strokes back and forth."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from smarttouch.errors import SourceError, require_within
from smarttouch.texture.motion import Motion

USUAL_MM_S = 40.0
SLOWEST_MM_S, FASTEST_MM_S = 0.1, 1000.0
START_S = 0.75
"""Time of rest before the first stroke: the hand is there before it moves."""
REST_S = 0.3
"""Time of rest between two strokes."""
USUAL_ROUNDS = 1
_MOST_ROUNDS = 10_000
_MOST_STROKES = 100_000
_TREMOR_HZ = (8.3, 9.7, 11.6)
"""Physiological tremor of hands lies between 8 and 12 Hz (Elble and Randall, 1976)."""
_TREMOR_MM = 0.05
"""Root mean square along each axis; an estimate of ours for a hand that lies on a mouse."""


def open_sweep(
    rest: str,
    *,
    speed_mm_s: float = USUAL_MM_S,
    span_mm: tuple[float, float] = (60.0, 0.0),
    lane_mm: float = 16.0,
    origin_mm: tuple[float, float] | None = None,
    seed: int | None = None,
) -> "SweepMotion":
    """Open ``sweep:`` or ``sweep:ROUNDS``; options are those of `SweepMotion`, and its origin."""
    if rest and not (rest.isdecimal() and 0 < int(rest) <= _MOST_ROUNDS):
        raise SourceError(
            f"sweep:{rest} is no number of rounds: give 1 to {_MOST_ROUNDS}, as in sweep:3",
            about="rounds",
        )
    motion = SweepMotion(speed_mm_s, span_mm, lane_mm, int(rest or USUAL_ROUNDS), seed)
    motion.origin_mm = origin_mm
    return motion


def strokes_over(size_mm: tuple[float, float], array_mm: tuple[float, float]) -> dict[str, Any]:
    """Return options of strokes that take every electrode over a texture, width by height."""
    (width, height), (across, down) = size_mm, array_mm
    return {
        "span_mm": (width + across, height),
        "lane_mm": down,
        "origin_mm": (-across / 2, min(down, height) / 2),
    }


class SweepMotion(Motion):
    """Strokes over an area, lane by lane, and back the same way; rests between strokes."""

    def __init__(
        self,
        speed_mm_s: float = USUAL_MM_S,  # of every stroke
        span_mm: tuple[float, float] = (60.0, 0.0),  # width and height of the area
        lane_mm: float = 16.0,  # largest distance of lanes
        rounds: int = USUAL_ROUNDS,  # number of rounds, forth and back
        seed: int | None = None,  # of tremor; none if not given
    ) -> None:
        require_within(SourceError, "speed_mm_s", speed_mm_s, SLOWEST_MM_S, FASTEST_MM_S)
        super().__init__(f"a virtual hand at {speed_mm_s:g} mm/s")
        points = _round_trip(span_mm, lane_mm)
        if rounds * len(points) > _MOST_STROKES:
            raise SourceError(
                f"{rounds} rounds of {len(points) // 2} lanes are more strokes than "
                f"{_MOST_STROKES}: ask for fewer",
                about="strokes",
            )
        self._table = _timed(np.vstack([points[:1], *[points[1:]] * rounds]), speed_mm_s)
        self.duration_s = float(self._table[-1, 0])
        self._phases: NDArray[np.float64] | None = None
        if seed is not None:
            random = np.random.default_rng(seed)
            self._phases = random.uniform(0, 2 * math.pi, (2, len(_TREMOR_HZ)))

    def read(self, time_ns: int) -> tuple[float, float] | None:
        """Return the position of the hand at a time; None after the last rest."""
        time_s = time_ns / 1e9
        if time_s > self._table[-1, 0]:
            return None
        x, y = (float(np.interp(time_s, self._table[:, 0], each)) for each in self._table.T[1:])
        if self._phases is not None:
            x, y = x + self._tremor(time_s, 0), y + self._tremor(time_s, 1)
        return x, y

    def _tremor(self, time_s: float, axis: int) -> float:
        assert self._phases is not None
        turns = 2 * math.pi * time_s * np.array(_TREMOR_HZ)
        swing = np.sin(turns + self._phases[axis]) - np.sin(self._phases[axis])
        return _TREMOR_MM * math.sqrt(2 / len(_TREMOR_HZ)) * float(swing.sum())


def _round_trip(span_mm: tuple[float, float], lane_mm: float) -> NDArray[np.float64]:
    """Return the corners of the path through all lanes and back, (N, 2) mm."""
    width_mm, height_mm = span_mm
    lanes = max(1, math.ceil(height_mm / lane_mm - 0.15)) if height_mm > lane_mm else 1
    forth = [
        (x, y)
        for lane, y in enumerate(np.linspace(0, max(0.0, height_mm - lane_mm), lanes))
        for x in ((0.0, width_mm) if lane % 2 == 0 else (width_mm, 0.0))
    ]
    return np.array(forth + forth[-2::-1])


def _timed(points: NDArray[np.float64], speed_mm_s: float) -> NDArray[np.float64]:
    """Return the times of arrival at and departure from each point, (2 N, 3): s, mm, mm."""
    strokes_s = np.hypot(*np.diff(points, axis=0).T) / speed_mm_s
    comes = np.concatenate([[0.0], START_S + np.cumsum(strokes_s + REST_S) - REST_S])
    leaves = comes + REST_S
    leaves[0] = START_S
    times = np.column_stack([comes, leaves]).ravel()
    return np.column_stack([times, np.repeat(points, 2, axis=0)])
