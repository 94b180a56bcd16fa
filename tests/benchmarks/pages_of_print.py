"""Lines that are found on pages of print, in order, and pictures to check them by eye.

Run ``python -m tests.benchmarks.pages_of_print FOLDER OUTPUT``: of each page its
lines, what was said of it, and CPU seconds; OUTPUT gets it with its lines numbered.
"""

import sys
import time
from pathlib import Path

import cv2
import numpy as np

from smarttouch.base.errors import SmartTouchError
from smarttouch.pages.document import open_document
from smarttouch.reading.recognition import RecognitionOptions, upright_page

SIDE_PX = 1600


def drawn(prepared):
    """Return a page with its lines underlined and numbered."""
    grey, scale = prepared.page.grey, prepared.page.mm_per_pixel
    part = min(1.0, SIDE_PX / max(grey.shape))
    small = cv2.resize(grey, None, fx=part, fy=part, interpolation=cv2.INTER_AREA)
    picture = cv2.cvtColor(small, cv2.COLOR_GRAY2BGR)
    for number, line in enumerate(prepared.lines, 1):
        x = np.linspace(line.left_mm, line.right_mm, 30)
        points = np.column_stack([x, line.baseline_mm(x)]) / scale * part
        cv2.polylines(picture, [points.astype(np.int32)], False, (0, 0, 255), 2)
        place = (max(0, int(points[0, 0]) - 25), int(points[0, 1]))
        cv2.putText(picture, str(number), place, cv2.FONT_HERSHEY_SIMPLEX, 0.5, (255, 0, 0), 1)
    return picture


def main() -> None:
    """Print a line for each page of a folder."""
    folder, output = map(Path, sys.argv[1:3])
    output.mkdir(exist_ok=True)
    for path in sorted(folder.iterdir()):
        said: list[str] = []
        try:
            with open_document(path) as document:
                page = document.page(0)
        except SmartTouchError:
            continue
        start = time.process_time()
        prepared = upright_page(1, page, RecognitionOptions(), said.append)
        seconds = time.process_time() - start
        print(
            f"{path.name:24s} {len(prepared.lines):4d} lines, {seconds:4.1f} s; {'; '.join(said)}"
        )
        cv2.imwrite(str(output / f"{path.stem}.png"), drawn(prepared))


if __name__ == "__main__":
    cv2.setNumThreads(1)
    main()
