"""What the skin makes of delivered pulses: how strongly the receptors under each site answer."""

import numpy as np
from numpy.typing import NDArray

from smarttouch.kernels.bank import KernelBank
from smarttouch.primary import Primary
from smarttouch.profile import Profile


class Perception:
    """Receptors under the electrodes, asked by their activating function.

    Each delivered slot activates the receptors under all electrodes; how much
    is the activating function at their nodes. An answer counts from the
    detection threshold on, and is 1 at the strongest comfortable pulse.

    Parameters
    ----------
    profile : Profile
        Thresholds and pulse.
    bank : KernelBank
        Its kernels, for what a full pulse does, and its receptors.
    primaries : tuple of Primary
        Whose receptors are asked; of several the one that answers most counts.
    """

    def __init__(self, profile: Profile, bank: KernelBank, primaries: tuple[Primary, ...]) -> None:
        self._pulse = profile.pulse
        full_ua = profile.full_ma * 1000
        self._receptors = []
        for primary in primaries:
            receptor = bank.receptor[primary]
            full = full_ua * (receptor * bank.kernels(primary)).sum(axis=1)
            # Masked sites have no kernel: nothing is felt there.
            self._receptors.append((receptor.T, np.where(full > 0, full, np.inf)))
        self._threshold = profile.threshold_ma / profile.full_ma

    def answers(
        self,
        numbers: NDArray[np.uint32],
        width_us: NDArray[np.float32],
        current_ua: NDArray[np.int16],
    ) -> dict[int, NDArray[np.float32]]:
        """Return the strongest answer at each site to the slots of each sequence.

        Parameters
        ----------
        numbers : ndarray, (N,)
            The sequence each slot belongs to; slots of one follow each other.
        width_us : ndarray, (N,), µs
            How long it lasted: by Weiss's law a shorter pulse does less.
        current_ua : ndarray, (N, E) int16, µA
            Delivered current, positive cathodic.

        Returns
        -------
        dict
            By number of the sequence, (E,) in [0, 1]; those without a slot are
            not in it.
        """
        if not len(numbers):
            return {}
        chronaxie_us, full_us = self._pulse.chronaxie_us, self._pulse.width_us
        strength = (1 + chronaxie_us / full_us) / (1 + chronaxie_us / np.maximum(width_us, 1))
        current = current_ua * strength[:, None].astype(np.float32)
        activation = np.maximum.reduce([current @ axons / full for axons, full in self._receptors])
        answers = np.clip((activation - self._threshold) / (1 - self._threshold), 0, 1)
        starts = np.flatnonzero(np.diff(numbers.astype(np.int64), prepend=-1))
        strongest = np.maximum.reduceat(answers, starts, axis=0)
        return dict(zip(numbers[starts].tolist(), strongest, strict=True))
