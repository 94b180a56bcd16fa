"""Current per DAC count (scale) of the published boards, nominal and measured."""

import math

from smarttouch.base.errors import BoardError

BAND = 0.3  # largest accepted relative deviation of a scale from the nominal scale
NOMINAL_UA = {"kajimoto61": 10_000 / 4096, "etactilekit": 9.99}
"""Nominal current per DAC count of each board; on the kajimoto61, 4096 counts are 10 mA."""


def require_in_band(ratio: float, what: str) -> None:
    """Raise BoardError if the ratio of a scale to the nominal scale is not within 1 ± `BAND`."""
    if not abs(ratio - 1) <= BAND + 1e-9:
        raise BoardError(
            f"{what} would be {ratio:.3g} times the nominal current, but a board's current differs "
            f"from nominal by {100 * BAND:.0f} % at most: check the units, the connections, the "
            "resistor and the type of board, then measure again (smarttouch calibrate scale)"
        )


def measured_scale(
    kind: str, before_ua: float | None, volts: float, ohm: float, current_ma: float
) -> tuple[float, float | None]:
    """Return the ratio of the measured to the requested current, and the new scale, µA per count.
    The measured current is ``volts`` / ``ohm``, the requested current is ``current_ma``. The new
    scale is the ratio times the old scale, ``before_ua``; it is None if the old scale is None.
    Raises BoardError if a result is implausible (see `require_in_band`)."""
    for what, value in (("volts", volts), ("ohm", ohm), ("current_ma", current_ma)):
        if not 0 < value < math.inf:
            raise BoardError(f"{what} {value:g} must be above 0 and finite")
    ratio = 1000 * volts / ohm / current_ma
    require_in_band(ratio, f"{volts:g} V across {ohm:g} ohm")
    scale_ua = None if before_ua is None else before_ua * ratio
    if scale_ua is not None and kind in NOMINAL_UA:
        # Compare with the nominal scale, even if the profile has a measured one.
        rounded_ua = float(f"{scale_ua:.4g}")
        require_in_band(rounded_ua / NOMINAL_UA[kind], f"output.ua_per_count = {rounded_ua:g}")
    return ratio, scale_ua
