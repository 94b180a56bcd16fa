"""Lines of text in reading order by Tesseract's layout analysis, without recognition.

It runs as a process of its own, ``python tesseract_layout.py WIDTH HEIGHT`` with the pixels as its
input, because Tesseract aborts a process where it fails.
"""

import ctypes
import ctypes.util
import shutil
import subprocess
import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

_LETTER_PX, _LARGEST = 20.0, 2.0  # height of letters for the analysis, and most enlargement
_CLEARLY, _MOSTLY = 0.7, 0.9  # least part of a line in one block, and of such lines of a page
_AUTO_ONLY, _BLOCK, _LINE = 2, 0, 2  # Tesseract's numbers of a mode and of levels
_TEXT_TYPES = range(1, 8)  # Tesseract's types of blocks that contain text
_TIMEOUT_S = 30.0


def analyze_layout(grey: "NDArray[np.uint8]") -> "NDArray[np.int_] | None":
    """Return block, left, top, right, bottom of lines in reading order, (N, 5) px.

    ``grey`` is (H, W), dark on light, with letters about 20 pixels high. Returns None where
    Tesseract is not installed, or fails.
    """
    import numpy as np

    if shutil.which("tesseract") is None:
        return None
    height, width = grey.shape
    command = [sys.executable, "-I", "-S", __file__, str(width), str(height)]
    try:
        table = subprocess.run(
            command, input=grey.tobytes(), capture_output=True, check=True, timeout=_TIMEOUT_S
        ).stdout
    except (OSError, subprocess.SubprocessError):
        return None
    return np.array(table.split(), np.int_).reshape(-1, 5)


def blocks_of_lines(
    cleaned: "NDArray[np.uint8]",
    scale: int,
    height: float,
    x: "NDArray[np.float64]",
    y: "NDArray[np.float64]",
) -> "NDArray[np.int_] | None":
    """Return the number of the block of each line, (N,), 0 where it is not clear.

    ``cleaned`` is the page, (H, W). ``height`` is that of letters, and ``x`` and ``y`` are places
    in the middle of each line, (N, P), in pixels ``scale`` times larger. Returns None where
    Tesseract is not installed, or the lines do not fit its blocks.
    """
    import cv2
    import numpy as np

    part = min(_LETTER_PX / height / scale, _LARGEST)
    how = cv2.INTER_AREA if part < 1 else cv2.INTER_LINEAR
    grey = cv2.resize(cleaned, None, fx=part, fy=part, interpolation=how)
    blocks = analyze_layout(np.asarray(grey, np.uint8))
    if blocks is None:
        return None
    numbers = np.zeros(grey.shape, np.int_)
    for number, left, top, right, bottom in blocks:
        numbers[top:bottom, left:right] = number
    rows, columns = (
        np.clip(np.round(part * scale * each).astype(int), 0, size - 1)
        for each, size in ((y, len(numbers)), (x, len(numbers[0])))
    )
    there = numbers[rows, columns]
    middle = np.median(there, axis=1).astype(int)
    clear = ((there == middle[:, None]).mean(axis=1) >= _CLEARLY) & (middle > 0)
    return np.where(clear, middle, 0) if clear.mean() >= _MOSTLY else None


def _print_lines(width: int, height: int, pixels: bytes) -> None:
    tesseract = ctypes.CDLL(ctypes.util.find_library("tesseract"))
    tesseract.TessBaseAPICreate.restype = tesseract.TessBaseAPIAnalyseLayout.restype = (
        ctypes.c_void_p
    )
    api = ctypes.c_void_p(tesseract.TessBaseAPICreate())
    tesseract.TessBaseAPIInitForAnalysePage(api)
    tesseract.TessBaseAPISetPageSegMode(api, _AUTO_ONLY)
    tesseract.TessBaseAPISetImage(api, pixels, width, height, 1, width)
    lines = ctypes.c_void_p(tesseract.TessBaseAPIAnalyseLayout(api))
    sides = [ctypes.c_int() for _ in range(4)]
    block = 0
    while lines:
        block += tesseract.TessPageIteratorIsAtBeginningOf(lines, _BLOCK)
        tesseract.TessPageIteratorBoundingBox(lines, _LINE, *map(ctypes.byref, sides))
        if tesseract.TessPageIteratorBlockType(lines) in _TEXT_TYPES:
            print(block, *(side.value for side in sides))
        if not tesseract.TessPageIteratorNext(lines, _LINE):
            break


if __name__ == "__main__":
    _print_lines(int(sys.argv[1]), int(sys.argv[2]), sys.stdin.buffer.read())
