"""Frames of optical sources, and the tactile image, the touch analogue of an RGB image."""

import math
from dataclasses import dataclass, fields
from enum import Enum
from typing import Any

import numpy as np
from numpy.typing import NDArray


def one_line(record: Any) -> str:
    """Return a one-line repr of a dataclass. Arrays are shortened to their type and shape."""
    shown = [f"{field.name}={_brief(getattr(record, field.name))}" for field in fields(record)]
    return f"{type(record).__name__}({', '.join(shown)})"


def _brief(value: Any) -> str:
    if isinstance(value, np.ndarray):
        return f"{value.dtype} {value.shape}"
    if isinstance(value, float):
        return f"{value:g}"
    text = value.name if isinstance(value, Enum) else repr(value)
    long = text.startswith("<") or len(text) > 60 or "\n" in text
    return f"<{type(value).__name__}>" if long else text


@dataclass(frozen=True)
class Pose:
    """Position of the sensor's center on the page.

    ``x_mm`` is measured to the right and ``y_mm`` down from the top left corner of the page;
    ``angle_rad`` rotates the sensor clockwise on the page.
    """

    x_mm: float
    y_mm: float
    angle_rad: float = 0.0


@dataclass(frozen=True, eq=False)
class Frame:
    """One image of an optical source.

    Attributes
    ----------
    image : ndarray, (H, W) uint8
        Gray levels; 255 is white.
    time_ns : int
        Time at which the image was read, since the start of the run.
    pose : Pose
        Pose of the sensor.
    force_n : float, N
        Force of the finger; NaN if unknown.
    number : int
        Number of the image at its source, from 0; frames with equal numbers show the same image.
    age_ns : int
        Age of the image when it was read.
    stale : bool
        Whether the image may be outdated, because the source delivers no new one.
    period_us : int, µs, optional
        Time to the next read. Each active class gets one pulse in this time. None means that
        classes get pulses at the profile's rates.
    """

    __repr__ = one_line

    image: NDArray[np.uint8]
    time_ns: int
    pose: Pose = Pose(0.0, 0.0)
    force_n: float = math.nan
    number: int = 0
    age_ns: int = 0
    stale: bool = False
    period_us: int | None = None


@dataclass(frozen=True, eq=False)
class TactileImage:
    """Activation of each afferent class at each electrode.

    Attributes
    ----------
    activation : ndarray, (3, E) float32, in [0, 1]
        One row for each `Afferent`: RA, SAI, PC.
    time_ns : int
        Time of the frame or stimulus.
    force_n : float, N
        Finger force at that time.
    period_us : int, µs, optional
        Time to the next image. Each active class gets one pulse in this time. None means that
        classes get pulses at the profile's rates.
    level : float, in [0, 1]
        Factor that multiplies the user's intensity.
    """

    __repr__ = one_line

    activation: NDArray[np.float32]
    time_ns: int
    force_n: float
    period_us: int | None = None
    level: float = 1.0
