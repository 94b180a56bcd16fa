"""A profile: one device on one finger."""

from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from smarttouch.electrodes import ElectrodeArray
from smarttouch.profile.array import ArrayLayout
from smarttouch.profile.ceilings import CEILING_TOTAL_MA
from smarttouch.profile.device import (
    Calibrated,
    ForceLaw,
    Frames,
    Limits,
    Optics,
    Output,
    Perception,
    Pulse,
)
from smarttouch.profile.skin import Skin
from smarttouch.profile.table import Table, UnfitError


class Profile(Table):
    """One device on one finger."""

    name: str = ""
    title: str = Field(min_length=1)
    array: ArrayLayout
    skin: Skin
    output: Output
    optics: Optics
    force: ForceLaw
    pulse: Pulse
    limits: Limits
    perception: Perception
    frames: Frames = Frames()
    calibrated: dict[str, Calibrated] = Field(default_factory=dict)

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
        """Strongest comfortable current of each electrode, (E,) mA (magnitude)."""
        if self.perception.comfort_ma is not None:
            return np.asarray(self.perception.comfort_ma, np.float32)
        return self.threshold_ma * self.perception.comfort_ratio

    @property
    def shares(self) -> bool:
        """Whether points may share a slot, as far as the profile goes."""
        given = self.limits.total_ma is not None
        return given if self.frames.share is None else self.frames.share

    @property
    def design_total_ma(self) -> float | None:
        """Total current that kernels are designed within; None where none needs to be.

        A total at the project's ceiling, which holds for all, says nothing of the kernels
        where points do not share slots.
        """
        total = self.limits.total_ma or CEILING_TOTAL_MA
        return total if self.shares or total < CEILING_TOTAL_MA else None

    @cached_property
    def admittance(self) -> NDArray[np.float64]:
        """What share each electrode takes of a source, (E,), relative."""
        impedance = np.asarray(self.output.impedance_kohm, np.float64)
        return np.broadcast_to(1 / impedance, (len(self.electrodes),)).copy()

    @cached_property
    def driven(self) -> NDArray[np.intp]:
        """The electrodes that are not masked, in order."""
        return np.setdiff1d(np.arange(len(self.electrodes)), self.output.masked)

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        count = len(self.electrodes)
        masked, wiring = self.output.masked, self.output.wiring
        if max(masked, default=0) >= count:
            raise UnfitError(
                f"output.masked lists {max(masked)}, the array has electrodes 0 to {count - 1}: "
                "remove it",
                about="output.masked",
                problem="too large",
                value=max(masked),
                allowed=count - 1,
            )
        if count - len(masked) < 2:
            raise UnfitError(
                f"output.masked leaves {count - len(masked)} of {count} electrodes: current needs "
                "at least two, shorten the list or repair the array",
                about="output.masked",
                problem="too many",
                value=len(masked),
                allowed=count - 2,
            )
        if wiring is not None and len(wiring) != count:
            raise _of_another_length("output.wiring", len(wiring), count, "leave it out")
        for key, values in (
            ("perception.threshold_ma", self.perception.threshold_ma),
            ("perception.comfort_ma", self.perception.comfort_ma),
            ("output.impedance_kohm", self.output.impedance_kohm),
        ):
            if isinstance(values, tuple) and len(values) != count:
                raise _of_another_length(key, len(values), count, "one for all")
        if self.skin.medium == "plane" and self.array.layout != "lines":
            raise UnfitError(
                f"skin.medium 'plane' does not go with array.layout {self.array.layout!r}: "
                "it is for 'lines'; 'half-space' is for all",
                about="skin.medium",
                problem="conflict",
                value="plane",
                allowed=("half-space",),
                remedy="array.layout",
            )
        lowered = self.limits.electrode_ma
        if lowered is not None and len(lowered) != count:
            raise _of_another_length("limits.electrode_ma", len(lowered), count, "leave it out")
        full_ma = self.full_ma
        measured = self.perception.comfort_ma is not None
        strongest_of = "comfort_ma" if measured else "threshold_ma × comfort_ratio"
        strongest_key = "perception." + ("comfort_ma" if measured else "comfort_ratio")
        painful = full_ma <= self.threshold_ma
        if painful.any():
            index = int(painful.argmax())
            raise UnfitError(
                f"comfort_ma is {full_ma[index]:.2f} mA at electrode {index}, not above its "
                f"threshold_ma of {self.threshold_ma[index]:.2f}: measure both again",
                about="perception.comfort_ma",
                problem="too small",
                value=float(full_ma[index]),
                allowed=float(self.threshold_ma[index]),
                electrode=index,
            )
        # Thresholds are single precision: a limit of just their product is kept.
        over = full_ma > np.multiply(np.inf if lowered is None else lowered, 1 + 1e-6)
        if lowered is not None and over.any():
            index = int(over.argmax())
            raise UnfitError(
                f"{strongest_of} is {full_ma[index]:.2f} mA at electrode {index}, "
                f"above its limits.electrode_ma {lowered[index]:g}: lower one of the two",
                about="limits.electrode_ma",
                problem="too large",
                value=float(full_ma[index]),
                allowed=lowered[index],
                remedy=strongest_key,
                electrode=index,
            )
        strongest = float(full_ma.max())
        if strongest > self.limits.current_ma:
            raise UnfitError(
                f"{strongest_of} reaches {strongest:.2f} mA, above "
                f"limits.current_ma {self.limits.current_ma}: lower one of the two",
                about="limits.current_ma",
                problem="too large",
                value=strongest,
                allowed=self.limits.current_ma,
                remedy=strongest_key,
            )
        total = self.limits.total_ma
        if total is not None and total < strongest:
            raise UnfitError(
                f"limits.total_ma {total:g} is below the {strongest:.2f} mA that {strongest_of} "
                "sends through one electrode: raise it, or lower one of the two",
                about="limits.total_ma",
                problem="too large",
                value=strongest,
                allowed=total,
                remedy=strongest_key,
            )
        if self.pulse.width_us > self.limits.pulse_us:
            raise UnfitError(
                f"pulse.width_us {self.pulse.width_us} is above limits.pulse_us "
                f"{self.limits.pulse_us:g}: lower it",
                about="pulse.width_us",
                problem="too large",
                value=self.pulse.width_us,
                allowed=self.limits.pulse_us,
            )
        charge = strongest * self.pulse.width_us / 1000
        if charge > self.limits.charge_uc:
            raise UnfitError(
                f"the strongest pulse carries {charge:.3f} µC, above limits.charge_uc "
                f"{self.limits.charge_uc}: lower {strongest_of} or pulse.width_us",
                about="limits.charge_uc",
                problem="too large",
                value=charge,
                allowed=self.limits.charge_uc,
                remedy=strongest_key,
            )
        return self


def _of_another_length(key: str, numbers: int, electrodes: int, otherwise: str) -> UnfitError:
    return UnfitError(
        f"{key} lists {numbers} electrodes, the array has {electrodes}: "
        f"give {electrodes} numbers, or {otherwise}",
        about=key,
        problem="too few" if numbers < electrodes else "too many",
        value=numbers,
        allowed=electrodes,
    )
