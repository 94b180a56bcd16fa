"""A profile within the limits of another: of each number the stricter one."""

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from smarttouch.profile.ceilings import CEILING_TOTAL_MA
from smarttouch.profile.profile import Profile

_UPPER = (
    "current_ma", "pulse_us", "charge_uc", "rate_hz", "duty", "density_uc_cm2", "session_s",
    "session_mc",
)  # fmt: skip


def stricter(own: Profile, other: Profile) -> Profile:
    """Return a profile, its limits, comfort and masks narrowed to those of another. Device, array,
    kernels and force law stay its own. Where the other has another number of electrodes, the least
    current of its electrodes holds for all."""
    count = len(own.electrodes)
    same = len(other.electrodes) == count

    def matched(values: ArrayLike) -> NDArray[np.float64]:
        values = np.asarray(values, np.float64)
        return values if same else np.full(count, values.min())

    limits: dict[str, Any] = own.limits.model_dump()
    for key in _UPPER:
        limits[key] = min(limits[key], getattr(other.limits, key))
    limits["ramp_s"] = max(limits["ramp_s"], other.limits.ramp_s)
    total_ma = min(each.limits.total_ma or CEILING_TOTAL_MA for each in (own, other))
    if total_ma < (own.limits.total_ma or CEILING_TOTAL_MA):
        limits["total_ma"] = total_ma
    pulse = own.pulse.model_dump()
    pulse["width_us"] = min(pulse["width_us"], math.floor(limits["pulse_us"]))
    pulse["rate_hz"] = min(pulse["rate_hz"], limits["rate_hz"])
    most_ma = min(limits["current_ma"], total_ma, 1000 * limits["charge_uc"] / pulse["width_us"])
    each_ma = np.full(count, math.inf)
    if own.limits.electrode_ma is not None:
        each_ma = np.asarray(own.limits.electrode_ma, np.float64)
    if other.limits.electrode_ma is not None:
        each_ma = np.minimum(each_ma, matched(other.limits.electrode_ma))
        limits["electrode_ma"] = tuple(each_ma.tolist())
    own_ma = own.full_ma.astype(np.float64)
    full_ma = np.minimum(np.minimum(matched(other.full_ma), each_ma), most_ma)
    # Currents are single precision: what is lowered is lowered to the whole microampere below.
    lower = full_ma < own_ma * (1 - 1e-6)
    full_ma = np.where(lower, np.floor(1000 * full_ma - 1e-3) / 1000, own_ma)
    threshold_ma = np.minimum(own.threshold_ma, matched(other.threshold_ma))
    perception = own.perception.model_dump()
    if lower.any():
        perception["comfort_ma"] = tuple(full_ma.tolist())
    if (threshold_ma < own.threshold_ma).any():
        # What was comfortable stays as it is.
        perception |= {
            "threshold_ma": tuple(threshold_ma.tolist()),
            "comfort_ma": tuple(full_ma.tolist()),
        }
    output = own.output.model_dump()
    output["masked"] = tuple(sorted({*own.output.masked, *(other.output.masked if same else ())}))
    tables = {"limits": limits, "pulse": pulse, "perception": perception, "output": output}
    if all(table == getattr(own, name).model_dump() for name, table in tables.items()):
        return own
    # A total that is new does not let points share slots.
    frames = own.frames.model_dump() | {"share": own.shares}
    return own.model_copy(update={**tables, "frames": frames})
