"""Drawn test pages of Braille dots."""

import cv2
import numpy as np

from smarttouch.braille.cells import POSITION, cells_to_dots


def draw_dots(lines: list[str], dot_px: float = 12.0):
    """Draw lines of cells as dark dots, (H, W) uint8; the dots of a cell are ``dot_px`` apart."""
    cell_px, line_px = np.array([2.65, 4.27]) * dot_px
    height, width = len(lines) * line_px, max(map(len, lines)) * cell_px
    page = np.full((round(height + 4 * dot_px), round(width + 4 * dot_px)), 225, np.uint8)
    for row, cells in enumerate(lines):
        for column, dot in np.argwhere(cells_to_dots(cells)):
            x, y = POSITION[dot] * dot_px + (column * cell_px, row * line_px) + 2 * dot_px
            cv2.circle(page, (round(x), round(y)), round(0.3 * dot_px), 60, -1, cv2.LINE_AA)
    return page
