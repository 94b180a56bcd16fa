"""Limits of a session with an emulated ``link`` board, those of its firmware, and loads."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smarttouch.boards.link.protocol import LIMITS, Output

MAX_CURRENT_UA = 5000
MAX_TOTAL_UA = 10_000
MAX_WIDTH_US = 200
MAX_CHARGE_PC = 500_000
MIN_PERIOD_US = 5000
MAX_SLOTS = 4096
MIN_DISCHARGE_US = 20
MAX_DUTY_PERCENT = 80
MAX_MEAN_UA = 500
MAX_FELT_UA = 2500
MAX_PULSES_HZ = 1500
BURST_US = 40_000
MIN_RAMP_MS, MAX_RAMP_MS = 500, 10_000
MAX_SESSION_S, MAX_SESSION_UC = 3600, 1_800_000
MAX_RECHARGE_UA = 500
"""Limit of a recharge phase, a tenth of the strongest pulse, as the board has no thresholds."""
MAX_RECHARGE_US = 20_000
MAX_RECHARGE_PC = 2_000_000
FULL = 0xFFFF
STRENGTH = 4  # multiple of a pulse's share of a full one that its strength is at most


@dataclass(frozen=True, eq=False)
class SessionLimits:
    """Limits of a session: the host's, or the board's own where these are stricter."""

    period_us: int
    total_ua: int
    width_us: int
    full_ua: int
    rounding_ua: int
    full_us: int
    ramp_ms: int
    session_us: int
    session_pc: int
    duty_percent: int
    full_pc: int
    current_ua: NDArray[np.int64]
    felt_ua: NDArray[np.int64]
    charge_pc: NDArray[np.int64]

    @classmethod
    def of(cls, payload: bytes, electrodes: int, output: Output) -> "SessionLimits | None":
        """Return the limits in a payload; None if it is invalid."""
        if len(payload) != LIMITS.size + 8 * electrodes:
            return None
        (
            period, total, width, full, rounding, full_us, ramp, session_s, session_uc, duty,
            _, usual,
        ) = LIMITS.unpack_from(payload)  # fmt: skip
        at = LIMITS.size
        current = np.frombuffer(payload, "<u2", electrodes, at).astype(np.int64)
        felt = np.frombuffer(payload, "<u2", electrodes, at + 2 * electrodes).astype(np.int64)
        charge = np.frombuffer(payload, "<u4", electrodes, at + 4 * electrodes).astype(np.int64)
        most = MAX_TOTAL_UA if output == "weighted" else MAX_CURRENT_UA
        return cls(
            max(period, MIN_PERIOD_US), min(total, most), min(width, MAX_WIDTH_US),
            min(full, MAX_CURRENT_UA), min(rounding, -(-electrodes // 2) + 1),
            min(full_us, MAX_WIDTH_US), max(ramp or MAX_RAMP_MS, MIN_RAMP_MS),
            10**6 * min(session_s, MAX_SESSION_S), 10**6 * min(session_uc, MAX_SESSION_UC),
            min(duty, MAX_DUTY_PERCENT), min(full, MAX_CURRENT_UA) * min(usual, MAX_WIDTH_US),
            np.minimum(current, MAX_CURRENT_UA),
            np.minimum(felt, MAX_FELT_UA), np.minimum(charge, MAX_CHARGE_PC),
        )  # fmt: skip

    def strength(self, intensity: int, peak_pc: int) -> int:
        """Return what an intensity amounts to with pulses of such a charge, of `FULL`."""
        share = -(-peak_pc * FULL // self.full_pc) if self.full_pc else FULL * (peak_pc > 0)
        return min(FULL, max(share, min(intensity, STRENGTH * share)))


@dataclass(eq=False)
class Load:
    """What one pass of a sequence brings to each electrode, (E,) int64."""

    felt: NDArray[np.int64]  # pulses that count as felt
    # charge_pc, net_pc: of either sign, and signed, positive cathodic; with the recharge phase
    charge_pc: NDArray[np.int64]
    net_pc: NDArray[np.int64]
    peak_pc: int = 0  # largest charge of one pulse; 0 if no current flows
    # busy_us, pulses_us: time of its slots and recharge phase, and of their current
    busy_us: int = 0
    pulses_us: int = 0

    @classmethod
    def none(cls, electrodes: int) -> "Load":
        return cls(*np.zeros((3, electrodes), np.int64))

    def plus(self, other: "Load") -> "Load":
        """Return the load of both one after the other."""
        return Load(
            self.felt + other.felt, self.charge_pc + other.charge_pc, self.net_pc + other.net_pc,
            max(self.peak_pc, other.peak_pc), self.busy_us + other.busy_us,
            self.pulses_us + other.pulses_us,
        )  # fmt: skip

    def add(
        self, signed_ua: NDArray[np.int64], width_us: NDArray[np.int64], felt_ua: NDArray[np.int64]
    ) -> None:
        """Add slots: currents (S, E) µA and widths (S,) µs."""
        each = np.abs(signed_ua)
        self.felt += ((each >= felt_ua) & (each > 0)).sum(axis=0)
        self.charge_pc += width_us @ each
        self.net_pc += width_us @ signed_ua
