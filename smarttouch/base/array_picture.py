"""Pictures of electrodes and arrays: one set of colors, discs for pictures, cells for notebooks."""

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.electrodes import ElectrodeArray

CATHODIC, ANODIC = (179, 88, 6), (84, 39, 136)
"""Orange is cathodic (positive), purple anodic: the ends of Matplotlib's PuOr, in which no class of
afferents is drawn."""
EDGE = (139, 152, 164)
_CELL_PX = 8
_MOST_CELLS = 20_000
_RADIUS = 0.42

Colors = NDArray[np.uint8]


def hex_color(color: tuple[int, int, int]) -> str:
    """Return a color as ``#rrggbb``."""
    return "#{:02x}{:02x}{:02x}".format(*color)


def disc_radius_mm(electrodes: ElectrodeArray) -> float:
    """Return the radius with which electrodes are drawn, whatever their shape."""
    return _RADIUS * min(*electrodes.cell_mm, electrodes.pitch_mm)


class ElectrodePicture:
    """Draws electrodes as discs on white, in a color of each, (E, 3)."""

    def __init__(self, electrodes: ElectrodeArray, px_per_mm: float) -> None:
        # It takes a third of a second to import, and cells need none of it.
        from scipy.spatial import cKDTree

        half = [max(1, round(each * px_per_mm / 2)) for each in electrodes.extent_mm]
        x, y = ((np.arange(2 * each) - each + 0.5) / px_per_mm for each in half)
        away, nearest = cKDTree(electrodes.position_mm).query(np.stack(np.meshgrid(x, y), axis=-1))
        self._nearest = np.asarray(nearest)
        beyond_mm = np.asarray(away, np.float32)[..., None] - disc_radius_mm(electrodes)
        beyond_px = (beyond_mm * px_per_mm).astype(np.float32)
        self._disc = np.clip(0.5 - beyond_px, 0, 1)
        self._edge = np.clip(1 - np.abs(beyond_px), 0, 1)

    def raster(self, colors: Colors) -> NDArray[np.uint8]:
        """Return the picture as pixels, (H, W, 3) in RGB."""
        image = 255 - (255 - colors.astype(np.float32))[self._nearest] * self._disc
        image += (np.array(EDGE, np.float32) - image) * self._edge
        return np.asarray(np.rint(image), np.uint8)


def cells_svg(rows: NDArray[np.generic], names: tuple[str, ...] = ()) -> str:
    """Return signed values, (R, C), as cells, the darker the larger; a name stands before each row.

    NaN is drawn as zero.
    """
    values = np.nan_to_num(np.atleast_2d(rows).astype(np.float64))[
        : max(1, _MOST_CELLS // rows.shape[-1])
    ]
    most = np.abs(values).max(initial=0) or 1.0
    height, columns = values.shape
    left = 40 if names else 0
    drawn = [
        f'<text x="0" y="{(row + 1) * _CELL_PX - 1}" font-size="{_CELL_PX}">{name}</text>'
        for row, name in enumerate(names)
    ]
    for row, column in np.argwhere(values):
        value = values[row, column] / most
        red, green, blue = CATHODIC if value > 0 else ANODIC
        drawn.append(
            f'<rect x="{left + column * _CELL_PX}" y="{row * _CELL_PX}" width="{_CELL_PX}" '
            f'height="{_CELL_PX}" fill="rgb({red},{green},{blue})" '
            f'fill-opacity="{abs(value):.2f}"/>'
        )
    size = f'width="{left + columns * _CELL_PX}" height="{height * _CELL_PX}"'
    frame = (
        f'<rect x="{left}" y="0" width="{columns * _CELL_PX}" height="{height * _CELL_PX}" '
        'fill="none" stroke="#707070" stroke-width="0.5"/>'
    )
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" {size} style="max-width:100%" '
        f'fill="currentColor">{"".join(drawn)}{frame}</svg>'
    )


def titled(title: str, *parts: str) -> str:
    """Return HTML of a title above its parts."""
    return f"<div><p>{title}</p>{''.join(f'<p>{part}</p>' for part in parts)}</div>"
