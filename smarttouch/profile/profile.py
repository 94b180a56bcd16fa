"""A profile: one device on one finger."""

from collections.abc import Mapping
from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationError, model_validator

from smarttouch.electrodes import ElectrodeArray
from smarttouch.errors import ProfileError
from smarttouch.profile.array import ArrayLayout
from smarttouch.profile.ceilings import CEILING_TOTAL_MA
from smarttouch.profile.complaints import table_error
from smarttouch.profile.device import (
    Calibrated,
    CommandDefaults,
    ForceLaw,
    Frames,
    Limits,
    Optics,
    Output,
    PerceptThresholds,
    Pulse,
)
from smarttouch.profile.fit import misfits
from smarttouch.profile.kernels import Kernels
from smarttouch.profile.skin import Skin
from smarttouch.profile.table import Table, raise_all


class Profile(Table):
    """One device on one finger."""

    name: str = ""
    """Name of the file."""
    title: str = Field(min_length=1)
    """Description of the device, for people."""
    array: ArrayLayout
    skin: Skin
    output: Output
    optics: Optics
    force: ForceLaw
    pulse: Pulse
    limits: Limits
    perception: PerceptThresholds
    frames: Frames = Frames()
    kernels: Kernels = Kernels()
    defaults: CommandDefaults = CommandDefaults()
    calibrated: dict[str, Calibrated] = Field(default_factory=dict)

    def __repr__(self) -> str:
        kind = self.output.kind
        return f"Profile({self.name or self.title!r}, {len(self.electrodes)} electrodes, {kind})"

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
        """Largest comfortable current of each electrode, (E,) mA (magnitude)."""
        if self.perception.comfort_ma is not None:
            return np.asarray(self.perception.comfort_ma, np.float32)
        return self.threshold_ma * self.perception.comfort_ratio

    @property
    def shares(self) -> bool:
        """True if the profile allows points to share a slot."""
        given = self.limits.total_ma is not None
        return given if self.frames.share is None else self.frames.share

    @property
    def total_ma(self) -> float:
        """Largest current of all cathodes of a slot.

        One source drives the same current into however few electrodes still touch the skin: of a
        switched board it is no more than a single electrode may carry.
        """
        limits = self.limits
        total = limits.total_ma or CEILING_TOTAL_MA
        if self.output.kind == "weighted":
            return total
        return min(total, limits.current_ma, 1000 * limits.charge_uc / self.pulse.width_us)

    @property
    def design_total_ma(self) -> float | None:
        """Limit of total current in the design of kernels; None if none is needed.

        A total at the project's ceiling, which holds for all, says nothing of the kernels
        where points do not share slots.
        """
        total = self.limits.total_ma or CEILING_TOTAL_MA
        return total if self.shares or total < CEILING_TOTAL_MA else None

    @cached_property
    def admittance(self) -> NDArray[np.float64]:
        """Relative share of each electrode in a source's current, (E,)."""
        impedance = np.asarray(self.output.impedance_kohm, np.float64)
        return np.broadcast_to(1 / impedance, (len(self.electrodes),)).copy()

    @cached_property
    def driven(self) -> NDArray[np.intp]:
        """Electrodes that are not masked, in order."""
        return np.setdiff1d(np.arange(len(self.electrodes)), self.output.masked)

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Self:
        """Return a copy with other tables, checked as a file is.

        Parameters
        ----------
        update : mapping, optional
            Tables that take the place of those of the same name.
        deep : bool
            Whether values are copied too.

        Raises
        ------
        ProfileError
            If the copy says something unknown or impossible: all of it.

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

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        raise_all(misfits(self))
        return self
