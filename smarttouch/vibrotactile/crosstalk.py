"""Crosstalk of PC stimulation into the classes above it, RA and SAI.

PC lies below RA and SAI, and no current from the skin reaches it alone (paper, Section II-D;
the best kernels that there are do more to another class than to PC, `smarttouch.kernels`).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smarttouch.afferent import Afferent
from smarttouch.kernels.bank import KernelBank
from smarttouch.profile import Profile
from smarttouch.vibrotactile.sites import stimulated


@dataclass(frozen=True, eq=False)
class PacinianCrosstalk:
    """Crosstalk of PC pulses into other classes."""

    # (S,) float64: activating function at the worst node of another class over that at PC's, by
    # electrode
    times: NDArray[np.float64]
    worst: tuple[Afferent, ...]  # (S,): class of that node

    @property
    def mean(self) -> float:
        """Mean of ``times`` over the electrodes."""
        return float(self.times.mean())

    def __str__(self) -> str:
        names = " or ".join(each.name for each in Afferent if each in self.worst)
        return (
            f"PC pulses also reach {names}, {self.mean:.1f} times as strongly as PC (mean of "
            f"{len(self.times)} electrodes, at most {self.times.max():.1f}): current cannot drive "
            "PC alone"
        )


def pacinian_crosstalk(
    profile: Profile, bank: KernelBank, sites: NDArray[np.intp]
) -> PacinianCrosstalk | None:
    """Return the crosstalk of PC stimulation at sites, (S,); None where it cannot be driven."""
    places = stimulated(profile, Afferent.PC, sites)
    if Afferent.PC not in bank.weights or not len(places):
        return None
    worst = tuple(Afferent(int(each)) for each in bank.worst_class[Afferent.PC][places])
    return PacinianCrosstalk(np.asarray(bank.off_target[Afferent.PC][places], np.float64), worst)
