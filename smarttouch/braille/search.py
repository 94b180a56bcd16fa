"""Search for the appearance of dots that makes cells: their kind, size, and light."""

import math
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from smarttouch.braille.dots import Look, even_light, light_at, light_axis
from smarttouch.braille.view import View, look_at

SIGMAS_PX = (2.0, 1.4)
"""Scales of the search for dots in each octave: their pitch is 7 to 13 of its pixels."""
SIGMA_PITCHES = 0.17
"""Scale that separates dots of both sides best, in pitches."""
_MOST_OCTAVES = 5
"""Largest number of octaves; the coarsest is for close-ups with a pitch of 200 pixels."""
_LEAST_PITCH_PX = 9.0
"""Least pitch; finer dots are less sharp, and coarser ones no better."""
SURE = 0.7
"""Certainty above which the search ends."""
_SMALLEST_SIDE = 40
_RELIEF_RATIO = 1.25
"""Embossed pages have 1.4 and more, spots of ink 1.1 and less (see `light_axis`)."""
_AS_SURE = 0.8
"""Part of a view's certainty from which another one may be the better."""
_APART = 1.0
"""Distance, in dot pitches, beyond which a dot is no rim of another, but of the other side."""
_OTHERS = 0.1
"""Share of such dots above which they are those of the other side."""


def octaves(grey: NDArray[np.uint8]) -> list[NDArray[np.float32]]:
    """Return a page under even light, repeatedly at half its size."""
    images = [even_light(grey)]
    while len(images) < _MOST_OCTAVES and min(images[-1].shape) >= 2 * _SMALLEST_SIDE:
        half = cv2.resize(images[-1], None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
        images.append(np.asarray(half, np.float32))
    return images


def find_view(images: list[NDArray[np.float32]], light_from_deg: float | None) -> View | None:
    """Return the first certain view, else the most certain; None if none shows cells.

    Parameters
    ----------
    images : list of ndarray
        The page, as `octaves` gives it.
    light_from_deg : float, °, optional
        As in `Look`, if it is known; dots are raised then.
    """
    tries = [_kinds(image, light_from_deg) for image in images]
    best: View | None = None
    # What is coarse is quick; what is likely comes first at all scales.
    for kind in range(len(tries[0])):
        for image, kinds in zip(reversed(images), reversed(tries), strict=True):
            for sigma_px in SIGMAS_PX:
                looks = [replace(look, sigma_px=sigma_px) for look in kinds[kind]]
                found = _better([look_at(image, look) for look in looks])
                if found and (best is None or found.certainty > best.certainty):
                    best = found
                if best and best.certainty > SURE:
                    return best
    return best


def look_closer(
    images: list[NDArray[np.float32]], view: View, light_from_deg: float | None
) -> View:
    """Return the view at the scale and in the light of its own dots."""
    for _ in range(2):
        finest_px = view.lattice.pitch_px() * images[0].shape[1] / view.image.shape[1]
        octave = min(max(0, math.floor(math.log2(finest_px / _LEAST_PITCH_PX))), len(images) - 1)
        look = replace(view.dots.look, sigma_px=SIGMA_PITCHES * finest_px / 2**octave)
        looks = [look]
        if look.light_from_deg is not None and light_from_deg is None:
            light_deg = light_at(view.image, view.dots.px[view.proven], view.dots.look.sigma_px)
            looks = [replace(look, light_from_deg=light_deg + turn) for turn in (0, 180)]
        closer = _better([look_at(images[octave], each) for each in looks])
        if closer is None or closer.certainty < _AS_SURE * view.certainty:
            break
        view = closer
    return view


def shows_both_sides(view: View) -> bool:
    """Return whether raised dots are mixed with others, lit from the opposite side.

    The rims of a dot look like that too, but lie next to it.
    """
    look = view.dots.look
    if look.light_from_deg is None:
        return False
    other = look_at(view.image, replace(look, light_from_deg=look.light_from_deg + 180))
    if other is None or not other.proven.any():
        return False
    away, _ = cKDTree(view.dots.px[view.fit]).query(other.dots.px[other.proven])
    return bool(np.mean(away > _APART * view.lattice.pitch_px()) > _OTHERS)


def _kinds(image: NDArray[np.float32], light_from_deg: float | None) -> list[list[Look]]:
    """Return looks of the likely kind, and of the other one."""
    sigma_px = SIGMAS_PX[0]
    if light_from_deg is not None:
        return [[Look(sigma_px, light_from_deg)]]
    axis_deg, ratio = light_axis(image, sigma_px)
    raised = [Look(sigma_px, axis_deg), Look(sigma_px, axis_deg + 180)]
    ink = [Look(sigma_px), Look(sigma_px, ink_is_dark=False)]
    return [raised, ink] if ratio > _RELIEF_RATIO else [ink, raised]


def _better(views: list[View | None]) -> View | None:
    """Return the more certain view; of two about equal, the one with more contrast.

    The far edge of a dot's shadow looks like a dot too, but a fainter one.
    """
    seen = [view for view in views if view is not None and view.proven.any()]
    if not seen:
        return None
    least = _AS_SURE * max(view.certainty for view in seen)
    return max((view for view in seen if view.certainty >= least), key=View.contrast)
