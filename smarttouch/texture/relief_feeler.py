"""Sampler of a relief: pulses of electrodes that move over it.

A grating has a phase; what else is printed or woven has none. The rule here gives the
same pulses on gratings and fills areas: **every pulse stands for one grain of way over
high ground**. High is what exceeds its surroundings; its depth is the distance to where
it ends, at most half a grain. An electrode pulses where the depth along its way is
greatest: in the middle of a ridge narrower than a grain, half a grain inside the edge of
an area, and from there on after each grain of way. Where a pitch dominates, ridges are
silent along themselves, as a grating's are; strokes of shapes pulse along themselves, too.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from smarttouch.texture.relief import Relief
from smarttouch.texture.texture import RidgeCrossing

_STROKE = 0.15
"""Depth of the thinnest stroke that pulses along itself, in grains."""
_STEP = 1.25
"""Distance of samples along the way, in pixels of the map."""
_MOST_SAMPLES = 64
_FULL = 0.96
"""Share of half a grain from which the depth counts as full: beyond rounding, and the blur."""
_RISEN = 0.5
"""Part of its depth by which a ridge must rise, so that a way along its crest passes none."""


class ReliefFeeler:
    """Samples the depth along each electrode's path, from (E, 2) mm, and finds its maxima."""

    # Places of the array's middle are complex numbers, x + iy in mm: one number for each
    # electrode is twice as fast as two.

    def __init__(self, relief: Relief, position_mm: NDArray[np.float64]) -> None:
        self._relief = relief
        x_mm, y_mm = relief.scale_mm
        self._own_x = (position_mm[:, 0] / x_mm - 0.5).astype(np.float32)
        self._own_y = (position_mm[:, 1] / y_mm - 0.5).astype(np.float32)
        self._step_mm = _STEP * relief.pixel_mm
        self._full_mm = np.float32(_FULL * relief.grain_mm / 2)
        self._least_mm = relief.pixel_mm / 2
        self._ground_mm = self._full_mm if relief.woven else np.float32(_STROKE * relief.grain_mm)
        self._within_mm = 0.0 if relief.woven else relief.grain_mm / 2 - float(self._ground_mm)
        """Distance of an electrode over this ground at its first pulse."""
        self._all = np.arange(len(position_mm))
        self._nothing = RidgeCrossing(np.zeros(len(position_mm), np.float32), 0)
        self._nothing.height.flags.writeable = False
        self.place(0.0, 0.0)

    def place(self, x_mm: float, y_mm: float) -> None:
        """Place the middle of the array; an area under it pulses after one grain of motion."""
        self._place = complex(x_mm, y_mm)
        x, y = self._on_map(np.array([self._place]))
        self._before = np.repeat(self._depth(x, y), 2, axis=0)
        self._lowest = self._before[0].copy()
        """Lowest depth of each electrode since its last pulse."""
        self._pulsed = np.full(len(self._all), self._place)
        """Place of the array at the last pulse of each electrode."""
        self._entered = self._pulsed.copy()
        """Place of the array when each electrode came onto high ground."""

    def move(self, x_mm: float, y_mm: float) -> RidgeCrossing:
        """Move the middle of the array; motion shorter than a sample is kept for later."""
        by = complex(x_mm, y_mm) - self._place
        samples = int(abs(by) / self._step_mm)
        if not samples:
            return self._nothing
        step = by * (self._step_mm / abs(by))
        if samples > _MOST_SAMPLES:
            samples, step = _MOST_SAMPLES, by / _MOST_SAMPLES
        # The first two are those of before: a greatest depth shows one sample later.
        places = self._place + step * np.arange(-1, samples + 1)
        x, y = self._on_map(places)
        depth = np.concatenate([self._before, self._depth(x[2:], y[2:])])
        self._place = complex(places[-1])
        self._before = depth[-2:]
        if not depth.any():
            self._lowest = depth[-1]
            self._entered = np.full(len(self._all), self._place)
            return self._nothing
        return self._crossing(places, depth, abs(step), (x, y))

    def _crossing(
        self,
        places: NDArray[np.complex128],
        depth: NDArray[np.float32],
        step_mm: float,
        on_map: tuple[NDArray[np.float32], NDArray[np.float32]],
    ) -> RidgeCrossing:
        lowest = np.minimum.accumulate(np.minimum(depth, self._lowest), axis=0)
        found, last, merged = self._crests(depth, lowest, step_mm)
        inside = self._inside(places, depth) & ~found
        pulsed = found | inside
        if not pulsed.any():
            self._lowest = lowest[-1]
            return self._nothing
        self._lowest = np.where(pulsed, depth[-1], lowest[-1])
        # Frames come later than whole grains: what is over counts for the next.
        gone, grain_mm = places[-1] - self._pulsed, self._relief.grain_mm
        gone_mm = np.maximum(np.abs(gone), grain_mm)
        over = gone_mm - grain_mm < step_mm * (len(places) - 2)
        due = self._pulsed + gone * np.where(over, grain_mm / gone_mm, 1.0)
        self._pulsed = np.where(found, places[last], np.where(inside, due, self._pulsed))
        row = np.where(found, last, len(places) - 1)
        x, y = (each[row, self._all][None] for each in on_map)
        height = self._sample(self._relief.height, x, y)[0]
        return RidgeCrossing(np.asarray(height * pulsed, np.float32), merged)

    def _crests(
        self,
        depth: NDArray[np.float32],
        lowest: NDArray[np.float32],
        step_mm: float,
    ) -> tuple[NDArray[np.bool_], NDArray[np.intp], int]:
        """Return which electrodes passed a crest, the sample of the last, and how many more."""
        middle = depth[1:-1]
        # Level ground is no crest before it falls: what is as wide pulses by its way.
        crest = (middle >= depth[:-2]) & (middle > depth[2:]) & (middle > self._least_mm)
        crest &= middle - lowest[1:-1] >= _RISEN * middle
        last = len(crest) - crest[::-1].argmax(axis=0)
        found = crest[last - 1, self._all]
        if not found.any():
            return found, last, 0
        own_mm = depth[last, self._all]
        apart_mm = (last - 1 - crest.argmax(axis=0)) * step_mm
        merged = int((found & (apart_mm >= np.maximum(own_mm, step_mm))).sum())
        return found, last, merged

    def _inside(
        self, places: NDArray[np.complex128], depth: NDArray[np.float32]
    ) -> NDArray[np.bool_]:
        """Return which electrodes are a grain from their last pulse, and on high ground."""
        low = depth[1:] < self._ground_mm
        entered = places[len(low) - low[::-1].argmax(axis=0)]
        self._entered = np.where(low.any(axis=0), entered, self._entered)
        inside: NDArray[np.bool_] = ~low[-1]
        if inside.any():
            inside &= np.abs(places[-1] - self._pulsed) >= self._relief.grain_mm
            inside &= np.abs(places[-1] - self._entered) >= self._within_mm
        return inside

    def _on_map(
        self, places: NDArray[np.complex128]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return the electrodes' places on the map for places of the array, (N, E) pixels each."""
        x_mm, y_mm = self._relief.scale_mm
        x, y = places.real / x_mm, places.imag / y_mm
        if self._relief.tiled:
            # All by the same whole tiles, so that what lies between places stays between them.
            rows, columns = self._relief.height.shape
            x, y = x - columns * np.floor(x[0] / columns), y - rows * np.floor(y[0] / rows)
        return (
            x.astype(np.float32)[:, None] + self._own_x,
            y.astype(np.float32)[:, None] + self._own_y,
        )

    def _depth(self, x: NDArray[np.float32], y: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the depth at places on the map, (N, E) mm; full depths are equal."""
        return np.minimum(self._sample(self._relief.depth, x, y), self._full_mm)

    def _sample(
        self, values: NDArray[np.float32], x: NDArray[np.float32], y: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        mode = cv2.BORDER_WRAP if self._relief.tiled else cv2.BORDER_CONSTANT
        sampled = cv2.remap(values, x, y, cv2.INTER_LINEAR, borderMode=mode, borderValue=0)
        return np.asarray(sampled, np.float32)
