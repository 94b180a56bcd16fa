"""Error of thresholds that are predicted by the activating function (AF).

If the AF were enough, all fibers would fire at the same AF. Here this AF is taken from a flat fiber
`REFERENCE_MM` below a cathode. The AF then predicts the threshold of every fiber, depth and
polarity. These thresholds are compared with those of the active cable model in `membrane`.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.errors import DesignError
from smarttouch.physiology.activating_function import field_at
from smarttouch.physiology.membrane import Fiber, threshold_ma
from smarttouch.profile import Profile

DEPTHS_MM = (0.5, 0.7, 0.9, 1.4, 2.0)
REFERENCE_MM = 0.9
_WIDTH_US = 200.0
_NODES = 161

_FIBERS = {
    "flat fiber": Fiber(end="through"),
    "upright, passive ending": Fiber(end="passive"),
    "upright, active ending": Fiber(end="active"),
}


@dataclass(frozen=True)
class AfError:
    """Threshold of a fiber at one depth, by the cable model and as predicted by the AF."""

    fiber: str  # orientation and ending
    polarity: str
    depth_mm: float  # depth of a flat fiber, or of the ending of an upright fiber
    cable_ma: float  # threshold of the cable model; NaN if the fiber never fires
    af_ma: float  # predicted threshold; infinite if the AF is not positive at any node

    @property
    def ratio(self) -> float:
        """Predicted threshold relative to that of the cable model."""
        return self.af_ma / self.cable_ma


def af_error_table(profile: Profile) -> list[AfError]:
    """Return thresholds for each kind of fiber, polarity and depth of `DEPTHS_MM`, under one
    electrode whose current returns far away."""
    found: list[tuple[str, str, float, float, float]] = []
    for name, fiber in _FIBERS.items():
        for depth_mm in DEPTHS_MM:
            potential = potential_at_nodes(profile, fiber, depth_mm)
            bend = np.diff(potential, 2)
            if fiber.end == "active":
                # The end node has one neighbor, so a first difference of the potential drives it.
                bend = np.append(bend, potential[1] - potential[0])
            for polarity, sign in (("cathodic", 1.0), ("anodic", -1.0)):
                strongest = max(float((sign * bend).max()), 0.0)
                try:
                    cable = threshold_ma(potential, fiber, _WIDTH_US, cathodic=sign > 0)
                except DesignError:
                    cable = np.nan
                found.append((name, polarity, depth_mm, cable, strongest))
    firing = next(
        cable * strongest
        for name, polarity, depth_mm, cable, strongest in found
        if (name, polarity, depth_mm) == ("flat fiber", "cathodic", REFERENCE_MM)
    )
    return [
        AfError(name, polarity, depth_mm, cable, firing / strongest if strongest else np.inf)
        for name, polarity, depth_mm, cable, strongest in found
    ]


def potential_at_nodes(profile: Profile, fiber: Fiber, depth_mm: float) -> NDArray[np.float64]:
    """Return the potentials at the nodes of a fiber under the first electrode, (N,) mV per mA."""
    center = profile.electrodes.position_mm[0]
    spaced = np.arange(_NODES) * fiber.internode_mm
    if fiber.end == "through":
        away = spaced - spaced[_NODES // 2]
        here, scale = field_at(
            profile.electrodes,
            profile.skin,
            center + np.column_stack([away, np.zeros(_NODES)]),
            depth_mm,
        )
        return np.asarray(1000 * scale * here.potential[:, 0])
    values = []
    for depth in depth_mm + spaced[: _NODES // 2]:
        here, scale = field_at(profile.electrodes, profile.skin, center[None], float(depth))
        values.append(1000 * scale * float(here.potential[0, 0]))
    return np.array(values)


def ratio_rows(table: Sequence[AfError]) -> list[list[str]]:
    """Return a heading and, for each fiber and polarity, a row with the ratio at each depth."""
    depths = dict.fromkeys(row.depth_mm for row in table)
    lines: dict[tuple[str, str], list[str]] = {}
    for row in table:
        ratio = "never" if row.ratio == float("inf") else f"{row.ratio:.2f}"
        lines.setdefault((row.fiber, row.polarity), []).append(ratio)
    heading = ["fiber", "polarity", *(f"{depth:g}" for depth in depths)]
    return [heading, *([*line, *ratios] for line, ratios in lines.items())]
