"""Profiles: calibration data of one device on one finger, as TOML files."""

from smarttouch.profile.device import ForceLaw, Optics
from smarttouch.profile.load import DEFAULT_PROFILE, list_profiles, load_profile
from smarttouch.profile.profile import Profile
from smarttouch.profile.skin import Skin

__all__ = [
    "DEFAULT_PROFILE",
    "ForceLaw",
    "Optics",
    "Profile",
    "Skin",
    "list_profiles",
    "load_profile",
]
