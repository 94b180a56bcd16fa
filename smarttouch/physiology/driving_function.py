"""Driving functions: which currents fire a fiber, linear in the currents.

A node fires where a weighted sum of the second differences of the potential at it and at
its neighbors reaches 1: the activating function, smoothed along the fiber as its membrane
does in the course of a pulse (Warman, Grill and Durand 1992; Peterson, Izad and Tyler
2011). All nodes that are far from an ending share their weights; the first few of an
ending have weights of their own. The weights are fitted to a cable model by `fiber_fit`.
"""

import json
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.errors import DesignError
from smarttouch.physiology.membrane import Fiber

Array = NDArray[np.float64]
End = Literal["through", "active", "passive"]

_SHIPPED = Path(__file__).with_name("driving.json")

FIBERS = {
    "fingertip": Fiber(terminal_um2=1850.0),
    "trunk": Fiber(diameter_um=5.7, internode_mm=0.5, terminal_um2=1850.0),
    "mrg": Fiber(diameter_um=5.7, internode_mm=0.5055746, terminal_um2=1850.0),
}
"""Fibers by name: the fingertip's (Nolano et al. 2003) and one of a nerve trunk in our own cable
model, and the MRG model. With 1850 µm² of bare terminal an upright fiber at 0.7 mm needs 1.38
times as much cathodic as anodic current; macaque RA afferents 1.3 to 1.5 (Kaczmarek 2000)."""


@dataclass(frozen=True, eq=False)
class DrivingFunction:
    """Weights that make a fiber's drive from potentials along it."""

    internode_mm: float
    end: End  # kind of the first node, as in `membrane.Fiber`
    along: Array  # (K + 1,) 1/mV, of a node and its K neighbors to either side
    near_end: Array  # (H, L) 1/mV, of the first H nodes that can fire; (0, 0) if it runs through
    # Drive of opposite sign that blocks a passing spike, over that of the node that fires: anodes
    # of long pulses do so. Infinite where none do.
    block: float = np.inf

    def drive(self, potential_mv: Array) -> Array:
        """Return the drive, (C, M, E), 1 at threshold, of potentials (C, N, E), ending first."""
        return self.operator(potential_mv.shape[-2]) @ potential_mv

    def highest(self, potential_mv: Array) -> Array:
        """Return the largest drive (C,) of a node whose spike gets out, by potentials (C, N).

        A spike blocked on its way toward the last node does not count; 0 if all are.
        """
        drive = self.drive(potential_mv[..., None])[..., 0]
        return np.asarray(np.where(passes(drive, self.block), drive, 0.0).max(axis=1))

    def operator(self, nodes: int) -> Array:
        """Return the drive as a matrix on the potentials of a number of nodes, (M, N) 1/mV."""
        bend = bend_operator(self.end, nodes)
        first = self.end == "passive"
        size = len(bend)
        smooth = np.zeros((size, size))
        for away, weight in enumerate(self.along):
            smooth += weight * np.eye(size, k=away)
            if away:
                smooth += weight * np.eye(size, k=-away)
        smooth = smooth[first:]
        for row, weights in zip(smooth, self.near_end, strict=False):
            row[:] = 0
            row[: weights.size] = weights[:size]
        return np.asarray(smooth @ bend)


def passes(drive: Array, block: float) -> NDArray[np.bool_]:
    """Return whether a spike of each node gets past the nodes after it, (C, M)."""
    against = np.maximum.accumulate(-drive[:, ::-1], axis=1)[:, ::-1]
    free = np.ones(drive.shape, np.bool_)
    if np.isfinite(block):
        free[:, :-1] = against[:, 1:] < block * drive[:, :-1]
    return free


def bend_operator(end: End, nodes: int) -> Array:
    """Return second differences along a fiber as a matrix, (B, N), and the first at an ending."""
    bends = np.diff(np.eye(nodes), 2, axis=0)
    if end == "through":
        return bends
    return np.vstack([np.eye(1, nodes, 1) - np.eye(1, nodes), bends])


@cache
def _shipped() -> dict[str, Any]:
    return dict(json.loads(_SHIPPED.read_text()))


def load_driving(fiber: str, end: End, width_us: float) -> DrivingFunction:
    """Return the driving function of one of `FIBERS`, interpolated over the logarithm of pulse
    width; DesignError if there is none."""
    offered = _shipped()
    fitted: dict[str, Any] = offered.get(fiber, {}).get(end, {})
    if not fitted:
        names = tuple(f"{name}, {each}" for name, ends in offered.items() for each in ends)
        raise DesignError(
            f"no driving function of a {fiber!r} fiber with ending {end!r}: there are those of "
            f"{'; '.join(names)}"
        )
    widths = sorted(float(each) for each in fitted)
    if not widths[0] <= width_us <= widths[-1]:
        raise DesignError(
            f"a pulse of {width_us:g} µs is outside the fitted widths of {widths[0]:g} to "
            f"{widths[-1]:g} µs: choose one within"
        )
    weights = {
        part: np.array([fitted[f"{each:g}"][part] for each in widths])
        for part in ("along", "near_end")
    }
    weights["passing"] = np.array(
        [1 / (fitted[f"{each:g}"].get("block") or np.inf) for each in widths]
    )
    at = float(np.interp(np.log(width_us), np.log(widths), np.arange(len(widths))))
    below = min(int(at), len(widths) - 2)
    along, near_end, passing = (
        (below + 1 - at) * weights[part][below] + (at - below) * weights[part][below + 1]
        for part in ("along", "near_end", "passing")
    )
    block = 1 / float(passing) if passing else np.inf
    return DrivingFunction(FIBERS[fiber].internode_mm, end, along, near_end, block)
