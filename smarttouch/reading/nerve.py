"""Legibility at the nerve: lines as the afferents of simulated fingers respond to them."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from statistics import fmean, median

import numpy as np

from smarttouch.afferent import Afferent
from smarttouch.delivered.line import LinePicture
from smarttouch.delivered.population import FIELD_MM, delivered_spikes
from smarttouch.physiology.felt import felt, over
from smarttouch.physiology.finger import Finger
from smarttouch.reading.deliver import DeliveredLine

_FULL_QUANTILE = 0.99


@dataclass(frozen=True, eq=False)
class NerveReading:
    """Lines as one finger responded to them, and means over the sequences that had slots.

    The means are NaN if none of these fired. Active are the electrodes at which the board's own
    response is above the threshold.
    """

    pictures: list[LinePicture]
    silent_points: float
    wrong_class: float
    misplaced: float


def read_at_nerve(
    lines: Sequence[DeliveredLine], finger: Finger, wanted: Collection[Afferent]
) -> NerveReading:
    """Return the response of a finger to delivered lines that were meant for some classes.

    Each electrode has the spikes of the receptors around it, of all classes, relative to nearly the
    most that any electrode has.
    """
    profile = finger.profile
    places = profile.electrodes.position_mm
    away = finger.receptor_mm[:, None] - places
    field = np.exp(-(away**2).sum(axis=2) / (2 * FIELD_MM**2)).astype(np.float32)
    silent = np.zeros(len(field), np.intp)
    found, values = [], []
    for line in lines:
        periods = dict.fromkeys(line.poses, round(1e6 / profile.pulse.rate_hz))
        spikes = delivered_spikes(finger, line.numbers, line.width_us, line.current_ua, periods)
        for number, pose in line.poses.items():
            counts = spikes.get(number, silent)
            values.append((line, pose.x_mm, counts @ field))
            if number in line.answers:
                found.append(felt(finger, counts, line.answers[number] > 0, wanted))
    full = float(np.quantile([each.max() for _, _, each in values], _FULL_QUANTILE))
    pictures = {id(line): LinePicture(profile.electrodes, line.length_mm) for line in lines}
    for line, x_mm, each in values:
        shown = np.clip(each / max(full, 1e-9), 0, 1).astype(np.float32)
        pictures[id(line)].add(x_mm, shown)
    measures = (
        over(fmean, (getattr(each, name) for each in found))
        for name in ("silent_points", "wrong_class", "misplaced")
    )
    return NerveReading(list(pictures.values()), *measures)


def nerve_figures(
    readings: Sequence[NerveReading], errors: Sequence[float]
) -> dict[str, float | dict[str, float]]:
    """Return medians over fingers, and error rates at the nerve, for a JSON file."""
    ranked = sorted(errors)
    worst = ranked[-max(1, len(ranked) // 10) :]
    return {
        "at_nerve": {"median": median(ranked), "worst_tenth": fmean(worst)},
        **{
            name: over(median, (getattr(each, name) for each in readings))
            for name in ("wrong_class", "misplaced", "silent_points")
        },
    }
