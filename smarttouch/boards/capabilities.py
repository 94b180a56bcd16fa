"""What a board can do, and its account of what it did."""

from dataclasses import dataclass
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
    """Longest time from the host's silence to no current; None if it goes on for ever."""
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

    def describe(self) -> list[tuple[str, str]]:
        """Return what there is to tell a user, as names and values."""
        silence = (
            "goes on with its last pattern for ever: lift the finger before you unplug the host"
            if self.time_to_zero_ms is None
            else f"no current {self.time_to_zero_ms:g} ms after the host falls silent"
        )
        told = [
            name
            for name, has in (
                ("acknowledgments", self.acknowledges),
                ("voltages", self.measures),
                ("finger force", self.force),
            )
            if has
        ]
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
    """Worst electrode's charge left: after a slot's discharge by the board's books, by the
    host's the sum of all pulses."""
    by: Literal["board", "host"] = "board"
    """Whose account it is; a host's is of what it sent."""
