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
