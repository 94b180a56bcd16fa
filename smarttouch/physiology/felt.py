"""Measures of what a pattern fired in a finger: silent points, other classes, other places."""

from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass
from math import isnan, nan
from typing import Any

import numpy as np
from numpy.typing import NDArray

from smarttouch.afferent import CLASS_COLORS, Afferent
from smarttouch.physiology.finger import Finger


@dataclass(frozen=True)
class Felt:
    """What a pattern fired in a finger."""

    spikes: int  # of all classes
    afferents: dict[Afferent, int]  # number that fired, of each class
    # fraction of active electrodes without a firing receptor of a wanted class within half a pitch
    silent_points: float
    wrong_class: float  # fraction of spikes of other classes; NaN without a spike
    # fraction of spikes with a receptor beyond a pitch of every active electrode; or NaN
    misplaced: float


def felt(
    finger: Finger,
    counts: NDArray[np.intp],
    active: NDArray[np.bool_],
    wanted: Collection[Afferent],
) -> Felt:
    """Return what spike counts (A,) mean for active electrodes (E,) and the classes wanted."""
    electrodes = finger.profile.electrodes
    places = electrodes.position_mm[active]
    fired = counts > 0
    right = np.isin(finger.classes, [int(each) for each in wanted])
    away = np.linalg.norm(finger.receptor_mm[:, None] - places, axis=2)
    near = away <= electrodes.pitch_mm
    reached = ((away <= electrodes.pitch_mm / 2) & (fired & right)[:, None]).any(axis=0)
    total = int(counts.sum())
    share = 1 / total if total else nan
    return Felt(
        total,
        {each: int((fired & (finger.classes == each)).sum()) for each in Afferent},
        float(1 - reached.mean()) if len(places) else 0.0,
        float(counts[~right].sum() * share),
        float(counts[~near.any(axis=1)].sum() * share),
    )


def over(how: Callable[[list[float]], float], values: Iterable[float]) -> float:
    """Return a mean or median of the values that are numbers; NaN if none is."""
    numbers = [each for each in values if not isnan(each)]
    return how(numbers) if numbers else nan


def felt_map(
    finger: Finger, counts: NDArray[np.intp], places_mm: NDArray[np.float64], blur_mm: float = 1.0
) -> NDArray[np.float32]:
    """Return spikes of each class around places (P, 2) mm, (3, P), blurred by the standard
    deviation of a receptive field. Ours."""
    fired = counts > 0
    away = places_mm[None] - finger.receptor_mm[fired, None]
    weight = np.exp(-(away**2).sum(axis=2) / (2 * blur_mm**2)) * counts[fired, None]
    classes = finger.classes[fired]
    return np.stack([weight[classes == each].sum(axis=0) for each in Afferent]).astype(np.float32)


def in_color(spikes: NDArray[Any], most: float) -> NDArray[np.float32]:
    """Return spikes (3, ...) as inks on white, (..., 3), with full color at `most` in total."""
    image = np.ones((*spikes.shape[1:], 3), np.float32)
    for afferent, color in CLASS_COLORS.items():
        ink = 1 - np.array([int(color[at : at + 2], 16) for at in (1, 3, 5)]) / 255
        image -= spikes[afferent][..., None] / max(most, 1e-9) * ink.astype(np.float32)
    return np.clip(image, 0, 1)
