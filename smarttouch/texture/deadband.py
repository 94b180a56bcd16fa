"""Deadband that suppresses one-count jitter of a resting mouse."""

import math

SLIDES = 1.5
"""Distance, in counts, at which a moving hand is followed: to and fro by one count, along both
axes (2.8 counts from end to end), is then no motion back."""
STICKS = 4.5
"""Counts by which a resting hand must move: the distance behind, and the same to and fro."""

_ROUNDING = 1 + 1e-6
"""Tolerance for rounding, as a slide ends at exactly this distance."""


class Deadband:
    """Place that follows another as a block follows a rubber band: it sticks, then slides behind.

    Once the place has stood still for one read, jitter by one count (`resolution_mm`; 0 follows
    exactly) along both axes never moves it.
    """

    def __init__(self, resolution_mm: float) -> None:
        self._slides_mm, self._sticks_mm = SLIDES * resolution_mm, STICKS * resolution_mm
        self._moves = False
        self._x_mm = self._y_mm = 0.0

    def follow(self, x_mm: float, y_mm: float) -> tuple[float, float]:
        """Return the steadied place of the hand, mm."""
        by_x, by_y = x_mm - self._x_mm, y_mm - self._y_mm
        far_mm = math.hypot(by_x, by_y)
        far_enough_mm = self._slides_mm if self._moves else self._sticks_mm
        self._moves = far_mm > far_enough_mm * _ROUNDING
        if self._moves:
            share = 1 - self._slides_mm / far_mm
            self._x_mm += share * by_x
            self._y_mm += share * by_y
        return self._x_mm, self._y_mm
