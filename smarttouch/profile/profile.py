"""Profile of one device on one finger, with its consistency checks."""

import math
import re
from collections.abc import Collection, Iterator, Mapping
from functools import cached_property
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, ValidationError, model_validator

from smarttouch.base.errors import ProfileError, SmartTouchError
from smarttouch.profile import electrodes as arrays
from smarttouch.profile import profile_tables as tables
from smarttouch.profile.electrodes import ArrayLayout, ElectrodeArray, GridLayout
from smarttouch.profile.project_ceilings import CEILING_TOTAL_MA
from smarttouch.profile.toml_tables import Table, UnfitError, raise_all, table_error


def misfits(profile: "Profile") -> Iterator[UnfitError]:
    """Yield all inconsistencies. Currents are checked only if the array is consistent."""
    of_array = [*_misfits_of_array(profile)]
    yield from of_array or _misfits_of_current(profile)


def _misfits_of_array(profile: "Profile") -> Iterator[UnfitError]:
    count = len(profile.electrodes)
    masked = profile.output.masked
    if max(masked, default=0) >= count:
        yield UnfitError(
            f"output.masked lists {max(masked)}, but the array has electrodes 0 to {count - 1}: "
            "remove it from the list",
            key="output.masked",
        )
    if count - len(masked) < 2:
        yield UnfitError(
            f"output.masked leaves {count - len(masked)} of {count} electrodes, but current needs "
            "at least two: shorten the list or repair the array",
            key="output.masked",
        )
    for key, values in (
        ("output.wiring", profile.output.wiring),
        ("limits.electrode_ma", profile.limits.electrode_ma),
        ("perception.threshold_ma", profile.perception.threshold_ma),
        ("perception.comfort_ma", profile.perception.comfort_ma),
        ("output.impedance_kohm", profile.output.impedance_kohm),
    ):
        if isinstance(values, tuple) and len(values) != count:
            one = key.endswith(("threshold_ma", "impedance_kohm"))
            yield UnfitError(
                f"{key} lists {len(values)} electrodes, but the array has {count}: give {count} "
                f"numbers, or {'one number for all' if one else 'leave it out'}",
                key=key,
            )
    if profile.skin.medium == "plane" and profile.array.layout != "lines":
        yield UnfitError(
            f"skin.medium 'plane' requires array.layout 'lines', not {profile.array.layout!r}: "
            "choose 'half-space'",
            key="skin.medium",
        )
    if profile.kernels.neighbors is not None and (
        profile.output.kind != "weighted" or profile.array.layout == "lines"
    ):
        yield UnfitError(
            "kernels.neighbors requires output.kind 'weighted' and an array.layout other than "
            "'lines': remove the key",
            key="kernels.neighbors",
        )


def _misfits_of_current(profile: "Profile") -> Iterator[UnfitError]:
    lowered, full_ma = profile.limits.electrode_ma, profile.full_ma
    strongest_of = "comfort_ma" if profile.perception.comfort_ma else "threshold_ma × comfort_ratio"
    painful = full_ma <= profile.threshold_ma
    if painful.any():
        index = int(painful.argmax())
        yield UnfitError(
            f"comfort_ma of electrode {index} is {full_ma[index]:.2f} mA, not above its "
            f"threshold_ma of {profile.threshold_ma[index]:.2f}: measure both again",
            key="perception.comfort_ma",
            electrode=index,
        )
    # Comfort levels are rounded to single precision, so tolerate a small excess over the limit.
    over = full_ma > np.multiply(np.inf if lowered is None else lowered, 1 + 1e-6)
    if lowered is not None and over.any():
        index = int(over.argmax())
        yield UnfitError(
            f"{strongest_of} of electrode {index} is {full_ma[index]:.2f} mA, above its "
            f"limits.electrode_ma {lowered[index]:g}: lower {strongest_of}",
            key="limits.electrode_ma",
            electrode=index,
        )
    yield from _misfits_of_strongest(profile, float(full_ma.max()), strongest_of)


