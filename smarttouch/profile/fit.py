"""Values of a profile that do not fit each other."""

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from smarttouch.profile.table import UnfitError

if TYPE_CHECKING:
    from smarttouch.profile.profile import Profile


def misfits(profile: "Profile") -> Iterator[UnfitError]:
    """Yield all that does not fit; currents are checked only if each electrode has one."""
    of_array = [*_misfits_of_array(profile)]
    yield from of_array or _misfits_of_current(profile)


def _misfits_of_array(profile: "Profile") -> Iterator[UnfitError]:
    count = len(profile.electrodes)
    masked, wiring = profile.output.masked, profile.output.wiring
    if max(masked, default=0) >= count:
        yield UnfitError(
            f"output.masked lists {max(masked)}, the array has electrodes 0 to {count - 1}: "
            "remove it",
            about="output.masked",
        )
    if count - len(masked) < 2:
        yield UnfitError(
            f"output.masked leaves {count - len(masked)} of {count} electrodes: current needs "
            "at least two, shorten the list or repair the array",
            about="output.masked",
        )
    if wiring is not None and len(wiring) != count:
        yield _of_another_length("output.wiring", len(wiring), count, "leave it out")
    for key, values in (
        ("perception.threshold_ma", profile.perception.threshold_ma),
        ("perception.comfort_ma", profile.perception.comfort_ma),
        ("output.impedance_kohm", profile.output.impedance_kohm),
    ):
        if isinstance(values, tuple) and len(values) != count:
            yield _of_another_length(key, len(values), count, "one for all")
    if profile.skin.medium == "plane" and profile.array.layout != "lines":
        yield UnfitError(
            f"skin.medium 'plane' does not go with array.layout {profile.array.layout!r}: "
            "it is for 'lines'; 'half-space' is for all",
            about="skin.medium",
            remedy="array.layout",
        )
    if profile.kernels.objective == "finger" and profile.output.kind != "weighted":
        yield UnfitError(
            f"kernels.objective 'finger' does not go with output.kind {profile.output.kind!r}: "
            "the board must give every electrode its own current; 'node' is for all",
            about="kernels.objective",
            remedy="output.kind",
        )
    lowered = profile.limits.electrode_ma
    if lowered is not None and len(lowered) != count:
        yield _of_another_length("limits.electrode_ma", len(lowered), count, "leave it out")


def _misfits_of_current(profile: "Profile") -> Iterator[UnfitError]:
    lowered = profile.limits.electrode_ma
    full_ma = profile.full_ma
    strongest_of, strongest_key = _names_of_strongest(profile)
    painful = full_ma <= profile.threshold_ma
    if painful.any():
        index = int(painful.argmax())
        yield UnfitError(
            f"comfort_ma is {full_ma[index]:.2f} mA at electrode {index}, not above its "
            f"threshold_ma of {profile.threshold_ma[index]:.2f}: measure both again",
            about="perception.comfort_ma",
            electrode=index,
        )
    # Thresholds are single precision: a limit equal to their product is kept.
    over = full_ma > np.multiply(np.inf if lowered is None else lowered, 1 + 1e-6)
    if lowered is not None and over.any():
        index = int(over.argmax())
        yield UnfitError(
            f"{strongest_of} is {full_ma[index]:.2f} mA at electrode {index}, above its "
            f"limits.electrode_ma {lowered[index]:g}: lower one of the two",
            about="limits.electrode_ma",
            remedy=strongest_key,
            electrode=index,
        )
    yield from _misfits_of_strongest(profile)


def _names_of_strongest(profile: "Profile") -> tuple[str, str]:
    """Return the words for the strongest current, and its key."""
    if profile.perception.comfort_ma is not None:
        return "comfort_ma", "perception.comfort_ma"
    return "threshold_ma × comfort_ratio", "perception.comfort_ratio"


def _misfits_of_strongest(profile: "Profile") -> Iterator[UnfitError]:
    full_ma, (strongest_of, strongest_key) = profile.full_ma, _names_of_strongest(profile)
    limits, width_us, strongest = profile.limits, profile.pulse.width_us, float(full_ma.max())
    if strongest > limits.current_ma:
        yield UnfitError(
            f"{strongest_of} reaches {strongest:.2f} mA, above limits.current_ma "
            f"{limits.current_ma}: lower one of the two",
            about="limits.current_ma",
            remedy=strongest_key,
        )
    if limits.total_ma is not None and limits.total_ma < strongest:
        yield UnfitError(
            f"limits.total_ma {limits.total_ma:g} is below the {strongest:.2f} mA that "
            f"{strongest_of} sends through one electrode: raise it, or lower one of the two",
            about="limits.total_ma",
            remedy=strongest_key,
        )
    if width_us > limits.pulse_us:
        yield UnfitError(
            f"pulse.width_us {width_us} is above limits.pulse_us {limits.pulse_us:g}: lower it",
            about="pulse.width_us",
        )
    charge = strongest * width_us / 1000
    if charge > limits.charge_uc:
        yield UnfitError(
            f"the strongest pulse carries {charge:.3f} µC, above limits.charge_uc "
            f"{limits.charge_uc}: lower {strongest_of} or pulse.width_us",
            about="limits.charge_uc",
            remedy=strongest_key,
        )


def _of_another_length(key: str, numbers: int, electrodes: int, otherwise: str) -> UnfitError:
    return UnfitError(
        f"{key} lists {numbers} electrodes, the array has {electrodes}: "
        f"give {electrodes} numbers, or {otherwise}",
        about=key,
    )
