"""Spikes of one finger under delivered pulses, and their picture in the colors of classes."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from smarttouch.afferent import Afferent
from smarttouch.physiology.feeling import fire_all
from smarttouch.physiology.felt import in_color
from smarttouch.physiology.finger import Finger
from smarttouch.physiology.spikes import SpikeModel
from smarttouch.sources.frame import Pose

Counts = dict[int, NDArray[np.intp]]  # spikes of each afferent, (A,), by sequence number
Places = NDArray[np.floating]

FIELD_MM = 1.0  # standard deviation of a receptive field. Ours.
MOST_SLOTS = 10_000  # slots that are looked at; of more, sequences are left out evenly
_DARK_QUANTILE = 0.999
_SIDE_MM = 0.5  # distance of the places by which passes of the finger are counted


@dataclass(frozen=True, eq=False)
class DeliveredSlots:
    """Slots of one delivered sequence, as `SpikeModel` takes them."""

    current_ua: NDArray[np.int16]
    width_us: NDArray[np.uint16]
    discharge_us: NDArray[np.uint16]
    period_us: int


def delivered_spikes(
    finger: Finger,
    numbers: NDArray[np.uint32],
    width_us: NDArray[np.float32],
    current_ua: NDArray[np.int16],
    period_us: Mapping[int, int],
    most_slots: int | None = None,
) -> Counts:
    """Return the spikes of a finger under delivered slots (see `Perception.answers`), of the
    sequences that ``period_us`` names; above ``most_slots``, sequences are left out evenly."""
    begins = np.flatnonzero(np.diff(numbers.astype(np.int64), prepend=-1))
    parts = zip(begins, np.append(begins[1:], len(numbers)), strict=False)
    sequences = {}
    for begin, end in parts:
        number, part = int(numbers[begin]), slice(begin, end)
        if number in period_us:
            width = width_us[part].astype(np.uint16)
            discharge = np.full(len(width), finger.profile.pulse.discharge_us, np.uint16)
            sequences[number] = DeliveredSlots(
                current_ua[part], width, discharge, period_us[number]
            )
    every = 1 if most_slots is None else 1 + len(numbers) // most_slots
    kept = dict(list(sequences.items())[::every])
    spikes = fire_all(SpikeModel(finger), list(kept.values()))
    return {number: each.counts for number, each in zip(kept, spikes, strict=True)}


def felt_in_color(
    finger: Finger,
    felt: Iterable[tuple[Pose, NDArray[np.intp]]],
    placed: Callable[[Places, Pose], Places],
    shape: tuple[int, int],
    pixel_mm: float,
    field_mm: float = FIELD_MM,
    *,
    mean: bool = True,
) -> NDArray[np.uint8]:
    """Return spikes where the receptors were, in the color of each class, (H, W, 3) on white.

    ``felt`` yields the spikes of each afferent at poses of the finger; ``placed`` returns where
    places of the finger are at a pose, (N, 2) mm from the picture's corner; ``field_mm`` is the
    standard deviation of a receptive field. With ``mean`` a place shows its spikes for each pass.
    """
    spikes, passes = np.zeros((len(Afferent), *shape), np.float32), np.zeros(shape, np.float32)
    sides = [np.arange(-side, side, _SIDE_MM) + _SIDE_MM / 2 for side in finger.reach_mm]
    skin = np.stack(np.meshgrid(*sides), axis=-1).reshape(-1, 2)
    for pose, counts in felt:
        fired = np.flatnonzero(counts)
        row, column, on = _pixels(placed(finger.receptor_mm[fired], pose), shape, pixel_mm)
        np.add.at(spikes, (finger.classes[fired[on]], row, column), counts[fired[on]])
        row, column, _ = _pixels(placed(skin, pose), shape, pixel_mm)
        passes[row, column] += 1
    sigma = field_mm / pixel_mm
    spread = np.stack([cv2.GaussianBlur(each, (0, 0), sigma) for each in spikes])
    if mean:
        wide = cv2.GaussianBlur(passes, (0, 0), sigma)
        spread = spread / np.maximum(wide, wide.max(initial=0) / 20 + 1e-9)
    total = spread.sum(axis=0)
    dark = float(np.quantile(total[total > 0], _DARK_QUANTILE)) if total.any() else 1.0
    return np.asarray(np.rint(255 * in_color(spread, dark)), np.uint8)


def _pixels(
    places_mm: Places, shape: tuple[int, int], pixel_mm: float
) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.bool_]]:
    """Return rows and columns of the places that are on a picture, and which these are."""
    column, row = np.floor(places_mm / pixel_mm).astype(np.intp).T
    on = (row >= 0) & (row < shape[0]) & (column >= 0) & (column < shape[1])
    return row[on], column[on], on
