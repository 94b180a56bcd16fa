"""Profiles as the first version had them, made of those that are shipped."""

from smarttouch.profile.load import profile_path

ADDED = ("density_uc_cm2", "session_s", "session_mc", "share")
TOTAL_GIVEN = ("electric-mouse", "optacon-24x6")
"""Profiles of the first version that gave `limits.total_ma`."""


def first_version(name, total_ma=None):
    """Return the text of a shipped profile, as the first version had it; or with another total."""
    lines = profile_path(name).read_text(encoding="utf-8").splitlines()
    lines = [each for each in lines if not each.startswith((*ADDED, "[frames]"))]
    if total_ma is not None:
        lines = [f"total_ma = {total_ma}  # all" if "total_ma" in each else each for each in lines]
    elif name not in TOTAL_GIVEN:
        lines = [each for each in lines if not each.startswith("total_ma")]
    return "\n".join(lines) + "\n"
