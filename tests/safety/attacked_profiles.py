"""Profiles for the attacks: all shipped ones, and variants that reach other limits first."""

from functools import cache

from smarttouch.profile import list_profiles, load_profile

CHANGED = {
    "strong": (
        "smarttouch-4x4",
        {"perception.threshold_ma": 2.5, "pulse.width_us": 100, "limits.current_ma": 5.0},
    ),
    "full charge": ("smarttouch-4x4", {"perception.threshold_ma": 1.25}),
    "small discs": ("smarttouch-4x4", {"array.diameter_mm": 0.5, "pulse.width_us": 80}),
    "rings": ("line-8", {"array": {
        "layout": "grid", "rows": 3, "columns": 3, "pitch_x_mm": 2.0, "pitch_y_mm": 2.0,
        "diameter_mm": 1.0, "inner_diameter_mm": 0.85,
    }, "skin.medium": "half-space"}),
    "points": ("line-8", {"array": {
        "layout": "free", "shape": "point", "positions_mm": ((0, 0), (1, 0), (0, 2), (3, 1)),
    }, "skin.medium": "half-space"}),
    "one finger": ("line-7", {
        "perception.threshold_ma": (0.4, 0.5, 0.333, 0.61, 0.4, 0.7, 0.123),
        "perception.comfort_ma": (1.9, 1.1, 0.9, 1.7, 1.2, 1.3, 0.777),
        "limits.electrode_ma": (1.9, 1.1, 0.9, 1.75, 1.2, 2.0, 0.777),
        "limits.total_ma": 3.333,
    }),
    "slow": ("smarttouch-4x4", {
        "limits.ramp_s": 1.7, "limits.rate_hz": 60.3, "limits.duty": 0.37,
        "limits.pulse_us": 150.7, "pulse.width_us": 150, "limits.charge_uc": 0.4,
    }),
    "short session": ("line-8", {"limits.session_s": 61.5, "limits.session_mc": 0.5}),
}  # fmt: skip
"""Variants by name: the shipped profile, and the keys that differ, with their values."""


def changed(profile, keys):
    """Return a copy of a profile with other values of keys such as ``skin.medium``."""
    table = profile.model_dump()
    for key, value in keys.items():
        *tables, last = key.split(".")
        inner = table
        for each in tables:
            inner = inner[each]
        inner[last] = value
    return type(profile).model_validate(table)


@cache
def display(name):
    """Return the shipped profile, or the variant in `CHANGED`, with this name."""
    usual, keys = CHANGED.get(name, (name, {}))
    return changed(load_profile(usual), keys)


def display_names():
    """Return the names of all shipped profiles and variants."""
    return [*list_profiles(), *CHANGED]
