"""Profiles: what calibration knows of one device on one finger, as TOML files."""

from smarttouch.profile.device import (
    CEILING_CHARGE_UC,
    CEILING_MA,
    CEILING_PULSE_US,
    SHORTEST_RAMP_S,
    ForceLaw,
    Optics,
    Profile,
)
from smarttouch.profile.load import DEFAULT_PROFILE, load_profile, profile_names
from smarttouch.profile.skin import Skin

__all__ = [
    "CEILING_CHARGE_UC",
    "CEILING_MA",
    "CEILING_PULSE_US",
    "DEFAULT_PROFILE",
    "SHORTEST_RAMP_S",
    "ForceLaw",
    "Optics",
    "Profile",
    "Skin",
    "load_profile",
    "profile_names",
]
