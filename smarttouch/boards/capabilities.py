"""What a board can do, and its account of what it did."""

from dataclasses import dataclass
from itertools import compress
from typing import Literal

Polarity = Literal["anodic", "cathodic"]
BOTH: tuple[Polarity, ...] = ("anodic", "cathodic")


@dataclass(frozen=True)
class Capabilities:
    """What a board can do, and what it cannot."""

    electrodes: int
    output: Literal["weighted", "three-state", "one-against-all", "vibration"]
    max_current_ma: float
    max_slots: int
    time_to_zero_ms: float | None
    """Longest time from the host's silence to no current; None if it may go on for ever."""
    firmware: str
    polarities: tuple[Polarity, ...] = BOTH
    clock: Literal["board", "host"] = "board"
    """Whose clock the pulses leave on."""
    acknowledges: bool = True
    measures: bool = False
    """Whether it tells the voltage that a slot needed."""
    force: bool = False
    """Whether it tells how hard the finger presses."""
    compliance_v: float | None = None
    """The most its source can give, if it is known."""
    vibrates: bool = False
    """Whether mechanical vibrators are part of it."""
    recharges: bool = False
    """Whether it can end a scan with a recharge phase."""
    kept_ms: float | None = None
    """Longest time from the end of this program to zero, where a process beside it sees to that."""

    def describe(self) -> list[tuple[str, str]]:
        """Return what there is to tell a user, as names and values."""
        silence = "goes on with its last pattern for ever: lift the finger before you unplug it"
        if self.time_to_zero_ms is not None:
            silence = f"no current {self.time_to_zero_ms:g} ms after the host falls silent"
        if self.kept_ms is not None:
            silence = (
                f"zero {self.kept_ms:g} ms after the program ends or hangs; by itself {silence}"
            )
        names = ("acknowledgments", "voltages", "finger force")
        told = compress(names, (self.acknowledges, self.measures, self.force))
        return [
            ("firmware", self.firmware),
            ("electrodes", f"{self.electrodes}, {self.output}, {' or '.join(self.polarities)}"),
            ("current", f"at most {self.max_current_ma:.1f} mA"),
            ("clock", f"the {self.clock}'s"),
            ("host lost", silence),
            ("while it scans", "tells of " + (", ".join(told) or "nothing")),
        ]


@dataclass(frozen=True)
class BoardReport:
    """Account of what a board delivered since it was opened."""

    sequences: int
    slots: int
    pulses: int
    """Electrode pulses: one for each electrode that carried current in a slot."""
    violations: int
    max_current_ma: float
    max_charge_uc: float
    max_net_charge_uc: float
    """Most charge left on an electrode: after a discharge; by the host's books, of all pulses."""
    refused_packets: int = 0
    """Old packets, and those of other sessions, that reached the board."""
    by: Literal["board", "host"] = "board"
    """Whose account it is; a host's is of what was scanned, as far as it can know."""
    most_pulses: int | None = None
    """By a host that knows only a range; pulses and slots are then the least."""
