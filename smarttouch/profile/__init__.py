"""Profiles: what calibration knows of one device on one finger, as TOML files."""

from smarttouch.profile.device import ForceLaw, Optics
from smarttouch.profile.load import DEFAULT_PROFILE, load_profile, profile_names
from smarttouch.profile.profile import Profile
from smarttouch.profile.skin import Skin

__all__ = [
    "DEFAULT_PROFILE",
    "ForceLaw",
    "Optics",
    "Profile",
    "Skin",
    "load_profile",
    "profile_names",
]
