"""Banks of lone discs: each electrode against all others in equal parts."""

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import DesignError
from smarttouch.kernels.bank import KernelBank
from smarttouch.profile import Profile


def single_bank(profile: Profile) -> KernelBank:
    """Return a bank in which each site's kernel is its electrode against all others.

    All are stored under `Afferent.RA`, whichever afferents they reach. The one electrode is anodic
    where the profile's board can, and the others share its return equally.
    """
    count = len(profile.electrodes)
    weights = _cathodic_discs(profile)
    if "anodic" in profile.output.polarities:
        weights = -weights
    nothing, nowhere = np.zeros(count), np.zeros((count, count), np.float32)
    each = {Afferent.RA: nothing}
    return KernelBank(
        weights={Afferent.RA: weights}, off_target=each,
        worst_class={Afferent.RA: nothing.astype(np.int8)}, spill=each, gap=each, seconds=each,
        receptor={Afferent.RA: nowhere}, discs=(Afferent.RA,),
    )  # fmt: skip


def lone_discs(profile: Profile, bank: KernelBank) -> KernelBank:
    """Return a bank with single electrodes against all others in place of SAI, where they are
    cathodic, and of PC, where they are anodic; for stimuli that name their class (mode color)."""
    if len(profile.output.polarities) < 2:
        raise DesignError(
            f"{profile.name} drives its electrodes {profile.output.polarities[0]} only, and two "
            "polarities are to be compared: choose another profile"
        )
    cathodic = _cathodic_discs(profile)
    discs = {Afferent.SAI: cathodic, Afferent.PC: -cathodic}
    nothing = dict.fromkeys(discs, np.zeros(len(cathodic)))
    nowhere = dict.fromkeys(discs, np.zeros(cathodic.shape, np.float32))
    return KernelBank(
        weights=bank.weights | discs,
        off_target=bank.off_target | nothing,
        worst_class=bank.worst_class | {each: nothing[each].astype(np.int8) for each in discs},
        spill=bank.spill | nothing,
        gap=bank.gap | nothing,
        seconds=bank.seconds | nothing,
        receptor=bank.receptor | nowhere,
        absolute=bank.absolute,
        discs=tuple(discs),
    )


def _cathodic_discs(profile: Profile) -> NDArray[np.float64]:
    """Return each driven electrode, cathodic, against all others in equal parts, (E, E)."""
    count, driven = len(profile.electrodes), profile.driven
    weights = np.zeros((count, count))
    weights[np.ix_(driven, driven)] = -1 / max(1, len(driven) - 1)
    weights[driven, driven] = 1
    return weights
