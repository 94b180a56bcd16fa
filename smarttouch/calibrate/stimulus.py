"""Currents of measurements: their limits, and the profile that lets them flow."""

import math

from smarttouch.boards.board import Board
from smarttouch.profile import Profile
from smarttouch.stimulation.limits import LONGEST_RAMP_S


def measuring_profile(profile: Profile) -> Profile:
    """Return a profile that reaches above the comfort of one, which is to be measured.

    Current, charge, pulse, rate, duty, sums and single electrodes stay limited as they are, and
    so does the rise in mA a second.
    """
    full_ma, ramp_s = float(profile.full_ma.max()), profile.limits.ramp_s
    most_ma = min(_strongest_ma(profile), full_ma * LONGEST_RAMP_S / ramp_s)
    own = profile.limits.electrode_ma or (most_ma,) * len(profile.electrodes)
    ceilings_ma = [_whole_ua(min(most_ma, each)) for each in own]
    perception = profile.perception.model_dump() | {"comfort_ma": ceilings_ma}
    # Never faster, where single electrodes keep the ceilings below what was comfortable.
    slower = ramp_s * max(1.0, max(ceilings_ma) / full_ma)
    limits = profile.limits.model_dump() | {"ramp_s": min(LONGEST_RAMP_S, slower)}
    return Profile.model_validate(
        {**profile.model_dump(), "perception": perception, "limits": limits}
    )


def ceiling_ma(profile: Profile, site: int, board: Board) -> float:
    """Return the largest current of an electrode, mA: whole microamperes."""
    own = profile.limits.electrode_ma
    strongest = min(
        _strongest_ma(profile),
        math.inf if own is None else own[site],
        board.capabilities.max_current_ma,
    )
    return _whole_ua(strongest)


def slew_ma_s(profile: Profile, site: int) -> float:
    """Return the largest slope of an electrode's current, mA/s."""
    return float(profile.full_ma[site]) / profile.limits.ramp_s


def _strongest_ma(profile: Profile) -> float:
    limits = profile.limits
    by_charge = 1000 * limits.charge_uc / profile.pulse.width_us
    return min(limits.current_ma, by_charge, profile.total_ma)


def _whole_ua(current_ma: float) -> float:
    return math.floor(1000 * current_ma + 1e-6) / 1000
