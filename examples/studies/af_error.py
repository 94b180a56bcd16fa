"""Error of the activating function: its thresholds beside those of a fiber model.

If the AF were all that counts, every fiber would fire at the same AF, and one
threshold would give all others. Here the flat fiber under a cathode at
`REFERENCE_MM` gives it, and each other place, fiber and polarity is predicted
from its largest AF and compared with the active cable model of `membrane`.
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
    "rising, passive ending": Fiber(end="passive"),
    "rising, active ending": Fiber(end="active"),
}


@dataclass(frozen=True)
class AfError:
    """Thresholds of one fiber at one depth: of the cable model, and as the AF predicts."""

    fiber: str  # orientation and ending
    polarity: str
    depth_mm: float  # of the fiber, or of the ending of a rising one
    cable_ma: float  # NaN if it never fires
    af_ma: float  # infinite where the AF is nowhere positive

    @property
    def ratio(self) -> float:
        """Predicted over true threshold: above 1 the AF underestimates, below it overestimates."""
        return self.af_ma / self.cable_ma


def af_error_table(profile: Profile) -> list[AfError]:
    """Return thresholds of fibers flat and rising, with either ending and polarity, at all of
    `DEPTHS_MM` under one electrode whose current returns far away."""
    found: list[tuple[str, str, float, float, float]] = []
    for name, fiber in _FIBERS.items():
        for depth_mm in DEPTHS_MM:
            potential = potential_at_nodes(profile, fiber, depth_mm)
            bend = np.diff(potential, 2)
            if fiber.end == "active":
                # McNeal's end node: current from its only neighbor, and none beyond it.
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
    """Return the potential at a fiber's nodes under the first electrode, mV per mA, (N,)."""
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
    """Return a heading, and a row of ratios by depth for each fiber and polarity, in words."""
    depths = dict.fromkeys(row.depth_mm for row in table)
    lines: dict[tuple[str, str], list[str]] = {}
    for row in table:
        ratio = "never" if row.ratio == float("inf") else f"{row.ratio:.2f}"
        lines.setdefault((row.fiber, row.polarity), []).append(ratio)
    heading = ["fiber", "polarity", *(f"{depth:g}" for depth in depths)]
    return [heading, *([*line, *ratios] for line, ratios in lines.items())]
