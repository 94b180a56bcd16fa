"""Bank of lone discs: each electrode against all others in equal parts."""

import numpy as np

from smarttouch.base.afferent import Afferent
from smarttouch.kernels.bank import KernelBank
from smarttouch.profile import Profile


def single_bank(profile: Profile) -> KernelBank:
    """Return a bank in which each site's kernel is its electrode against all others.

    All are stored under `Afferent.RA`, whichever afferents they reach. The one electrode is anodic
    where the profile's board can, and the others share its return equally.
    """
    count = len(profile.electrodes)
    driven = profile.driven
    weights = np.zeros((count, count))
    weights[np.ix_(driven, driven)] = -1 / max(1, len(driven) - 1)
    weights[driven, driven] = 1
    if "anodic" in profile.output.polarities:
        weights = -weights
    nothing, nowhere = np.zeros(count), np.zeros((count, count), np.float32)
    each = {Afferent.RA: nothing}
    return KernelBank(
        weights={Afferent.RA: weights}, off_target=each,
        worst_class={Afferent.RA: nothing.astype(np.int8)}, spill=each, gap=each, seconds=each,
        receptor={Afferent.RA: nowhere}, discs=(Afferent.RA,),
    )  # fmt: skip
