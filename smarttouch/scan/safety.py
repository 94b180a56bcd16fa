"""What makes a scan sequence safe, proved on the sequence itself."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smarttouch.errors import SafetyError
from smarttouch.profile import (
    CEILING_CHARGE_UC,
    CEILING_MA,
    CEILING_PULSE_US,
    SHORTEST_RAMP_S,
    Profile,
)
from smarttouch.scan.sequence import ScanSequence


@dataclass(frozen=True)
class SafetyLimits:
    """What no sequence may exceed.

    Raises
    ------
    SafetyError
        If one of them is above the project's own ceilings.
    """

    electrodes: int
    current_ma: float
    pulse_us: float
    charge_uc: float
    rate_hz: float
    duty: float
    ramp_s: float
    full_ma: float
    """The strongest current at intensity 1; intensity bounds current in proportion."""
    total_ma: float | None = None
    """Of all cathodes together in one slot."""
    electrode_ma: tuple[float, ...] | None = None
    """Of each electrode by itself."""
    full_us: float | None = None
    """The longest pulse at intensity 1, where width carries intensity: it then bounds charge."""

    def __post_init__(self) -> None:
        for name, value, ceiling in (
            ("current_ma", self.current_ma, CEILING_MA),
            ("pulse_us", self.pulse_us, CEILING_PULSE_US),
            ("charge_uc", self.charge_uc, CEILING_CHARGE_UC),
            ("full_ma", self.full_ma, self.current_ma),
        ):
            if not 0 < value <= ceiling:
                raise SafetyError(f"limit {name} = {value} must be above 0 and at most {ceiling}")
        own = () if self.electrode_ma is None else self.electrode_ma
        if self.electrode_ma is not None and len(own) != self.electrodes:
            raise SafetyError(
                f"limit electrode_ma lists {len(own)} of {self.electrodes} electrodes"
            )
        total = () if self.total_ma is None else (self.total_ma,)
        for name, bounds in (("total_ma", total), ("electrode_ma", own)):
            # Nothing is above NaN: such a limit would be none.
            if not all(bound > 0 for bound in bounds):
                raise SafetyError(f"limit {name} = {bounds} must be above 0")
        if not self.ramp_s >= SHORTEST_RAMP_S:
            raise SafetyError(f"limit ramp_s = {self.ramp_s} must be at least {SHORTEST_RAMP_S}")

    @classmethod
    def of(cls, profile: Profile) -> "SafetyLimits":
        limits = profile.limits
        return cls(
            electrodes=len(profile.electrodes),
            current_ma=limits.current_ma,
            pulse_us=limits.pulse_us,
            charge_uc=limits.charge_uc,
            rate_hz=limits.rate_hz,
            duty=limits.duty,
            ramp_s=limits.ramp_s,
            full_ma=float(profile.full_ma.max()),
            total_ma=limits.total_ma,
            electrode_ma=limits.electrode_ma,
            full_us=profile.pulse.width_us if profile.pulse.carrier == "width" else None,
        )


class SafetyGate:
    """Proves sequences one after another; remembers the last for the slew limit.

    Parameters
    ----------
    limits : SafetyLimits
        What to hold every sequence to.
    """

    def __init__(self, limits: SafetyLimits) -> None:
        self.limits = limits
        self._intensity = 0.0
        self._time_ns: int | None = None

    def prove(self, sequence: ScanSequence) -> None:
        """Raise unless the sequence keeps every limit.

        Checked: array sizes, charge balance of every slot, current of every
        electrode and of all together, pulse width, charge per pulse, current
        and vibration against stated intensity, rate, duty, that the slots fit the period,
        and the rise of intensity since the sequence before.

        Raises
        ------
        SafetyError
            Naming the limit, the slot and electrode, and by how much.
        """
        self.prove_measurement(sequence)
        self._prove_slew(sequence)
        self._intensity = sequence.intensity
        self._time_ns = sequence.time_ns

    def prove_measurement(self, sequence: ScanSequence) -> None:
        """Raise unless a single scan keeps every limit but the rise since the one before.

        For boards that measure with a pulse that their firmware fixes: it cannot
        be ramped, and comes only when a user asks for it.
        """
        self._prove_shape(sequence)
        self._prove_timing(sequence)
        if sequence.slots:
            self._prove_pulses(sequence)
        if sequence.vibration is not None:
            self._prove_vibration(sequence.vibration, sequence.intensity)

    def _prove_shape(self, sequence: ScanSequence) -> None:
        currents, slots = sequence.current_ua, sequence.slots
        if currents.dtype != np.int16 or currents.shape != (slots, self.limits.electrodes):
            raise SafetyError(
                f"currents are {currents.dtype} {currents.shape}, must be int16 "
                f"({slots}, {self.limits.electrodes})"
            )
        for name in ("width_us", "discharge_us", "site"):
            values = getattr(sequence, name)
            if values.dtype != np.uint16 or values.shape != (slots,):
                raise SafetyError(f"{name} is {values.dtype} {values.shape}, must be uint16 (S,)")

    def _prove_vibration(self, vibration: NDArray[np.float32], intensity: float) -> None:
        electrodes = self.limits.electrodes
        if vibration.dtype != np.float32 or vibration.shape != (electrodes,):
            raise SafetyError(
                f"vibration is {vibration.dtype} {vibration.shape}, must be float32 ({electrodes},)"
            )
        # Not "any above": nothing is above NaN.
        if not ((vibration >= 0) & (vibration <= intensity + _LEEWAY)).all():
            raise SafetyError(
                f"vibration from {vibration.min():g} to {vibration.max():g} is not between 0 and "
                f"the intensity {intensity:.3f} that was stated"
            )

    def _prove_timing(self, sequence: ScanSequence) -> None:
        if sequence.period_us <= 0 or sequence.rate_hz > self.limits.rate_hz * (1 + 1e-9):
            raise SafetyError(
                f"a period of {sequence.period_us} µs is faster than the limit of "
                f"{self.limits.rate_hz:g} Hz"
            )
        pulses = int(sequence.width_us.sum(dtype=np.int64))
        busy = pulses + int(sequence.discharge_us.sum(dtype=np.int64))
        if busy > sequence.period_us:
            raise SafetyError(
                f"{sequence.slots} slots take {busy} µs, longer than the period of "
                f"{sequence.period_us} µs: lower the rate"
            )
        if pulses > self.limits.duty * sequence.period_us:
            raise SafetyError(
                f"current flows {pulses / sequence.period_us:.0%} of the time, above the "
                f"limit of {self.limits.duty:.0%}: lower the rate"
            )

    def _prove_pulses(self, sequence: ScanSequence) -> None:
        limits, currents, widths = self.limits, sequence.current_ua, sequence.width_us
        sums = currents.sum(axis=1, dtype=np.int32)
        if sums.any():
            slot = int(np.argmax(np.abs(sums)))
            raise SafetyError(
                f"slot {slot} is out of balance by {int(sums[slot])} µA: currents must sum to zero"
            )
        width = int(widths.max())
        if width > limits.pulse_us or int(widths.min()) == 0:
            raise SafetyError(
                f"pulse widths run from {int(widths.min())} to {width} µs: they must be above 0 "
                f"and at most {limits.pulse_us:g} µs"
            )
        peaks = _peak_ua(currents)
        peak = int(peaks.max())
        if peak > limits.current_ma * 1000:
            slot = int(np.argmax(peaks))
            electrode = int(np.argmax(np.abs(currents[slot].astype(np.int32))))
            raise SafetyError(
                f"slot {slot}, electrode {electrode}: {peak / 1000:.3f} mA is above the limit of "
                f"{limits.current_ma:g} mA"
            )
        if limits.total_ma is not None:
            # In balance: what flows in is what flows out.
            totals = currents.sum(axis=1, dtype=np.int64, where=currents > 0)
            if totals.max() > limits.total_ma * 1000:
                raise SafetyError(
                    f"slot {int(totals.argmax())}: {totals.max() / 1000:.3f} mA flow in all, above "
                    f"the limit of {limits.total_ma:g} mA"
                )
        if limits.electrode_ma is not None:
            strongest = np.abs(currents).max(axis=0) / 1000
            over = strongest > limits.electrode_ma
            if over.any():
                electrode = int(over.argmax())
                raise SafetyError(
                    f"electrode {electrode}: {strongest[electrode]:.3f} mA is above its own limit "
                    f"of {limits.electrode_ma[electrode]:g} mA"
                )
        charges = peaks * widths
        charge = int(charges.max())
        if charge > limits.charge_uc * 1e6:
            raise SafetyError(
                f"slot {int(np.argmax(charges))}: {charge / 1e6:.3f} µC is above the limit of "
                f"{limits.charge_uc:g} µC per pulse"
            )
        self._prove_intensity(sequence.intensity, peaks, charges)

    def _prove_intensity(
        self, intensity: float, peaks: NDArray[np.int64], charges: NDArray[np.int64]
    ) -> None:
        """Raise unless current, or charge where width carries intensity, is in proportion to it."""
        limits = self.limits
        # Rounding every electrode to whole µA may shift the one that keeps the balance.
        rounding = limits.electrodes / 2 + 1
        full_ua = limits.full_ma * 1000 + rounding
        allowed = intensity * limits.full_ma * 1000 + rounding
        if limits.full_us is not None:
            allowed = full_ua
            allowed_pc = intensity * full_ua * limits.full_us
            # Pulses have whole microseconds, rounded down but for what single precision loses.
            if charges.max() > allowed_pc * (1 + 1e-3):
                raise SafetyError(
                    f"slot {int(np.argmax(charges))}: {charges.max() / 1e6:.3f} µC is more than "
                    f"intensity {intensity:.3f} allows, {allowed_pc / 1e6:.3f} µC"
                )
        if peaks.max() > allowed:
            raise SafetyError(
                f"slot {int(np.argmax(peaks))}: {peaks.max() / 1000:.3f} mA is more than intensity "
                f"{intensity:.3f} allows, {allowed / 1000:.3f} mA"
            )

    def _prove_slew(self, sequence: ScanSequence) -> None:
        if not 0 <= sequence.intensity <= 1:
            raise SafetyError(f"intensity {sequence.intensity} must lie between 0 and 1")
        if self._time_ns is not None and sequence.time_ns <= self._time_ns:
            raise SafetyError(
                f"sequence at {sequence.time_ns} ns does not follow the one at {self._time_ns} ns"
            )
        allowed = self._intensity + _LEEWAY
        if self._time_ns is not None:
            allowed += (sequence.time_ns - self._time_ns) / 1e9 / self.limits.ramp_s
        if sequence.intensity > allowed:
            raise SafetyError(
                f"intensity rises from {self._intensity:.3f} to {sequence.intensity:.3f}: "
                f"zero to full must take {self.limits.ramp_s:g} s or more"
            )


_LEEWAY = 1e-6
"""Rounding of the ramp's sum."""


def _peak_ua(currents: NDArray[np.int16]) -> NDArray[np.int64]:
    # int16's most negative value has no positive twin: widen before negating.
    high = currents.max(axis=1).astype(np.int64)
    low = currents.min(axis=1).astype(np.int64)
    return np.asarray(np.maximum(high, -low))