def _misfits_of_strongest(
    profile: "Profile", strongest: float, strongest_of: str
) -> Iterator[UnfitError]:
    limits, width_us = profile.limits, profile.pulse.width_us
    if strongest > limits.current_ma:
        yield UnfitError(
            f"{strongest_of} reaches {strongest:.2f} mA, above limits.current_ma "
            f"{limits.current_ma}: lower {strongest_of}",
            key="limits.current_ma",
        )
    if limits.total_ma is not None and limits.total_ma < strongest:
        yield UnfitError(
            f"limits.total_ma {limits.total_ma:g} is below the {strongest:.2f} mA that "
            f"{strongest_of} sends through one electrode: raise the limit, or lower {strongest_of}",
            key="limits.total_ma",
        )
    if width_us > limits.pulse_us:
        yield UnfitError(
            f"lower pulse.width_us {width_us}: it is above limits.pulse_us {limits.pulse_us:g}",
            key="pulse.width_us",
        )
    charge = strongest * width_us / 1000
    if charge > limits.charge_uc:
        yield UnfitError(
            f"the strongest pulse carries {charge:.3f} µC, above limits.charge_uc "
            f"{limits.charge_uc}: lower {strongest_of} or pulse.width_us",
            key="limits.charge_uc",
        )


_UNAFFECTED = ("optics", "registration", "force")
"""Calibrations that do not depend on the electrode array."""


