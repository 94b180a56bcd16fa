"""Simulated sensor patch and load cell, with known true values."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from smarttouch.calibrate.force_curve import STANDARD_GRAVITY, Weighing, weigh


@dataclass
class SimulatedCell:
    """Simulated load cell."""

    # counts_per_n, zero: scale and offset of an ideal cell
    counts_per_n: float = 4.1e5
    zero: float = 83_000.0
    bend: float = 0.0  # deficit of the reading at full force, as a part; at half, a quarter of that
    # lag of the reading on the way down, at half of the heaviest weight it has carried
    hysteresis_n: float = 0.0
    noise_n: float = 0.002  # of a single reading
    garbage: float = 0.0  # part of the readings that are far off
    missing: float = 0.0  # part of the readings that are NaN
    full_n: float = 1.0
    seed: int = 0
    rate_hz: float = 80.0
    grams: float = 0.0  # weight on it; set by `put`
    _most_n: float = field(default=0.0, init=False)

    def __post_init__(self) -> None:
        self._random = np.random.default_rng(self.seed)

    def put(self, grams: float) -> None:
        """Put a weight on it."""
        self.grams = grams
        self._most_n = max(self._most_n, self._force_n)

    @property
    def _force_n(self) -> float:
        return self.grams / 1000 * STANDARD_GRAVITY

    def collect(self, seconds: float) -> NDArray[np.float64]:
        """Return the readings of a duration, at once."""
        force_n, random = self._force_n, self._random
        count = round(seconds * self.rate_hz)
        if force_n < self._most_n:
            part = force_n / self._most_n
            force_n += 4 * part * (1 - part) * self.hysteresis_n
        seen_n = force_n * (1 - self.bend * force_n / self.full_n)
        readings = seen_n + self.noise_n * random.standard_normal(count)
        readings = self.zero + self.counts_per_n * readings
        wild = random.random(count) < self.garbage
        readings[wild] = random.uniform(-(2**23), 2**23, int(wild.sum()))
        readings[random.random(count) < self.missing] = np.nan
        return np.rint(readings)


@dataclass(frozen=True, eq=False)
class SimulatedPatch:
    """Simulated sensor patch: uneven light, pixels of varied gain and dark level, some
    broken.
    """

    shape: tuple[int, int] = (64, 64)
    shade: float = 0.3
    own_gain: float = 0.05
    own_dark: float = 2.0
    noise_levels: float = 2.0
    dead: int = 0
    hot: int = 0
    level: float = 190.0
    seed: int = 0

    def images(self, count: int, *, light: bool) -> list[NDArray[np.uint8]]:
        """Return images of blank paper, or in the dark."""
        return self.see(np.full(self.shape, 1.0 if light else 0.0), count)

    def see(self, scene: NDArray[np.float64], count: int = 1) -> list[NDArray[np.uint8]]:
        """Return the image of a scene, (H, W) from 0 (no light) to 1 (white)."""
        fixed = np.random.default_rng(self.seed)
        y, x = np.meshgrid(*(np.linspace(-1, 1, side) for side in self.shape), indexing="ij")
        gain = 1 + 0.1 * x - self.shade / 2 * (x * x + y * y)
        gain *= 1 + self.own_gain * fixed.standard_normal(self.shape)
        dark = 14 + self.own_dark * fixed.standard_normal(self.shape)
        broken = fixed.permutation(gain.size)
        gain.ravel()[broken[: self.dead]] = 0.02
        dark.ravel()[broken[self.dead : self.dead + self.hot]] += 120
        fresh = np.random.default_rng((self.seed, count, int(1e6 * scene.mean())))
        return [
            np.clip(
                np.rint(
                    dark
                    + self.level * gain * scene
                    + self.noise_levels * fresh.standard_normal(self.shape)
                ),
                0,
                255,
            ).astype(np.uint8)
            for _ in range(count)
        ]


def weigh_simulated(listed: Sequence[float] | None, seconds: float) -> list[Weighing]:
    """Weigh some grams, or a usual set, on a cell that does not exist."""
    cell, found = SimulatedCell(bend=0.02, hysteresis_n=0.005), []
    for grams in listed or (0, 20, 50, 100, 50, 20, 0):
        cell.put(grams)
        found.append(weigh(cell, grams, seconds))
    return found
