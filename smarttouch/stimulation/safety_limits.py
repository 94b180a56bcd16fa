"""Limits of all scan sequences, in integer µA, pC and ns."""

import math
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.errors import SafetyError
from smarttouch.base.tactile_image import one_line
from smarttouch.profile import Profile
from smarttouch.profile.profile_tables import Output
from smarttouch.profile.project_ceilings import (
    CEILING_AREA_MM2,
    CEILING_CHARGE_UC,
    CEILING_DENSITY_UC_CM2,
    CEILING_DUTY,
    CEILING_ELECTRODES,
    CEILING_MA,
    CEILING_PULSE_US,
    CEILING_RATE_HZ,
    CEILING_SESSION_MC,
    CEILING_SESSION_S,
    CEILING_SHANNON_K,
    CEILING_TOTAL_MA,
    SHORTEST_RAMP_S,
)

PPB = 1_000_000_000  # intensities are compared in parts per billion
LONGEST_RAMP_S = 10.0
RECHARGE_UA = 500  # largest recharge current of an electrode: a tenth of the ceiling of 5 mA
_DISC_MM2 = math.pi / 4

Each = float | tuple[float, ...]  # one value for all electrodes, or one for each


@dataclass(frozen=True)
class SafetyLimits:
    """Limits of every sequence for one finger on one board.

    Parameters
    ----------
    electrodes : int
    current_ma, pulse_us, charge_uc : float
        Limits of one pulse at one electrode.
    rate_hz, duty : float
        Largest number of sequences per second, and largest share of time in which current flows.
    ramp_s : float
        Shortest time from zero to full intensity.
    full_ma : float
        Largest current at intensity 1; the limit is proportional to intensity.
    total_ma : float
        Largest total current of all cathodes in one slot.
    electrode_ma : tuple of float, optional
        Largest current of each electrode.
    area_mm2 : float or tuple of float
        Areas of electrodes; by default that of a disc with a diameter of 1 mm.
    threshold_ma : float or tuple of float, optional
        Detection thresholds; by default half of ``full_ma``. Pulses of at least half a threshold
        count as perceptible.
    density_uc_cm2 : float
        Largest charge of a pulse per area of the electrode.
    session_s, session_mc : float
        Longest time with current, and largest charge through an electrode, while the board is open.
    one_source : bool
        Whether one source drives all electrodes. Then the total current must be safe for a single
        electrode, as the others may lose contact.
    masked : tuple of int
        Electrodes that carry no current.
    width_us : float, optional
        Width of a pulse of full strength; by default ``pulse_us``.

    Raises
    ------
    SafetyError
        If a limit is not a positive number, or is above the project's ceiling.
    """

    __repr__ = one_line

    electrodes: int
    current_ma: float
    pulse_us: float
    charge_uc: float
    rate_hz: float
    duty: float
    ramp_s: float
    full_ma: float
    total_ma: float = CEILING_TOTAL_MA
    electrode_ma: tuple[float, ...] | None = None
    area_mm2: Each = _DISC_MM2
    threshold_ma: Each | None = None
    density_uc_cm2: float = CEILING_DENSITY_UC_CM2
    session_s: float = CEILING_SESSION_S
    session_mc: float = CEILING_SESSION_MC
    one_source: bool = False
    masked: tuple[int, ...] = ()
    width_us: float | None = None

    def __post_init__(self) -> None:
        for name, least, upper in (
            ("electrodes", 1, CEILING_ELECTRODES),
            ("masked", 0, self.electrodes - 1),
            ("current_ma", 0.0, CEILING_MA),
            ("pulse_us", 0.0, CEILING_PULSE_US),
            ("charge_uc", 0.0, CEILING_CHARGE_UC),
            ("rate_hz", 0.0, CEILING_RATE_HZ),
            ("duty", 0.0, CEILING_DUTY),
            ("full_ma", 0.0, self.current_ma),
            ("total_ma", 0.0, CEILING_TOTAL_MA),
            ("width_us", 0.0, CEILING_PULSE_US),
            ("density_uc_cm2", 0.0, CEILING_DENSITY_UC_CM2),
            ("session_s", 0.0, CEILING_SESSION_S),
            ("session_mc", 0.0, CEILING_SESSION_MC),
            ("electrode_ma", 0.0, CEILING_MA),
            ("area_mm2", 0.0, CEILING_AREA_MM2),
            ("threshold_ma", 0.0, CEILING_MA),
            ("ramp_s", SHORTEST_RAMP_S, LONGEST_RAMP_S),
        ):
            values = getattr(self, name)
            if values is None:
                continue
            entries = values if isinstance(values, tuple) else (values,)
            if entries is values and name != "masked" and len(entries) != self.electrodes:
                raise SafetyError(
                    f"limit {name} has {len(entries)} values for {self.electrodes} electrodes",
                    limit=name, value=len(entries), allowed=self.electrodes,
                )  # fmt: skip
            for value in entries:
                _check(name, value, least, upper)

    @classmethod
    def of(cls, profile: Profile) -> "SafetyLimits":
        """Return the limits of a profile."""
        limits, pulse, output = profile.limits, profile.pulse, profile.output
        return cls(
            len(profile.electrodes), limits.current_ma, limits.pulse_us, limits.charge_uc,
            limits.rate_hz, limits.duty, limits.ramp_s, float(profile.full_ma.max()),
            total_ma=CEILING_TOTAL_MA if limits.total_ma is None else limits.total_ma,
            electrode_ma=limits.electrode_ma,
            area_mm2=tuple(profile.electrodes.area_mm2.tolist()),
            threshold_ma=tuple(profile.threshold_ma.tolist()),
            density_uc_cm2=limits.density_uc_cm2,
            session_s=limits.session_s, session_mc=limits.session_mc,
            one_source=output.kind != "weighted", masked=output.masked, width_us=pulse.width_us,
        )  # fmt: skip

    def on(self, output: Output | None) -> "SafetyLimits":
        """Return these limits, with `one_source` set if the output of the board has one source."""
        if output is None or output.kind == "weighted" or self.one_source:
            return self
        return replace(self, one_source=True)

    @cached_property
    def current_ua(self) -> NDArray[np.float64]:
        """Largest current of each electrode, (E,) µA."""
        listed_ma = self.electrode_ma or (self.current_ma,) * self.electrodes
        limit_ma = decimal(self.current_ma)
        limit_ua = [math.floor(1000 * min(limit_ma, decimal(limit))) for limit in listed_ma]
        return self._unmasked(np.array(limit_ua, np.float64))

    def _unmasked(self, values: NDArray[np.generic]) -> NDArray[Any]:
        """Set the limits of masked electrodes to zero, and return the array."""
        values[list(self.masked)] = 0
        return values

    @cached_property
    def charge_pc(self) -> NDArray[np.float64]:
        """Largest charge of a pulse at each electrode, (E,) pC: the smallest of the limits of
        charge, charge density and Shannon's k."""
        area = np.broadcast_to(np.asarray(self.area_mm2, np.float64), (self.electrodes,))
        charge = float(decimal(self.charge_uc) * 10**6)
        density = self.density_uc_cm2 * area * 1e4
        shannon = np.sqrt(10**CEILING_SHANNON_K * area / 100) * 1e6
        return np.floor(np.minimum(charge, np.minimum(density, shannon)))

    @cached_property
    def total_ua(self) -> int:
        """Largest total current of all cathodes in a slot, µA."""
        limit_ma = decimal(self.total_ma)
        return math.floor(
            1000 * (min(limit_ma, decimal(self.current_ma)) if self.one_source else limit_ma)
        )

    @cached_property
    def pulse_whole_us(self) -> int:
        return math.floor(decimal(self.pulse_us))

    @cached_property
    def period_us(self) -> int:
        """Shortest period, µs."""
        return math.ceil(10**6 / decimal(self.rate_hz))

    @cached_property
    def duty_ratio(self) -> tuple[int, int]:
        """Largest allowed share of time in which current flows, as a ratio of integers."""
        return decimal(self.duty).as_integer_ratio()

    @cached_property
    def ramp_ns(self) -> int:
        return round(decimal(self.ramp_s) * 10**9)

    @cached_property
    def rounding_ua(self) -> Fraction:
        """Largest rounding error, µA, at the electrode whose current balances all others."""
        return Fraction(self.electrodes, 2) + 1

    @cached_property
    def full_ua(self) -> Fraction:
        return Fraction(self.full_ma) * 1000

    @cached_property
    def width_whole_us(self) -> int:
        """Width of a full-strength pulse, µs."""
        width_us = self.pulse_us if self.width_us is None else self.width_us
        return max(1, math.floor(decimal(min(width_us, self.pulse_us))))

    @cached_property
    def full_ratio(self) -> tuple[int, int]:
        """`full_ua` as a ratio of integers."""
        return self.full_ua.as_integer_ratio()

    @cached_property
    def source_pc(self) -> float:
        """Largest charge of a slot on a board with one source, pC."""
        return float(decimal(self.charge_uc) * 10**6)

    @cached_property
    def felt_ua(self) -> NDArray[np.float32]:
        """Smallest perceptible current of a pulse at each electrode, (E,) µA."""
        felt_ua = [math.ceil(Fraction(threshold) * 500) for threshold in self._thresholds]
        return np.array(felt_ua, np.float32)

    @cached_property
    def faint_ua(self) -> NDArray[np.int64]:
        """Largest recharge current of each electrode, (E,) µA (see `recharge_most_ua`)."""
        return self._unmasked(recharge_most_ua(np.array(self._thresholds)))

    @property
    def _thresholds(self) -> tuple[float, ...]:
        threshold = self.full_ma / 2 if self.threshold_ma is None else self.threshold_ma
        return threshold if isinstance(threshold, tuple) else (threshold,) * self.electrodes


