"""Result of a threshold session, as a profile stores it."""

import math
from collections.abc import Mapping

import numpy as np

from smarttouch.calibrate.limits import Thresholds
from smarttouch.electrodes import parse_ranges
from smarttouch.errors import CalibrationError
from smarttouch.profile import Profile

Found = Mapping[int, Thresholds]


def parse_electrodes(text: str | None, profile: Profile) -> list[int]:
    """Return the electrodes in a list such as ``0-7,12``; all that are not masked if None."""
    count = len(profile.electrodes)
    if text is None:
        return [int(each) for each in profile.driven]
    chosen: list[int] = []
    for low, high in parse_ranges(text, "electrodes", CalibrationError):
        if not low <= high < count:
            named = f"{low}" if low == high else f"{low}-{high}"
            raise CalibrationError(
                f"electrode {named} is out of range: {profile.name} has electrodes 0 to "
                f"{count - 1}",
                about="electrodes",
            )
        chosen += range(low, high + 1)
    masked = sorted(set(chosen) & set(profile.output.masked))
    if masked:
        raise CalibrationError(
            f"electrode {masked[0]} is masked in {profile.name}: leave it out",
            about="electrodes",
            electrode=masked[0],
        )
    return sorted(set(chosen))


def filled(profile: Profile, found: Found) -> tuple[list[float], list[float]]:
    """Return thresholds and comfortable maxima of all electrodes, mA.

    Electrodes not measured, not felt, or without room between the two keep their values.
    """
    usable = {site: each for site, each in found.items() if each.usable}
    if not usable:
        raise CalibrationError(
            "no electrode was felt and then strong enough: check contact with "
            "'smarttouch calibrate contact', and explain the task",
            about="thresholds",
            remedy="smarttouch calibrate contact",
        )
    threshold, comfort = profile.threshold_ma.astype(float), profile.full_ma.astype(float)
    for site, each in usable.items():
        threshold[site], comfort[site] = each.threshold_ma, each.comfort_ma
    # Down, so that no rounding takes comfort above a limit; what was single precision, to it.
    return (
        [round(float(each), 3) for each in threshold],
        [math.floor(1000 * float(each) + 1e-3) / 1000 for each in comfort],
    )


def sentence(found: Found, *, adaptive: bool) -> str:
    """Return the sentence for the profile."""
    usable = [each for each in found.values() if each.usable]
    threshold = np.array([each.threshold_ma for each in usable])
    comfort = np.array([each.comfort_ma for each in usable])
    spread = float(np.median([each.spread for each in usable]))
    how = "yes or no after rising current" if adaptive else "rising current"
    kept = sorted(site for site, each in found.items() if not each.usable)
    return (
        f"{len(usable)} electrodes by {how}, threshold {np.median(threshold):.2f} mA "
        f"({threshold.min():.2f} to {threshold.max():.2f}), comfortable up to "
        f"{np.median(comfort):.2f} mA ({comfort.min():.2f} to {comfort.max():.2f}), spread of a "
        f"threshold {spread:.1%}, {sum(each.runs for each in found.values())} runs, "
        f"{sum(each.false_presses for each in found.values())} false presses"
        + (f"; not usable, kept as they were: {kept}" if kept else "")
    )