class Profile(Table):
    """One device on one finger."""

    name: str = ""
    """Name of the file without its ending."""
    title: str = Field(min_length=1)
    """Description of the device that is shown to users."""
    array: ArrayLayout
    skin: tables.Skin
    output: tables.Output
    optics: tables.Optics
    force: tables.ForceLaw
    pulse: tables.Pulse
    limits: tables.Limits
    perception: tables.PerceptThresholds
    frames: tables.Frames = tables.Frames()
    kernels: tables.Kernels = tables.Kernels()
    defaults: tables.CommandDefaults = tables.CommandDefaults()
    calibrated: dict[str, tables.Calibrated] = Field(default_factory=dict)

    def __repr__(self) -> str:
        kind = self.output.kind
        return f"Profile({self.name or self.title!r}, {len(self.electrodes)} electrodes, {kind})"

    __str__ = __repr__

    @cached_property
    def electrodes(self) -> ElectrodeArray:
        return self.array.build()

    @cached_property
    def threshold_ma(self) -> NDArray[np.float32]:
        """Detection threshold of each electrode, (E,) mA (magnitude)."""
        return np.broadcast_to(
            np.asarray(self.perception.threshold_ma, np.float32), (len(self.electrodes),)
        ).copy()

    @cached_property
    def full_ma(self) -> NDArray[np.float32]:
        """Comfort level of each electrode, (E,) mA (magnitude)."""
        if self.perception.comfort_ma is not None:
            return np.asarray(self.perception.comfort_ma, np.float32)
        return self.threshold_ma * self.perception.comfort_ratio

    @property
    def shares(self) -> bool:
        """Whether the profile allows several points in one slot."""
        has_total = self.limits.total_ma is not None
        return has_total if self.frames.share is None else self.frames.share

    @property
    def total_ma(self) -> float:
        """Largest total current of all cathodes in a slot, mA. On a board with a single source, the
        total is limited to the current of one electrode, because one electrode carries all current
        if the others lose contact."""
        limits = self.limits
        total = limits.total_ma or CEILING_TOTAL_MA
        if self.output.kind == "weighted":
            return total
        return min(total, limits.current_ma, 1000 * limits.charge_uc / self.pulse.width_us)

    @property
    def design_total_ma(self) -> float | None:
        """Limit of the total current of a kernel while kernels are designed, mA; None for no limit.
        There is no limit if each slot has a single point and the profile's limit equals the
        project's ceiling. `PointSlots` then refuses kernels above the ceiling."""
        total = self.limits.total_ma or CEILING_TOTAL_MA
        return total if self.shares or total < CEILING_TOTAL_MA else None

    @cached_property
    def admittance(self) -> NDArray[np.float64]:
        """Admittance of each electrode, (E,) mS. A larger admittance takes more of the current."""
        impedance = np.asarray(self.output.impedance_kohm, np.float64)
        return np.broadcast_to(1 / impedance, (len(self.electrodes),)).copy()

    @cached_property
    def driven(self) -> NDArray[np.intp]:
        """Electrodes that are not masked, ascending."""
        return np.setdiff1d(np.arange(len(self.electrodes)), self.output.masked)

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Self:
        """Return a copy with other tables, validated like a file.

        Parameters
        ----------
        update : mapping, optional
            Tables by name, which replace those of this profile.
        deep : bool
            Whether to copy values, too.

        Raises
        ------
        ProfileError
            If the copy has unknown keys or impossible values. The message lists all of them.

        Examples
        --------
        >>> import smarttouch as st
        >>> profile = st.load_profile("electric-mouse")
        >>> small = {"layout": "grid", "rows": 5, "columns": 5, "pitch_x_mm": 2.0,
        ...          "pitch_y_mm": 2.0, "diameter_mm": 1.0}
        >>> len(profile.model_copy(update={"array": small}).electrodes)
        25
        """
        try:
            return super().model_copy(update=update, deep=deep)
        except ValidationError as error:
            raise table_error(ProfileError, self.name or "profile", error) from None

    def with_electrodes(
        self, table: Path | str | NDArray[np.floating[Any]] | GridLayout, title: str = ""
    ) -> Self:
        """Return a profile of the same device with another electrode array.

        Parameters
        ----------
        table : path or array-like, (E, 2) or (E, 3), mm, or GridLayout
            Positions, right and down, in the order of the board's outputs, and optionally diameters
            (default: 1 mm). A CSV file has the columns ``x_mm``, ``y_mm``, ``diameter_mm``. For
            a grid, the part of the page that a frame shows is magnified to the grid's width.
        title : str
            Description of the device that is shown to users.

        Raises
        ------
        ProfileError
            If the table is invalid, or the electrodes do not fit the rest of the profile.

        Notes
        -----
        Electrodes get this profile's smallest threshold, comfort level and current limit, and its
        largest impedance. Masks, wiring, electrode calibrations and command defaults are removed.

        Examples
        --------
        >>> import smarttouch as st
        >>> mouse = st.load_profile("electric-mouse")
        >>> mouse.with_electrodes([(0, 0), (2, 0), (1, 1.8)], "a triangle")
        Profile('a triangle', 3 electrodes, weighted)
        """
        optics = self.optics.model_dump()
        if isinstance(table, GridLayout):
            layout: GridLayout | arrays.FreeLayout = table
            optics["magnification"] = table.columns * table.pitch_x_mm / optics["field_width_mm"]
        else:
            layout = arrays.layout_of(table)
        count = len(layout.build())
        output = self.output.model_dump() | {"masked": (), "wiring": None}
        output["impedance_kohm"] = np.max(self.output.impedance_kohm)
        felt = self.perception.model_dump()
        felt["threshold_ma"] = np.min(self.perception.threshold_ma)
        limits = self.limits.model_dump()
        for table_of, key in ((felt, "comfort_ma"), (limits, "electrode_ma")):
            if table_of[key] is not None:
                table_of[key] = (min(table_of[key]),) * count
        calibrated = {part: self.calibrated[part] for part in self.calibrated.keys() & _UNAFFECTED}
        return self.model_copy(
            update={
                "array": layout,
                "output": output,
                "perception": felt,
                "limits": limits,
                "optics": optics,
                "calibrated": calibrated,
                "defaults": tables.CommandDefaults(),
                "title": title or f"{count} electrodes, otherwise as {self.title}",
                "name": "",
            }
        )

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        raise_all(misfits(self))
        return self