def _check(name: str, value: float, least: float, most: float) -> None:
    """Raise SafetyError unless a limit is from ``least`` to ``most``. If ``least`` is 0.0, the
    limit must be above zero. If ``least`` is an int, the limit must be an int."""
    if isinstance(least, int):
        fits = isinstance(value, (int, np.integer)) and not isinstance(value, bool)
        fits, words = fits and least <= value <= most, "a whole number, at least"
    else:
        # Reject NaN: every comparison with it is false, so it would not limit anything.
        fits = (least <= value if least else value > 0) and value <= most < math.inf
        words = "at least" if least else "above"
    if not fits:
        raise SafetyError(
            f"limit {name} = {value!r} must be {words} {least:g} and at most {most:g}",
            limit=name, value=value, allowed=most,
        )  # fmt: skip


def recharge_most_ua(threshold_ma: NDArray[np.floating]) -> NDArray[np.int64]:
    """Return the largest recharge current of each electrode, (E,) µA. It is a tenth of the
    electrode's threshold, but at most `RECHARGE_UA`."""
    tenths_ua = (math.floor(Fraction(float(threshold)) * 100) for threshold in threshold_ma)
    return np.array([min(RECHARGE_UA, tenth_ua) for tenth_ua in tenths_ua], np.int64)


def rms_ma_cm2(profile: Profile) -> float:
    """Return the largest r.m.s. current density of any electrode at full intensity, mA/cm²."""
    share = profile.pulse.width_us * 1e-6 * profile.pulse.rate_hz
    densest = float((profile.full_ma / (profile.electrodes.area_mm2 / 100)).max())
    return densest * math.sqrt(share)


