"""Recovery of the class of each delivered pulse from its current alone."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smarttouch.kernels.bank import KernelBank
from smarttouch.profile import Profile


@dataclass(frozen=True, eq=False)
class Recovered:
    """Recovered classes of pulses, one by one, each (N,): class and site of the likeliest kernel,
    the activation that leads to such a current at full intensity (below 0 where weaker
    than the threshold), and the cosine between current and kernel, 1 but for whole microamperes.
    """

    afferent: NDArray[np.int8]
    site: NDArray[np.intp]
    drive: NDArray[np.float32]
    likeness: NDArray[np.float32]


def recover(current_ua: NDArray[np.int16], profile: Profile, bank: KernelBank) -> Recovered:
    """Return the class and site of each pulse as delivered, (N, E) µA, positive cathodic."""
    classes = sorted(bank.weights)
    kernels = np.concatenate([bank.kernels(each) for each in classes])
    size = np.linalg.norm(kernels, axis=1)
    current = current_ua.astype(np.float32)
    along = current @ (kernels / np.where(size > 0, size, np.inf)[:, None]).T
    best = along.argmax(axis=1)
    strength = np.take_along_axis(along, best[:, None], axis=1)[:, 0]
    count = len(profile.electrodes)
    site = best % count
    level = strength / size[best] / (profile.full_ma[site] * 1000)
    faintest = (profile.threshold_ma / profile.full_ma)[site]
    length = np.linalg.norm(current, axis=1)
    return Recovered(
        np.array(classes, np.int8)[best // count],
        site,
        np.asarray((level - faintest) / (1 - faintest), np.float32),
        np.asarray(strength / np.where(length > 0, length, np.inf), np.float32),
    )
