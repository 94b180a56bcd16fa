"""Fast fields of currents in all electrodes at every node, and figures of a slot.

On a grid of equal electrodes the activating function at a node depends on its
displacement from each electrode only. That kernel is smooth, so a few products
of a function of x and a function of y make it up: the field of a whole frame is
two small matrix products instead of one with every node's row, and neither
memory nor time grows with nodes times electrodes. Other arrays keep all rows.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.errors import DesignError
from smarttouch.physiology.activating_function import Afferents, af_matrix
from smarttouch.profile import Profile
from smarttouch.profile.layouts import FreeLayout

Array = NDArray[np.float64]
Single = NDArray[np.float32]

TOLERANCE = 1e-4  # error of a kernel approximated by products, as a part of its largest value
_MOST_DISTINCT = 2500  # displacements along an axis beyond which products are not used
_ROUND_MM = 6


class FieldMap:
    """AF rows of N places with D directions each, in `af_matrix`'s order, not stored on a grid."""

    def __init__(self, profile: Profile, afferents: Afferents) -> None:
        self.directions_n: int = len(afferents.direction)
        self.places_n: int = len(afferents.position_mm)
        self.rows_n: int = self.directions_n * self.places_n
        self.grid: tuple[int, int] = afferents.grid
        self._electrodes_n = len(profile.electrodes)
        made = _products(profile, afferents)
        self.separable: bool = made is not None
        if made is None:
            self._dense = np.asarray(af_matrix(profile, afferents), np.float32)
        else:
            self._down, self._across, self._place = made
            self._high, self._rank = self._down.shape[1:]
            self._left = np.ascontiguousarray(self._down.reshape(len(self._down), -1))
            self._right = np.ascontiguousarray(self._across.reshape(len(self._across), -1))
            self._in_order = np.array_equal(self._place, np.arange(self._electrodes_n))

    def __call__(self, current: NDArray[np.floating]) -> Single:
        """Return the activating function, (F, D·N) V/mm², of currents (F, E) mA."""
        current = np.asarray(current, np.float32)
        if not self.separable:
            return np.asarray(current @ self._dense.T)
        count = len(current)
        square = current
        if not self._in_order:
            square = np.empty_like(current)
            square[:, self._place] = current
        across = square.reshape(count * self._high, -1) @ self._right
        stacked = across.reshape(count, self._high * self._rank, -1)
        return np.asarray((self._left @ stacked).reshape(count, self.rows_n))

    def gram(self) -> Array:
        """Return the sum of all rows' outer products, (E, E)."""
        if not self.separable:
            dense = self._dense.astype(np.float64)
            return np.asarray(dense.T @ dense)
        left, right = self._left.astype(np.float64), self._across.astype(np.float64)
        high, rank, wide = self._high, self._rank, len(right)
        lines = (left.T @ left).reshape(high, rank, high, rank)
        columns = np.einsum("xrn,vsn->xvrs", right, right, optimize=True)
        both = lines.transpose(0, 2, 1, 3).reshape(high * high, -1) @ (
            columns.reshape(wide * wide, -1).T
        )
        square = both.reshape(high, high, wide, wide).transpose(0, 2, 1, 3)
        square = square.reshape(high * wide, high * wide)
        return np.asarray(square[np.ix_(self._place, self._place)])


def _products(
    profile: Profile, afferents: Afferents
) -> tuple[Single, Single, NDArray[np.intp]] | None:
    """Return factors (D·Y, y, R) and (x, R, X), and each electrode's place in (y, x); or None."""
    position, (lines, columns) = profile.electrodes.position_mm, afferents.grid
    x, ix = np.unique(position[:, 0].round(_ROUND_MM), return_inverse=True)
    y, iy = np.unique(position[:, 1].round(_ROUND_MM), return_inverse=True)
    if len(x) * len(y) != len(position) or min(len(x), len(y), lines, columns) < 2:
        return None
    node = afferents.position_mm.reshape(lines, columns, 2)
    dx, at_x = np.unique((node[0, :, 0] - x[:, None]).round(_ROUND_MM), return_inverse=True)
    dy, at_y = np.unique((node[:, 0, 1][:, None] - y).round(_ROUND_MM), return_inverse=True)
    if max(len(dx), len(dy)) > _MOST_DISTINCT:
        return None
    kernel = _kernel(profile, afferents, dx, dy)
    count = len(afferents.direction)
    left, size, right = np.linalg.svd(kernel.reshape(-1, len(dx)), full_matrices=False)
    left = left * size
    rest, rank = kernel.reshape(-1, len(dx)).copy(), 0
    while np.abs(rest).max() > TOLERANCE * np.abs(kernel).max() and rank < len(size):
        rest -= np.outer(left[:, rank], right[rank])
        rank += 1
    down = left[:, :rank].reshape(count, len(dy), rank)[:, at_y.reshape(lines, len(y))]
    across = right[:rank][:, at_x.reshape(len(x), columns)].transpose(1, 0, 2)
    return (
        np.ascontiguousarray(down.reshape(count * lines, len(y), rank), np.float32),
        np.ascontiguousarray(across, np.float32),
        iy * len(x) + ix,
    )


def _kernel(profile: Profile, afferents: Afferents, dx: Array, dy: Array) -> Array:
    """Return the field of one electrode at all displacements, (D, dy, dx)."""
    array = profile.electrodes
    if len(array.kinds) > 1:
        raise DesignError(
            f"whole frames need electrodes of one shape, and this array has {len(array.kinds)}: "
            "give points slots of their own"
        )
    # One electrode is no array: the second one's column is not used.
    half = array.pitch_mm
    pair = FreeLayout(
        layout="free",
        positions_mm=((-half, 0.0), (half, 0.0)),
        shape=array.shape,
        size_mm=array.size_mm,
    )
    alone = Profile.model_construct(**(dict(profile) | {"array": pair}))
    x, y = np.meshgrid(dx - half, dy)
    there = replace(afferents, position_mm=np.column_stack([x.ravel(), y.ravel()]), grid=x.shape)
    return af_matrix(alone, there)[:, 0].reshape(len(afferents.direction), len(dy), len(dx))


@dataclass(frozen=True)
class FrameFigures:
    """Figures of one slot; activations are relative to the weakest target's, scaled to level 1."""

    off_target: float  # largest activation of any other class
    spill: float  # largest activation of the own class more than a pitch from every target
    weakest: float  # least activation of a target, over its wish
    strongest: float  # most activation of a target, over its wish
    total_ma: float  # of all cathodes together
    electrode_ma: float  # of the strongest electrode


@dataclass(frozen=True)
class FrameBounds:
    """Bounds on the side effects of a slot; impossible ones raise a DesignError.

    0.30 is what a single SAI point reaches on the paper's line array, by its own program. All
    targets may be weaker together by `uneven`, which saves current.
    """

    other: float = 0.30  # of `FrameFigures.off_target`
    spill: float = 0.30  # of `FrameFigures.spill`
    uneven: float = 0.05  # largest relative deviation of a target from its wish

    def __post_init__(self) -> None:
        for name, value in (("other", self.other), ("spill", self.spill), ("uneven", self.uneven)):
            most = 1 if name == "uneven" else np.inf
            if not 0 < value < most:
                raise DesignError(
                    f"bound {name} = {value} of a frame must be above 0, uneven below 1"
                )
