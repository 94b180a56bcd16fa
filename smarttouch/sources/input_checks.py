"""Check of what a source returns: converted where its meaning is certain, else refused."""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from smarttouch.afferent import Afferent
from smarttouch.errors import SourceError
from smarttouch.sources.frame import Frame
from smarttouch.sources.stimulus import Input, Stimulus

_GRAY = np.array([0.299, 0.587, 0.114])  # luma of red, green and blue, ITU-R BT.601


def checked_input(given: Any, who: str, electrodes: int) -> Input:
    """Return a frame or stimulus that a source named ``who`` returned, for (E,) electrodes.

    Raises a SourceError for anything else, with what it is.
    """
    if isinstance(given, Frame):
        image = given.image
        if type(image) is np.ndarray and image.dtype == np.uint8 and image.ndim == 2 and image.size:
            return given
        return replace(given, image=gray_image(image, who))
    if not isinstance(given, Stimulus):
        raise SourceError(
            f"{who} returned {_kind(given)}: a source returns a Frame or a Stimulus, or None at "
            "its end",
            about="source",
        )
    activation = checked_activation(given.activation, who, electrodes)
    return given if activation is given.activation else replace(given, activation=activation)


def gray_image(image: Any, who: str) -> NDArray[np.uint8]:
    """Return an image as gray levels, (H, W) uint8, 0 black: from bool, gray, RGB or RGBA.

    What is transparent is white. Raises a SourceError for other types and shapes: which number
    is white would be a guess.
    """
    wanted = "give gray levels (H, W) uint8, 0 black and 255 white"
    if not isinstance(image, np.ndarray):
        raise SourceError(f"{who} gave an image that is {_kind(image)}: {wanted}", about="image")
    if image.dtype == np.bool_:
        image = image.astype(np.uint8) * np.uint8(255)
    channels = image.shape[2] if image.ndim == 3 else 1
    if image.dtype != np.uint8 or image.ndim not in (2, 3) or channels not in (1, 3, 4):
        raise SourceError(
            f"{who} gave an image of {image.dtype} {image.shape}: {wanted}, or RGB (H, W, 3)",
            about="image",
        )
    if not image.size:
        raise SourceError(
            f"{who} gave an image without pixels {image.shape}: {wanted}", about="image"
        )
    if channels == 1:
        return np.ascontiguousarray(image.reshape(image.shape[:2]))
    gray = image[:, :, :3] @ _GRAY
    if channels == 4:
        gray = 255 + (gray - 255) * (image[:, :, 3] / 255)
    return np.asarray(np.rint(gray), np.uint8)


def checked_activation(activation: Any, who: str, electrodes: int) -> NDArray[np.float32]:
    """Return the activation of (3, E) electrodes as float32, of numbers in [0, 1] alone."""
    shape = len(Afferent), electrodes
    if not isinstance(activation, np.ndarray) or activation.dtype.kind not in "fbiu":
        raise SourceError(
            f"{who} gave an activation that is {_kind(activation)}: give an array of {shape}, "
            "in [0, 1]",
            about="activation",
        )
    if activation.shape != shape:
        raise SourceError(
            f"{who} gave an activation of {activation.shape}: this array has {shape}, a row for "
            "each of RA, SAI and PC",
            about="activation",
        )
    # Nothing is above NaN.
    lowest, highest = float(activation.min()), float(activation.max())
    if not 0 <= lowest <= highest <= 1:
        raise SourceError(
            f"{who} gave an activation from {lowest:g} to {highest:g}: it must be in [0, 1]",
            about="activation",
        )
    return activation if activation.dtype == np.float32 else activation.astype(np.float32)


def _kind(value: Any) -> str:
    if isinstance(value, np.ndarray):
        return f"an array of {value.dtype} {value.shape}"
    name = type(value).__name__
    return f"{'an' if name[0].lower() in 'aeiou' else 'a'} {name}"
