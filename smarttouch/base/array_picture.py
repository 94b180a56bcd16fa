"""Pictures of arrays as cells, for notebooks."""

import numpy as np
from numpy.typing import NDArray

CATHODIC, ANODIC = "#b35806", "#542788"
"""Orange is cathodic (positive), purple anodic: the ends of Matplotlib's PuOr, in which no class of
afferents is drawn."""
_CELL_PX = 8
_MOST_CELLS = 20_000


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
        drawn.append(
            f'<rect x="{left + column * _CELL_PX}" y="{row * _CELL_PX}" width="{_CELL_PX}" '
            f'height="{_CELL_PX}" fill="{CATHODIC if value > 0 else ANODIC}" '
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
