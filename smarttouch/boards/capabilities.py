"""Capabilities of a board, and its delivery report."""

from dataclasses import dataclass
from itertools import compress
from typing import Literal

import numpy as np

from smarttouch.errors import BoardError
from smarttouch.stimulation.sequence import ScanSequence

Polarity = Literal["anodic", "cathodic"]
LONGEST_REPEAT = 0xFFFF
BOTH: tuple[Polarity, ...] = ("anodic", "cathodic")


@dataclass(frozen=True)
class Capabilities:
    """Capabilities of a board."""

    electrodes: int
    output: Literal["weighted", "three-state", "one-against-all", "vibration"]
    max_current_ma: float
    max_slots: int
    time_to_zero_ms: float | None
    """Longest time from the host's silence to zero current; None if it has no limit."""
    firmware: str
    polarities: tuple[Polarity, ...] = BOTH
    clock: Literal["board", "host"] = "board"
    """Clock by which pulses are timed."""
    acknowledges: bool = True
    measures: bool = False
    """Whether it measures the voltage of each slot."""
    force: bool = False
    """Whether it measures the finger's force."""
    compliance_v: float | None = None
    """Compliance voltage of its source, if it is known."""
    vibrates: bool = False
    """Whether it has mechanical vibrators."""
    recharges: bool = False
    """Whether it can end a scan with a recharge phase."""
    emergency_switch: bool = False
    """Whether it has an emergency switch."""
    protocol: str = ""
    """Protocol that it speaks, with the version."""
    kernel_bytes: int = 0
    """Room for kernels that it keeps."""
    most_kernels: int = 0
    """Most kernels that it keeps."""
    packet_bytes: int | None = None
    """Largest packet that it takes, before it is encoded, if that has a limit."""
    kept_ms: float | None = None
    """Longest time from the end of this program to zero, if a keeper process ensures that."""

    def require(self, sequence: ScanSequence, times: int) -> None:
        """Raise BoardError unless the board can deliver a sequence a number of times."""
        if (electrodes := sequence.current_ua.shape[1]) != self.electrodes:
            raise BoardError(
                f"the sequence is for {electrodes} electrodes, the board has "
                f"{self.electrodes}: use the profile of this board",
                about="electrodes",
            )
        if sequence.vibration is not None and not self.vibrates:
            raise BoardError(
                "the sequence asks for mechanical vibration, and this board has no vibrators: "
                "give it some",
                about="vibration",
                remedy="vibrators",
            )
        if sequence.recharge_ua is not None and not self.recharges:
            raise BoardError(
                "the sequence ends with a recharge phase, and this board makes none: leave it out",
                about="recharge_ua",
            )
        whole = isinstance(times, (int, np.integer)) and not isinstance(times, bool)
        if not whole or not 1 <= times <= LONGEST_REPEAT:
            raise BoardError(
                f"{times} repetitions are not possible: a whole number from 1 to {LONGEST_REPEAT}",
                about="times",
            )

    def describe(self) -> list[tuple[str, str]]:
        """Return the capabilities as names and values, for display."""
        silence = "goes on with its last pattern for ever: lift the finger before you unplug it"
        if self.time_to_zero_ms is not None:
            silence = f"no current {self.time_to_zero_ms:g} ms after the host falls silent"
        if self.kept_ms is not None:
            silence = (
                f"zero {self.kept_ms:g} ms after the program ends or hangs; by itself {silence}"
            )
        names = ("acknowledgments", "voltages", "finger force")
        reported = compress(names, (self.acknowledges, self.measures, self.force))
        return [
            ("firmware", self.firmware),
            *([("protocol", self.protocol)] if self.protocol else []),
            ("electrodes", f"{self.electrodes}, {self.output}, {' or '.join(self.polarities)}"),
            ("current", f"at most {self.max_current_ma:.1f} mA"),
            ("clock", f"the {self.clock}'s"),
            ("host lost", silence),
            *([("emergency", "switch, closed")] if self.emergency_switch else []),
            ("while it scans", "tells of " + (", ".join(reported) or "nothing")),
        ]


@dataclass(frozen=True)
class BoardReport:
    """Report of what a board delivered since it was opened."""

    sequences: int
    slots: int
    pulses: int
    """Number of electrode pulses: one for each electrode with current in a slot."""
    violations: int
    max_current_ma: float
    max_charge_uc: float
    max_net_charge_uc: float
    """Largest charge left on an electrode: after a discharge; in a host's report, of all pulses."""
    refused_packets: int = 0
    """Number of packets refused by the board, as old or of another session."""
    by: Literal["board", "host"] = "board"
    """Author of the report; a host reports what was scanned as far as it can know."""
    most_pulses: int | None = None
    """Upper bound, if a host knows only a range; pulses and slots are then lower bounds."""
