"""Fibers under single electrodes and under kernels: cases for fitting and testing predictions."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.afferent import Afferent
from smarttouch.kernels.bank import KernelBank
from smarttouch.physiology.activating_function import potential_mv
from smarttouch.profile import Profile

Array = NDArray[np.float64]

DEPTHS_MM = (0.5, 0.7, 0.9, 1.4, 2.0)
_BESIDE_MM = (0.0, 0.5, 1.0, 2.0)
_NEAR_MM = 1.0
_LEAN_DEG = 30.0
_KERNELS = 10


@dataclass(frozen=True, eq=False)
class FiberCases:
    """Straight fibers, each with the currents of all electrodes above it.

    Attributes
    ----------
    profile : Profile
    current_ma : ndarray, (C, E), mA
        Currents of each case, positive cathodic; the strongest is 1 or -1.
    origin_mm : ndarray, (C, 3)
        Position of the ending, or of the middle node if the fiber has no ending.
    direction : ndarray, (C, 3)
        Unit vector along the fiber. z points into the skin.
    group : ndarray of str, (C,)
        "single" if one electrode carries current, or the class of the kernel.
    cathodic : ndarray of bool, (C,)
        True for a kernel as designed and for a single cathode; false for reversed currents.
    """

    profile: Profile
    current_ma: Array
    origin_mm: Array
    direction: Array
    group: NDArray[np.str_]
    cathodic: NDArray[np.bool_]

    def potential_mv(self, along_mm: Array) -> Array:
        """Return the potential of each fiber at these distances along it, (C, N) mV at 1 mA."""
        found = []
        for origin, direction, current in zip(
            self.origin_mm, self.direction, self.current_ma, strict=True
        ):
            points = origin + along_mm[:, None] * direction
            found.append(potential_mv(self.profile, points) @ current)
        return np.array(found)

    def __getitem__(self, which: NDArray[np.bool_]) -> "FiberCases":
        return FiberCases(
            self.profile,
            self.current_ma[which],
            self.origin_mm[which],
            self.direction[which],
            self.group[which],
            self.cathodic[which],
        )


def cases(
    profile: Profile, bank: KernelBank, ending: bool, held_out: bool, seed: int = 1
) -> FiberCases:
    """Return cases for fitting or for testing; no kernel is in both sets of cases.

    Parameters
    ----------
    profile : Profile
    bank : KernelBank
        Kernels of RA and SAI. Of each class, ten sites are for fitting and ten for testing.
    ending : bool
        If true, fibers are upright, up to 30° from the vertical, with an ending at the top. If
        false, they are horizontal, in any direction, without an ending.
    held_out : bool
        Whether to return the cases for testing.
    seed : int
        Seed of sites, offsets and directions.
    """
    random = np.random.default_rng([seed, ending, held_out])
    count, places = len(profile.electrodes), profile.electrodes.position_mm
    patterns: list[tuple[str, Array, Array]] = []
    middle = int(np.linalg.norm(places, axis=1).argmin())
    for beside in _BESIDE_MM:
        patterns.append(("single", np.eye(count)[middle], places[middle] + (0, beside)))
    for afferent in (Afferent.RA, Afferent.SAI):
        shuffled = np.random.default_rng([seed, int(afferent)]).permutation(profile.driven)
        for site in shuffled[_KERNELS * held_out :][:_KERNELS]:
            kernel = np.asarray(bank.kernels(afferent)[site], np.float64)
            for _ in range(2):
                away = random.uniform(-_NEAR_MM, _NEAR_MM, 2)
                patterns.append((afferent.name, kernel, places[site] + away))
    current, origin, direction, group, cathodic = [], [], [], [], []
    for name, pattern, place in patterns:
        for depth in DEPTHS_MM:
            for sign in (1.0, -1.0):
                turn = 0.0 if name == "single" else random.uniform(0, 2 * np.pi)
                lean = np.pi / 2
                if ending:
                    lean = 0.0 if name == "single" else np.radians(_LEAN_DEG) * random.random()
                sin = np.sin(lean)
                current.append(sign * pattern)
                origin.append((*place, depth))
                direction.append((sin * np.cos(turn), sin * np.sin(turn), np.cos(lean)))
                group.append(name)
                cathodic.append(sign > 0)
    return FiberCases(
        profile,
        np.array(current),
        np.array(origin),
        np.array(direction),
        np.array(group),
        np.array(cathodic),
    )


End = Literal["through", "active", "passive"]


def along_mm(end: End, internode_mm: float, reach_mm: float = 8.0) -> Array:
    """Return the distance of each node from the ending or from the middle node, (N,) mm."""
    nodes = int(np.ceil(reach_mm / internode_mm))
    first = -nodes if end == "through" else 0
    return np.arange(first, nodes + 1, dtype=np.float64) * internode_mm
