"""Error of position and angle after 100 mm of print, by the motion between images.

Run ``python -m tests.benchmarks.turns_over_print [FILE]``: a rendered finger moves over a line
of print, or of a page that is made 100 mm wide, with sensors of 64 x 64 and 640 x 480 pixels.
"""

import math
import sys
import tempfile
import time
from pathlib import Path

import cv2
import numpy as np

from smarttouch.pages.document import open_document
from smarttouch.pages.page_image import Page
from smarttouch.pages.text_lines import find_lines
from smarttouch.profile import load_profile
from smarttouch.sources.preprocess import FramePreprocessor
from smarttouch.sources.virtual_finger import PageSource

from ..pages.printed import print_page, some_lines

SECONDS, LENGTH_MM, RATE_HZ = 2.5, 100.0, 100
PATHS = {
    "straight": (0.0, lambda t: 0 * t),
    "waves of 2 mm": (2.0, lambda t: 0 * t),
    "waves, swings by 10°": (2.0, lambda t: 10 * np.sin(2.5 * t)),
    "waves, turns by 20°": (1.0, lambda t: 20 * t / SECONDS),
}
SENSORS = {
    "64 x 64": {},
    "640 x 480": {"sensor_rows": 480, "sensor_columns": 640, "field_width_mm": 20 / 3},
}


def line_of(page):
    """Return a page whose middle line is long enough, and where that begins, mm."""
    lines = find_lines(page)
    line = lines[len(lines) // 2]
    scale = max(1.0, LENGTH_MM / (line.right_mm - line.left_mm))
    middle_mm = float(line.baseline_mm(np.array(line.left_mm))) - line.x_height_mm / 2
    larger = Page(page.grey, page.mm_per_pixel * scale)
    return larger, scale * line.left_mm, scale * middle_mm


def main() -> None:
    """Print a line for each path and sensor."""
    page = print_page(some_lines(9, 70), size_pt=11, dpi=200).page
    if len(sys.argv) > 1:
        with open_document(Path(sys.argv[1])) as document:
            page = document.page(0)
    page, x_mm, y_mm = line_of(page)
    profile = load_profile("electric-mouse")
    times = np.arange(round(SECONDS * RATE_HZ) + 1) / RATE_HZ
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "path.csv"
        for name, (high_mm, angle) in PATHS.items():
            x, y = x_mm + LENGTH_MM / SECONDS * times, y_mm + high_mm * np.sin(2 * times)
            path = np.column_stack([times, x, y, angle(times), np.ones_like(times)])
            header = "time_s,x_mm,y_mm,angle_deg,force_n"
            np.savetxt(file, path, delimiter=",", header=header, comments="")
            truth = np.column_stack([x, y, np.radians(angle(times))])
            for sensor, update in SENSORS.items():
                optics = profile.optics.model_copy(update=update)
                seen = profile.model_copy(update={"optics": optics})
                source, intake = PageSource(page, seen, name, path=file), FramePreprocessor(seen)
                found, busy_s = [], 0.0
                for moment in times:
                    frame = source.read(round(moment * 1e9))
                    start = time.process_time()
                    _, pose = intake.take(frame.image)
                    busy_s += time.process_time() - start
                    found.append((pose.x_mm, pose.y_mm, pose.angle_rad))
                away = np.array(found) - (truth - truth[0])
                each = np.sqrt(np.square(np.diff(away, axis=0)).mean(axis=0))
                print(
                    f"{name:21s} {sensor:9s} end {math.hypot(*away[-1, :2]):5.2f} mm "
                    f"{math.degrees(away[-1, 2]):+5.2f}°, frame {1000 * math.hypot(*each[:2]):4.1f}"
                    f" µm {math.degrees(each[2]):5.3f}°, {1e6 * busy_s / len(times):4.0f} µs"
                )


if __name__ == "__main__":
    cv2.setNumThreads(1)
    main()
