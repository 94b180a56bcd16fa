"""Arrays as rows of colored cells, in SVG, as notebooks show them: no library is needed."""

import numpy as np
from numpy.typing import NDArray

_CELL = 8
_POSITIVE, _NEGATIVE = (179, 88, 6), (84, 39, 136)
"""Orange is positive, so cathodic, purple anodic, as in all figures."""
_MOST = 20_000
"""Most cells that are drawn."""


def cells_svg(rows: NDArray[np.generic], names: tuple[str, ...] = ()) -> str:
    """Return signed values, (R, C), as cells, the darker the larger; a name stands before each row."""
    values = np.nan_to_num(np.atleast_2d(rows).astype(np.float64))[
        : max(1, _MOST // rows.shape[-1])
    ]
    most = np.abs(values).max(initial=0) or 1.0
    height, columns = values.shape
    left = 40 if names else 0
    drawn = [
        f'<text x="0" y="{(row + 1) * _CELL - 1}" font-size="{_CELL}">{name}</text>'
        for row, name in enumerate(names)
    ]
    for row, column in np.argwhere(values):
        value = values[row, column] / most
        red, green, blue = _POSITIVE if value > 0 else _NEGATIVE
        drawn.append(
            f'<rect x="{left + column * _CELL}" y="{row * _CELL}" width="{_CELL}" '
            f'height="{_CELL}" fill="rgb({red},{green},{blue})" fill-opacity="{abs(value):.2f}"/>'
        )
    size = f'width="{left + columns * _CELL}" height="{height * _CELL}"'
    frame = (
        f'<rect x="{left}" y="0" width="{columns * _CELL}" height="{height * _CELL}" '
        'fill="none" stroke="#707070" stroke-width="0.5"/>'
    )
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" {size} style="max-width:100%" '
        f'fill="currentColor">{"".join(drawn)}{frame}</svg>'
    )


def titled(title: str, *parts: str) -> str:
    """Return HTML of a title above its parts."""
    return f"<div><p>{title}</p>{''.join(f'<p>{part}</p>' for part in parts)}</div>"
