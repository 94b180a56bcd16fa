"""Fibers under single electrodes and kernels, to fit driving functions to and to judge them on."""

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
    """Straight fibers, each in the field of its own currents.

    Attributes
    ----------
    profile : Profile
    current_ma : ndarray, (C, E), mA
        Positive cathodic; the largest of a case is 1.
    origin_mm, direction : ndarray, (C, 3)
        Of the ending, or of the node in the middle; z points into the skin.
    group : ndarray of str, (C,)
        "single", or the class whose kernel it is.
    cathodic : ndarray of bool, (C,)
        Whether the currents are as designed, with the cathode in the middle of a single
        electrode; else they are reversed.
    """

    profile: Profile
    current_ma: Array
    origin_mm: Array
    direction: Array
    group: NDArray[np.str_]
    cathodic: NDArray[np.bool_]

    def potential_mv(self, along_mm: Array) -> Array:
        """Return the potential at places along each fiber, (C, N) mV for a current of 1 mA."""
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
    """Return the cases to fit to, or those to judge on, which share no kernel.

    Parameters
    ----------
    profile : Profile
    bank : KernelBank
        Kernels of RA and SAI: ten sites each to fit to, ten others to judge on.
    ending : bool
        Fibers that rise to an ending, up to 30° from the vertical; else flat ones that run
        through, in any direction.
    held_out : bool
        To judge on.
    seed : int
        Of sites, offsets and directions.
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
    """Return the places of a fiber's nodes along it, from its ending or to both sides, (N,)."""
    nodes = int(np.ceil(reach_mm / internode_mm))
    first = -nodes if end == "through" else 0
    return np.arange(first, nodes + 1, dtype=np.float64) * internode_mm
