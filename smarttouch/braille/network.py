"""Small convolutional network that finds cells of Braille in a picture, run by numpy.

Its weights come from rendered pages alone; no photograph went into them.
"""

from functools import cache
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

STRIDE = 4
"""Pixels of the picture per position of the network's map."""
LEAST = 0.4
"""Least certainty of a position where a cell is found."""
_DILATIONS = (1, 1, 2, 4, 8, 2, 1)
_NEAR_PX, _AROUND_PX = (
    41,
    81,
)  # sides of the squares over which brightness and contrast are normalized
_APART_PX = 11, 14
"""Least distance of cells, across and down: those of the finest pages have 18 and 28."""
_TOGETHER = 1024  # positions of a map computed at once: their input fits into a processor's cache

Image = NDArray[np.float32]


class FoundCells(NamedTuple):
    """Cells found in a picture."""

    px: NDArray[np.float64]  # (N, 2), middles: column and row
    patterns: NDArray[np.int_]  # (N,), bit k is dot k + 1
    certainty: NDArray[np.float64]  # (N,) in [0, 1], that all of a cell is right


def find_cells(grey: NDArray[np.uint8]) -> FoundCells:
    """Return the cells of a picture whose dots are 8 to 13 pixels apart, lit from above."""
    height, width = grey.shape
    edges = 0, -height % (2 * STRIDE), 0, -width % (2 * STRIDE)
    framed = cv2.copyMakeBorder(grey, *edges, borderType=cv2.BORDER_REFLECT)
    maps = _run(_even(np.asarray(framed, np.uint8)))
    there = maps[0]
    peaks = (there >= cv2.dilate(there, np.ones((3, 3), np.uint8))) & (there > LEAST)
    rows, columns = np.nonzero(peaks)
    strength, dots = there[rows, columns], maps[3:, rows, columns]
    px = np.column_stack([columns + maps[1, rows, columns], rows + maps[2, rows, columns]])
    px = px.astype(float) * STRIDE + (STRIDE - 1) / 2
    kept = _without_overlaps(px, strength)
    dots = dots[:, kept]
    return FoundCells(
        px[kept],
        (dots > 0.5).T @ (1 << np.arange(6)),
        np.asarray(strength[kept] * np.maximum(dots, 1 - dots).prod(axis=0), float),
    )


def _even(grey: NDArray[np.uint8]) -> Image:
    """Return a picture with normalized background and contrast."""
    picture = grey.astype(np.float32)
    near = picture - cv2.blur(picture, (_NEAR_PX,) * 2, borderType=cv2.BORDER_REFLECT)
    spread = np.maximum(cv2.blur(near * near, (_AROUND_PX,) * 2, borderType=cv2.BORDER_REFLECT), 0)
    return np.asarray(np.clip(near / (np.sqrt(spread) + 2), -4, 4), np.float32)


def _run(picture: Image) -> Image:
    """Return maps, (9, H, W): certainty of a cell, its two offsets, and its six dots."""
    layers = _layers()
    image = picture[None]
    for (weights, bias), stride in zip(layers[:3], (1, 2, 2), strict=True):
        image = np.maximum(_convolved(image, weights, bias, stride), 0)
    for (weights, bias), dilation in zip(layers[3:-1], _DILATIONS, strict=True):
        image = image + np.maximum(_convolved(image, weights, bias, dilation=dilation), 0)
    maps = _convolved(image, *layers[-1])
    for each in (0, *range(3, 9)):
        maps[each] = 1 / (1 + np.exp(-np.clip(maps[each], -30, 30)))
    return maps


def _convolved(
    image: Image, weights: Image, bias: Image, stride: int = 1, dilation: int = 1
) -> Image:
    """Return an image, (C, H, W), convolved by weights, (D, C, K, K), in bands of rows."""
    count, channels, size, _ = weights.shape
    edge = dilation * (size // 2)
    framed = np.pad(image, ((0, 0), (edge, edge), (edge, edge)))
    height, width = (-(-side // stride) for side in image.shape[1:])
    matrix = weights.transpose(0, 2, 3, 1).reshape(count, -1)
    made = np.empty((count, height, width), np.float32)
    band = max(1, _TOGETHER // width)
    for first in range(0, height, band):
        rows = min(band, height - first)
        taps = np.empty((size, size, channels, rows, width), np.float32)
        for row, column in np.ndindex(size, size):
            top, left = first * stride + row * dilation, column * dilation
            taps[row, column] = framed[:, top::stride, left::stride][:, :rows, :width]
        product = matrix @ taps.reshape(-1, rows * width) + bias[:, None]
        made[:, first : first + rows] = product.reshape(count, rows, width)
    return made


@cache
def _layers() -> list[tuple[Image, Image]]:
    """Return weights and bias of each layer."""
    with np.load(Path(__file__).with_name("network.npz")) as saved:
        count = len(saved.files) // 2
        return [
            (saved[f"weights{n}"].astype(np.float32), saved[f"bias{n}"].astype(np.float32))
            for n in range(count)
        ]


def _without_overlaps(px: NDArray[np.float64], strength: Image) -> NDArray[np.int_]:
    """Return the indices, (M,), of the most certain of cells that overlap."""
    kept: list[int] = []
    across, down = _APART_PX
    for each in np.argsort(-strength, kind="stable"):
        away = np.abs(px[kept] - px[each])
        if not ((away[:, 0] < across) & (away[:, 1] < down)).any():
            kept.append(int(each))
    return np.array(sorted(kept), int)
