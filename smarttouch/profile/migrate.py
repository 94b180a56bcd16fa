"""Profiles of earlier versions, brought up to this one."""

from collections.abc import Mapping, MutableMapping
from typing import Any, NamedTuple

from smarttouch.profile.ceilings import (
    CEILING_DENSITY_UC_CM2,
    CEILING_SESSION_MC,
    CEILING_SESSION_S,
    CEILING_TOTAL_MA,
)

_ADDED_LIMITS = {
    "total_ma": CEILING_TOTAL_MA,
    "density_uc_cm2": CEILING_DENSITY_UC_CM2,
    "session_s": CEILING_SESSION_S,
    "session_mc": CEILING_SESSION_MC,
}
"""Limits that profiles of the first version need not have, and the ceiling of each."""


class Change(NamedTuple):
    """One key that was brought up to date.

    Attributes
    ----------
    key : str
    before, after : object
        None before if the key was missing.
    why : str
        For people: half a sentence.
    """

    key: str
    before: object
    after: object
    why: str

    def __str__(self) -> str:
        what = f"{self.key} = {self.after!r}".replace("True", "true").replace("False", "false")
        was = "added" if self.before is None else f"was {self.before!r}"
        return f"{what} ({was}): {self.why}"


def migrate(table: MutableMapping[str, Any]) -> list[Change]:
    """Bring the table of a profile up to date, in place; return what has changed.

    All else stays as it is, calibrations included, and what was felt stays as strong: values
    are only added as they counted before, or lowered to a ceiling that has come since.

    Parameters
    ----------
    table : mutable mapping
        Of a file; what is no profile is left to whoever validates it.
    """
    limits, frames = table.get("limits"), table.get("frames", {})
    if not isinstance(limits, MutableMapping) or not isinstance(frames, Mapping):
        return []
    changes, shared = [], limits.get("total_ma") is not None
    total_ma = limits.get("total_ma")
    if isinstance(total_ma, int | float) and total_ma > CEILING_TOTAL_MA:
        limits["total_ma"] = CEILING_TOTAL_MA
        why = "no profile may allow more; kernels are designed anew within it"
        changes.append(Change("limits.total_ma", total_ma, CEILING_TOTAL_MA, why))
    for name, ceiling in _ADDED_LIMITS.items():
        if name not in limits:
            limits[name] = ceiling
            why = "the ceiling, which holds for all"
            changes.append(Change(f"limits.{name}", None, ceiling, why))
    if "share" not in frames:
        table.setdefault("frames", {})["share"] = shared
        why = "as before, points share slots where limits.total_ma was given"
        changes.append(Change("frames.share", None, shared, why))
    return changes