_RANGE = re.compile("([0-9]{1,6})(?:-([0-9]{1,6}))?")


def require_driven(
    profile: Profile, sites: str | Collection[int], error: type[SmartTouchError], about: str
) -> NDArray[np.intp]:
    """Return the electrodes of ``sites``, each once, ascending. ``sites`` is a text such as
    ``0-7,12`` or a collection. Raises ``error`` if an electrode does not exist or is masked."""
    if isinstance(sites, str):
        matches = [_RANGE.fullmatch(part.strip()) for part in sites.split(",")]
        if None in matches:
            raise error(f"{about} {sites!r} is not a list: give numbers and ranges like 0-7,12")
        ranges = [(int(match[1]), int(match[2] or match[1])) for match in matches if match]
    else:
        ranges = [(site, site) for site in sites]
    if not ranges:
        raise error(f"no {about} is given: give at least one")
    count, masked = len(profile.electrodes), sorted(profile.output.masked)
    for low, high in ranges:
        there = 0 <= low <= high < count
        bad = [site for site in masked if low <= site <= high] if there else [low]
        if bad:
            named = f"{low}-{high}" if high != low and not there else f"{bad[0]}"
            without = f" except {', '.join(map(str, masked))} (masked)" if masked else ""
            raise error(
                f"{about} {named} cannot be driven: choose from the electrodes of {profile.name}, "
                f"0 to {count - 1}{without}",
                electrode=int(bad[0]),
            )
    return np.unique(np.concatenate([np.arange(low, high + 1) for low, high in ranges]))


_UPPER = (
    "current_ma", "pulse_us", "charge_uc", "rate_hz", "duty", "density_uc_cm2", "session_s",
    "session_mc",
)  # fmt: skip


def stricter(own: Profile, other: Profile) -> Profile:
    """Return a copy of ``own`` whose limits, comfort levels and masks are at least as strict as
    those of ``other``. Device, array, kernels and force law do not change. If the numbers of
    electrodes differ, the smallest current of ``other`` applies to all electrodes."""
    count = len(own.electrodes)
    same = len(other.electrodes) == count

    def matched(values: ArrayLike) -> NDArray[np.float64]:
        values = np.asarray(values, np.float64)
        return values if same else np.full(count, values.min())

    limits: dict[str, Any] = own.limits.model_dump()
    for key in _UPPER:
        limits[key] = min(limits[key], getattr(other.limits, key))
    limits["ramp_s"] = max(limits["ramp_s"], other.limits.ramp_s)
    total_ma = min(candidate.limits.total_ma or CEILING_TOTAL_MA for candidate in (own, other))
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
    # Single precision can round a current up, so first round lowered currents down to whole µA.
    lower = full_ma < own_ma * (1 - 1e-6)
    full_ma = np.where(lower, np.floor(1000 * full_ma - 1e-3) / 1000, own_ma)
    threshold_ma = np.minimum(own.threshold_ma, matched(other.threshold_ma))
    perception = own.perception.model_dump()
    if lower.any():
        perception["comfort_ma"] = tuple(full_ma.tolist())
    if (threshold_ma < own.threshold_ma).any():
        # Write ``comfort_ma``: otherwise, comfort levels would fall with the lowered thresholds.
        perception |= {
            "threshold_ma": tuple(threshold_ma.tolist()),
            "comfort_ma": tuple(full_ma.tolist()),
        }
    output = own.output.model_dump()
    output["masked"] = tuple(sorted({*own.output.masked, *(other.output.masked if same else ())}))
    tables = {"limits": limits, "pulse": pulse, "perception": perception, "output": output}
    if all(table == getattr(own, name).model_dump() for name, table in tables.items()):
        return own
    # Write ``share``. By default, it depends on whether ``limits.total_ma`` is given, so adding
    # this limit would allow several points in a slot.
    frames = own.frames.model_dump() | {"share": own.shares}
    return own.model_copy(update={**tables, "frames": frames})
