"""Afferents that a display must not fire: SAII, and the free endings of Aδ and C fibers.

They are drawn as the others of a finger are, from the same anatomy and with seeds of their own.
Free endings are a sample: each stands for the same number of its class.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from smarttouch.physiology.anatomy import Anatomy, Bystander, load_anatomy
from smarttouch.physiology.finger import Finger
from smarttouch.physiology.spikes import Slots, SpikeModel
from smarttouch.profile import Profile

NOCICEPTORS = (Bystander.A_DELTA, Bystander.C)


class Bystanders(Finger):
    """Afferents of one finger that must not fire; see `Finger` for parameters."""

    def __init__(
        self, profile: Profile, seed: int = 1, anatomy: str | Path | Anatomy = "branched"
    ) -> None:
        self.profile, self.seed = profile, seed
        self.anatomy = anatomy if isinstance(anatomy, Anatomy) else load_anatomy(anatomy)
        self.populations = {
            each: self._populate(each, anatomy) for each, anatomy in self.anatomy.bystanders.items()
        }

    @cached_property
    def model(self) -> SpikeModel:
        """Their drives."""
        return SpikeModel(self)


@dataclass(frozen=True)
class Margin:
    """Distance of a class from firing."""

    margin: float  # factor on all currents from which one of the sample fires; infinite if none can
    fired: float  # fraction of the sample that fires in any slot


def margins(others: Bystanders, shown: Sequence[Slots]) -> dict[Bystander, Margin]:
    """Return the margin of each class under all of some sequences, as they are delivered."""
    highest = np.zeros(len(others.classes), np.float32)
    for slots in shown:
        drive = others.model.drive(slots.current_ua, slots.width_us)
        highest = np.maximum(highest, drive.max(axis=1, initial=0.0))
    found = {}
    for index, each in enumerate(others.populations):
        mine = highest[others.classes == index]
        most = float(mine.max(initial=0.0))
        found[each] = Margin(
            1 / most if most else np.inf, float((mine >= 1).sum() / max(1, mine.size))
        )
    return found


def nociceptive_margin(found: dict[Bystander, Margin]) -> float:
    """Return the smaller margin of Aδ and C; infinite if there are none."""
    return min((found[each].margin for each in NOCICEPTORS if each in found), default=np.inf)
