"""Reports of a board: its capabilities, delivery statistics, impedances and faults."""

import hashlib
import time
from dataclasses import dataclass, replace
from itertools import compress
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from platformdirs import user_state_path

from smarttouch.base.files import make_folder, write_bytes
from smarttouch.stimulation.recharge import ChargeBalance
from smarttouch.stimulation.scan_sequence import ScanSequence

Polarity = Literal["anodic", "cathodic"]
LONGEST_REPEAT = 0xFFFF


@dataclass(frozen=True)
class Capabilities:
    """Capabilities of a board."""

    electrodes: int
    output: Literal["weighted", "three-state", "one-against-all"]
    max_current_ma: float
    max_slots: int
    time_to_zero_ms: float | None
    """Longest time from the host's silence to zero current; None if it has no limit."""
    firmware: str
    polarities: tuple[Polarity, ...] = ("anodic", "cathodic")
    acknowledges: bool = False
    """Whether it reports when each sequence begins."""
    host_timed: bool = False
    """Whether this program times its passes: `Driver.write` lasts as long as they do, and reports
    each. The board's sender thread calls it; a newer sequence replaces one that waits."""
    measures: bool = False
    """Whether it measures the voltage of each slot."""
    force: bool = False
    """Whether it measures the finger's force."""
    compliance_v: float | None = None
    """Compliance voltage of its source, if it is known."""
    load_kohm: float | None = None
    """Load that the board has beside the skin, if any: it takes a part of the current."""
    recharges: bool = False
    """Whether it can end a scan with a recharge phase."""
    emergency_switch: bool = False
    """Whether it has an emergency switch."""
    kernel_bytes: int = 0
    """Room for kernels that it keeps."""
    most_kernels: int = 0
    """Most kernels that it keeps."""
    packet_bytes: int | None = None
    """Largest packet that it takes, before it is encoded, if that has a limit."""
    kept_ms: float | None = None
    """Longest time from the end of this program to zero, if a watchdog process ensures that."""

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
            ("electrodes", f"{self.electrodes}, {self.output}, {' or '.join(self.polarities)}"),
            ("current", f"at most {self.max_current_ma:.1f} mA"),
            ("host lost", silence),
            *([("emergency", "switch, closed")] if self.emergency_switch else []),
            ("while it scans", "reports " + (", ".join(reported) or "nothing")),
        ]


@dataclass(frozen=True)
class SequenceStart:
    """When a sequence began.

    Attributes
    ----------
    number : int
        The sequence's, as `Board.send` returned it.
    time_ns : int
        By `Board.clock`; too late by the shortest delay of the line.
    board_us : int, µs
        By the board's own clock, since it was switched on.
    """

    number: int
    time_ns: int
    board_us: int


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
    is_busy: bool = False
    """Whether the board still has sequences to deliver."""
    refused_by_host: int = 0
    """Number of packets from the board that were old, of another session, or not requested."""
    by: Literal["board", "host"] = "board"
    """Author of the report; a host reports what was scanned as far as it can know."""
    most_pulses: int | None = None
    """Upper bound, if a host knows only a range; pulses and slots are then lower bounds."""


class HostStatistics:
    """Delivery statistics kept by the host, in ``report``."""

    def __init__(self, electrodes: int) -> None:
        self.report: BoardReport = BoardReport(0, 0, 0, 0, 0.0, 0.0, 0.0, by="host", most_pulses=0)
        self._ledger, self._unsure_uc = ChargeBalance(electrodes), np.zeros(electrodes)

    def add(
        self, sequence: ScanSequence, times: int = 1, again: bool = False, most: int | None = None
    ) -> None:
        """Add a sequence that was scanned ``times`` times, or at least that and at most ``most``
        times; ``again`` if the sequence itself has been counted before."""
        most, old = times if most is None else most, self.report
        pulses = int(np.count_nonzero(sequence.current_ua))
        peaks_ua = np.abs(sequence.current_ua.astype(np.int32)).max(axis=1) * (most > 0)
        charges_pc = peaks_ua * sequence.width_us
        self._ledger.add(sequence, times)
        # Of each electrode, whatever its sign.
        each_uc = sequence.width_us @ np.abs(sequence.current_ua.astype(np.int64)) / 1e6
        self._unsure_uc = self._unsure_uc + (most - times) * each_uc
        net_uc = self._ledger.worst_uc + float(self._unsure_uc.max())
        self.report = replace(
            old,
            sequences=old.sequences + (not again),
            slots=old.slots + times * sequence.slots,
            pulses=old.pulses + times * pulses,
            most_pulses=(old.most_pulses or 0) + most * pulses,
            max_current_ma=max(old.max_current_ma, float(peaks_ua.max(initial=0)) / 1000),
            max_charge_uc=max(old.max_charge_uc, float(charges_pc.max(initial=0)) / 1e6),
            max_net_charge_uc=max(old.max_net_charge_uc, net_uc),
        )


Condition = Literal["good", "open", "short", "unsure"]  # unsure where measurements disagree


@dataclass(frozen=True, eq=False)
class Impedance:
    """Impedances of all electrodes, measured once."""

    # (E,): voltage over current at the end of the measuring pulse, each electrode to the skin;
    # infinite where the board's voltage was not enough
    kohm: NDArray[np.float64]
    condition: tuple[Condition, ...]
    current_ma: float  # of the measuring pulse

    @property
    def broken(self) -> tuple[int, ...]:
        """Electrodes that are open or shorted."""
        return tuple(i for i, name in enumerate(self.condition) if name in ("open", "short"))

    @property
    def lifted(self) -> bool:
        """True if nothing touches the electrodes."""
        return all(name == "open" for name in self.condition)


# A fault of a board latches it, which keeps it from being opened until a person clears that. The
# record is a small file in the user's state folder, named by a digest of the device: its USB
# vendor, product and serial number, else its port. It says "DATE: reason"; older ones are JSON.


def latch(device: str, reason: str) -> None:
    """Record a fault of a board; the first one stays."""
    if find_latch(device) is None:
        path = _record(device)
        make_folder(path.parent)
        write_bytes(path, f"{time.strftime('%Y-%m-%d %H:%M:%S')}: {reason}".encode())


def find_latch(device: str | None) -> str | None:
    """Return since when a board is latched, and why; None if it is not. A record that cannot be
    read counts as a fault."""
    try:
        return None if device is None else _record(device).read_text("utf-8", "replace")
    except FileNotFoundError:
        return None
    except OSError as error:
        return f"?: its record cannot be read ({error})"


def clear_latch(device: str | None) -> str | None:
    """Remove the record of a board; return what `find_latch` did."""
    record = find_latch(device)
    if device is not None:
        _record(device).unlink(missing_ok=True)
    return record


def _record(device: str) -> Path:
    name = hashlib.sha256(device.encode()).hexdigest()[:32]
    return user_state_path("smarttouch", appauthor=False) / "latched" / f"{name}.json"
