"""Pulse trains on sites of an array: the stimuli of a trial's intervals."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from smarttouch.afferent import Afferent
from smarttouch.errors import ExperimentError
from smarttouch.profile import Profile

FEWEST_PULSES = 2
"""Fewest pulses that have a frequency."""
LONGEST_S = 60.0


@dataclass(frozen=True, eq=False)
class Train:
    """Train of pulses at one frequency."""

    # (3, E) float32, in [0, 1]: one row for each `Afferent`; all zero is a blank of the same length
    activation: NDArray[np.float32]
    period_us: int  # from pulse to pulse
    pulses: int  # it ends one period after the last
    # in [0, 1]: of the strongest comfortable current, on top of what the user wishes
    level: float = 1.0
    rises: bool = False  # whether it rises to that level evenly from nothing, over its whole length
    soft_s: float = 0.0  # time in which it rises to that level; 0 is at once
    # (3, E) float32: activation of the train that this one is the blank of
    blanked: NDArray[np.float32] | None = None

    @property
    def rate_hz(self) -> float:
        return 1e6 / self.period_us

    def blank(self) -> "Train":
        """Return the same train without current."""
        # Its level stays where the train begins: without current none would rise.
        return replace(
            self,
            activation=np.zeros_like(self.activation),
            level=self.level_at(0),
            soft_s=0.0,
            blanked=self.activation,
        )

    def level_at(self, pulse: int) -> float:
        """Return the level of a pulse, counted from 0."""
        if self.rises:
            return self.level * (pulse + 1) / self.pulses
        risen_s = (pulse + 1) * self.period_us / 1e6
        return self.level * min(1.0, risen_s / self.soft_s) if self.soft_s else self.level


class Stimuli:
    """Factory of trains of one length for one class of afferents."""

    def __init__(self, profile: Profile, afferent: Afferent, train_s: float) -> None:
        if not 0 < train_s <= LONGEST_S:
            raise ExperimentError(
                f"trains of {train_s:g} s must be above 0 and at most {LONGEST_S:g} s long",
                about="train_s",
            )
        self.profile, self.afferent, self.train_s = profile, afferent, train_s

    def train(self, where: Sequence[int] | NDArray[np.float32], rate_hz: float) -> Train:
        """Return a train on some sites, or with an activation of each, (E,)."""
        limit_hz = self.profile.limits.rate_hz
        if not 0 < rate_hz <= limit_hz:
            raise ExperimentError(
                f"pulses at {rate_hz:g} Hz are not possible: the frequency must be above 0 and at "
                f"most the profile's limit of {limit_hz:g} Hz",
                about="rate_hz",
            )
        pulses = round(self.train_s * rate_hz)
        if pulses < FEWEST_PULSES:
            raise ExperimentError(
                f"{self.train_s:g} s at {rate_hz:g} Hz are {pulses} pulses, fewer than the "
                f"{FEWEST_PULSES} that make a frequency: make trains longer",
                about="train_s",
            )
        activation = np.zeros((len(Afferent), len(self.profile.electrodes)), np.float32)
        if isinstance(where, np.ndarray):
            activation[self.afferent] = where
        else:
            activation[self.afferent, list(where)] = 1
        return Train(activation, round(1e6 / rate_hz), pulses)

    @property
    def middle(self) -> int:
        """Driven site nearest to the middle of the array."""
        return self.nearest((0.0, 0.0))

    def nearest(self, place_mm: Sequence[float] | NDArray[np.float64]) -> int:
        """Return the driven site that is nearest to a place, (x, y) mm."""
        driven = self.profile.driven
        away_mm = self.profile.electrodes.position_mm[driven] - place_mm
        return int(driven[np.hypot(*away_mm.T).round(6).argmin()])

    def beside(self, site: int) -> dict[float, int]:
        """Return the other driven sites on the same row, by their offset to the right, mm."""
        place_mm = self.profile.electrodes.position_mm
        away_mm = place_mm[self.profile.driven] - place_mm[site]
        return {
            round(float(right), 3): int(other)
            for other, (right, down) in zip(self.profile.driven, away_mm, strict=True)
            if abs(down) < 1e-3 and abs(right) > 1e-3
        }

    def pairs(self) -> dict[float, tuple[int, int]]:
        """Return two sites beside each other around the middle, by their distance, mm."""
        place_mm = self.profile.electrodes.position_mm
        found: dict[float, tuple[float, tuple[int, int]]] = {}
        for left in self.profile.driven.tolist():
            for far_mm, right in self.beside(left).items():
                off_mm = float(np.hypot(*(place_mm[left] + place_mm[right]))) / 2
                if far_mm > 0 and off_mm < found.get(far_mm, (np.inf,))[0] - 1e-6:
                    found[far_mm] = off_mm, (left, right)
        return {far_mm: found[far_mm][1] for far_mm in sorted(found)}


def require_site(site: int | None, profile: Profile) -> None:
    """Raise an `ExperimentError` unless a site is driven; None is the middle."""
    if site is not None and site not in profile.driven:
        raise ExperimentError(
            f"site {site} is masked or none of the {len(profile.electrodes)} sites of "
            f"{profile.name}: leave it out for the middle",
            about="site",
        )