@lru_cache(maxsize=256)
def decimal(value: float) -> Fraction:
    """Convert a number by its decimal notation, so that 2.4 becomes exactly 12/5."""
    return Fraction(repr(float(value)))


@lru_cache(maxsize=256)
def parts_per_billion(intensity: float) -> int:
    """Return an intensity in parts per billion, rounded up."""
    above, below = float(intensity).as_integer_ratio()
    return -(-above * PPB // below)


_SENTENCES = {
    "electrodes": "currents are for {value} electrodes, not {allowed}: use the board's profile",
    "intensity": "intensity {value} must lie between 0 and {allowed}",
    "time_ns": "time {value} ns must be at least 0 and below {allowed}",
    "vibration": "vibration has {value} values: give one for each of {allowed} electrodes",
    "vibrates": "a vibration of {value:g} must be from 0 to the intensity of the sequence, "
    "{allowed:.3f}",
    "rate_hz": "a period of {value} µs is not allowed: use at least {allowed} µs (limits.rate_hz) "
    "and at most one minute",
    "period_us": "slots and recharge phase take {value} µs, longer than the period of {allowed} "
    "µs: lower the rate",
    "duty": "current flows {value:.0%} of the time, above the limit of {allowed:.0%}: lower the "
    "rate",
    "pulse_us": "a pulse width of {value} µs must be above 0 and at most {allowed:g} µs",
    "discharge_us": "slot {slot}: a discharge of {value} µs is too short to remove the charge of a "
    "pulse: use {allowed} µs or more",
    "site": "site {value} is not an electrode: the last electrode is {allowed}",
    "balance": "slot {slot} is out of balance by {value} µA: currents must sum to {allowed}",
    "current_ma": "slot {slot}, electrode {electrode}: {value:.3f} mA is above the limit of "
    "{allowed:g} mA",
    "charge_uc": "slot {slot}, electrode {electrode}: {value:.3f} µC is above the limit of "
    "{allowed:g} µC",
    "total_ma": "slot {slot}: total current of {value:.3f} mA is above the limit of {allowed:g} mA",
    "source": "slot {slot}: {value:.3f} µC from one source are above the limit of a single "
    "electrode, {allowed:g} µC: lower the current or the pulse width",
    "claimed_ma": "the strongest current is {value:.3f} mA, but the stated intensity allows "
    "{allowed:.3f} mA: lower the current, or state a higher intensity",
    "recharge": "a recharge phase needs a width, {allowed} currents, and slots that precede it: "
    "add what is missing, or remove the phase",
    "recharge_us": "the recharge phase takes {value} µs, must take from 1 to {allowed} µs",
    "recharge_balance": "the recharge phase is out of balance by {value} µA: currents must sum to "
    "{allowed}",
    "recharge_ua": "electrode {electrode}: a recharge current of {value} µA is above {allowed} µA, "
    "the limit for a phase of this width",
    "recharge_ma": "the total current of the recharge phase is {value:.3f} mA, above the limit of "
    "{allowed:g} mA",
    "takes_back": "electrode {electrode}: the recharge phase carries {value:g} µC: to reduce "
    "the net charge, it must carry between 0 and {allowed:g} µC",
    "passes": "{value} sequences would be delivered within a second, and limits.rate_hz allows "
    "{allowed}: send sequences less often",
    "pulses_hz": "electrode {electrode}: {value:g} perceptible pulses in one pass or in one "
    "second, above the limit of {allowed:g}: lower the rate",
    "mean_ma": "electrode {electrode}: {value:g} µC in one pass or in one second, above the "
    "limit of {allowed:g} µC: lower the rate",
    "net_ma": "electrode {electrode}: the net charge in a second would be {value:g} µC, above the "
    "limit of {allowed:g} µC: lower the rate, or add recharge phases",
    "order": "the sequence has time {value} ns, which is not after the previous sequence: the time "
    "must be {allowed} ns or later",
    "ramp_s": "strength {value:.3f} is too far above the ramp's level of {allowed:.3f}: raise the "
    "intensity from zero to full in limits.ramp_s or longer",
    "session_s": "the session would have current for {value:.0f} s, and limits.session_s is "
    "{allowed:g}: take the finger off, look at the skin, and continue later",
    "session_mc": "electrode {electrode}: the session would pass {value:.0f} mC, and "
    "limits.session_mc is {allowed:g}: take the finger off, look at the skin, and continue later",
}
_LIMITS = {
    "vibrates": "vibration", "source": "charge_uc", "claimed_ma": "intensity",
    "recharge": "recharge_ua", "recharge_balance": "balance",
    "recharge_ma": "total_ma", "takes_back": "recharge_ua", "passes": "rate_hz",
    "order": "time_ns",
}  # fmt: skip
"""Names of limits (`SafetyError.limit`) that differ from their keys in `_SENTENCES`."""


def refusal(
    sentence: str,
    value: float,
    allowed: float,
    slot: int | None = None,
    electrode: int | None = None,
) -> SafetyError:
    """Return the error for an exceeded limit. ``sentence`` is the message's key in `_SENTENCES`."""
    words = _SENTENCES[sentence].format(
        value=value, allowed=allowed, slot=slot, electrode=electrode
    )
    return SafetyError(
        words, limit=_LIMITS.get(sentence, sentence), value=value, allowed=allowed,
        slot=slot, electrode=electrode,
    )  # fmt: skip
