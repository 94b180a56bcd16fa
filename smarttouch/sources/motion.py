"""Subpixel motion and turn of the sensor over the page between images."""

import math

import numpy as np
from numpy.typing import NDArray

from smarttouch.profile import Optics, Profile
from smarttouch.sources.image_match import Matcher, Shift

_SQUARE = 1.03  # ratio of the sides of pixels below which they are square


class MotionTracker:
    """Tracks the motion of a patch over the page by its images.

    Motion that cannot be measured counts as none: on blank paper, along a straight edge that fills
    the patch, or where two images have too little in common.
    """

    def __init__(self, profile: Profile) -> None:
        self.turn_rad = 0.0
        self._optics = profile.optics
        self._matcher: Matcher | None = None
        self._shape = (0, 0)
        self._page_mm = ((0.0, 0.0), (0.0, 0.0))
        self._first = True

    def follow(self, image: NDArray[np.uint8]) -> Shift:
        """Return the motion of the patch on the page since the last image, mm along its rows and
        columns.

        When the print moves left in the image, the patch has moved right. An image of another size
        starts again.
        """
        if self._matcher is None or image.shape != self._shape:
            self._shape = (image.shape[0], image.shape[1])
            self._matcher = Matcher(self._shape)
            self._page_mm = page_per_pixel(self._optics, self._matcher.shape)
            self._matcher.turns = _is_even(self._page_mm)
            self._first = True
        x, y, turn_rad = self._matcher.match(image, self._first)
        self._first = False
        (x_by_x, x_by_y), (y_by_x, y_by_y) = self._page_mm
        self.turn_rad = -turn_rad
        return -(x_by_x * x + x_by_y * y), -(y_by_x * x + y_by_y * y)

    def forget(self) -> None:
        """Restart: the motion to the next image is unknown."""
        self._first = True


def page_per_pixel(
    optics: Optics, shape: tuple[int, int]
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the motion on the page that shifts the image by one pixel, (2, 2) mm.

    ``shape`` is that of the image that spans the field of view; a homography counts as in its
    middle.
    """
    rows, columns = shape
    if optics.homography is None:
        turn = math.radians(optics.rotation_deg)
        x_mm, y_mm = optics.field_width_mm / columns, optics.field_height_mm / rows
        # From image to page: the transpose of the turn in imaging.registration.
        cos, sin = math.cos(turn), math.sin(turn)
        return (cos * x_mm, sin * y_mm), (-sin * x_mm, cos * y_mm)
    to_pixel = np.reshape(optics.homography, (3, 3))
    middle = to_pixel[:2, 2] / to_pixel[2, 2]
    slope = (to_pixel[:2, :2] - np.outer(middle, to_pixel[2, :2])) / to_pixel[2, 2]
    slope *= np.array([[columns / optics.sensor_columns], [rows / optics.sensor_rows]])
    (a, b), (c, d) = np.linalg.inv(slope).tolist()
    return (a, b), (c, d)


def _is_even(page_mm: tuple[tuple[float, float], tuple[float, float]]) -> bool:
    """Return whether pixels are square on the page, so that a turn of it is one of the image."""
    across, down = np.array(page_mm).T
    lengths = math.hypot(*across), math.hypot(*down)
    askew = abs(float(across @ down)) / (lengths[0] * lengths[1])
    return max(lengths) < _SQUARE * min(lengths) and askew < _SQUARE - 1
