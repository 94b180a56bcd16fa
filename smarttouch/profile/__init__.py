"""Profiles: one device on one finger, with calibrations and limits."""

from smarttouch.profile.profile import Profile
from smarttouch.profile.profile_tables import ForceLaw, Optics, Skin
from smarttouch.profile.toml_files import DEFAULT_PROFILE, list_profiles, load_profile

__all__ = [
    "DEFAULT_PROFILE", "ForceLaw", "Optics", "Profile", "Skin", "list_profiles", "load_profile",
]  # fmt: skip
