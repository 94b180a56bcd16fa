"""Reports of a board: its capabilities, delivery statistics and faults."""

import hashlib
import time
from dataclasses import dataclass, replace
from itertools import compress
from pathlib import Path
from typing import Literal

import numpy as np
from platformdirs import user_state_path

from smarttouch.base.files import make_folder, write_bytes
from smarttouch.stimulation.charge_balance import ChargeBalance
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
    """Time from the host's last byte to zero current; None if the board does not stop."""
    firmware: str
    polarities: tuple[Polarity, ...] = ("anodic", "cathodic")
    acknowledges: bool = False
    """Whether the board reports the start of each sequence."""
    host_timed: bool = False
    """Whether the host decides when each pass starts. If so, `Driver.write` reports each pass, and
    returns after the last pass, or earlier if a newer sequence is waiting."""
    measures: bool = False
    """Whether the board measures the voltage of each slot."""
    force: bool = False
    """Whether the board measures the finger's force."""
    compliance_v: float | None = None
    """Compliance voltage of the source, if known."""
    load_kohm: float | None = None
    """Load in parallel with the skin, if any, which carries a part of the current."""
    recharges: bool = False
    """Whether the board can make recharge phases."""
    emergency_switch: bool = False
    """Whether the board has an emergency switch."""
    kernel_bytes: int = 0
    """Capacity for kernels, bytes."""
    most_kernels: int = 0
    """Largest number of stored kernels."""
    packet_bytes: int | None = None
    """Size of the largest decoded packet, bytes, if limited."""
    kept_ms: float | None = None
    """Longest time from the end of this program to zero; None if the board has no watchdog."""

    def describe(self) -> list[tuple[str, str]]:
        """Return the capabilities as names and values, for display."""
        silence = "repeats its last pattern forever: lift the finger before you unplug the board"
        if self.time_to_zero_ms is not None:
            silence = f"goes to zero {self.time_to_zero_ms:g} ms after the host's last byte"
        if self.kept_ms is not None:
            kept = f"goes to zero {self.kept_ms:g} ms after the program ends or hangs"
            silence = f"{kept}; without the watchdog {silence}"
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
class BoardReport:
    """Delivery report of a board since it was opened. If the board itself reports maxima, they
    cover the time since power-on."""

    sequences: int
    slots: int
    pulses: int
    """Number of electrode pulses: a slot adds one for each electrode that carries current."""
    violations: int
    max_current_ma: float
    max_charge_uc: float
    max_net_charge_uc: float
    """If the board reports: largest charge left on an electrode after a discharge. If the host
    reports: largest net charge of an electrode over all pulses."""
    refused_packets: int = 0
    """Number of packets that the board refused because they were old or of another session."""
    is_busy: bool = False
    """Whether the board still has sequences to deliver."""
    refused_by_host: int = 0
    """Number of packets that the host refused: old, of another session, or not requested."""
    by: Literal["board", "host"] = "board"
    """Author of the report, board or host."""
    most_pulses: int | None = None
    """Upper bound of the number of pulses; None in a report of the board. If this bound is above
    `pulses`, the host does not know the number: `slots` and `pulses` are then lower bounds."""


class HostStatistics:
    """Delivery statistics, counted by the host; the result is ``report``."""

    def __init__(self, electrodes: int) -> None:
        self.report: BoardReport = BoardReport(0, 0, 0, 0, 0.0, 0.0, 0.0, by="host", most_pulses=0)
        self._ledger, self._unsure_uc = ChargeBalance(electrodes), np.zeros(electrodes)

    def add(
        self, sequence: ScanSequence, times: int = 1, again: bool = False, most: int | None = None
    ) -> None:
        """Add ``times`` passes of a sequence. If ``most`` is given, the number of passes is between
        ``times`` and ``most``. With ``again``, the sequence was counted before: add only passes."""
        most, old = times if most is None else most, self.report
        pulses = int(np.count_nonzero(sequence.current_ua))
        peaks_ua = np.abs(sequence.current_ua.astype(np.int32)).max(axis=1) * (most > 0)
        charges_pc = peaks_ua * sequence.width_us
        self._ledger.add(sequence, times)
        # absolute charge of each electrode in a pass, µC
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


# A fault latches a board: it cannot be opened until a person clears the fault. The record is a
# small file in the user's state folder, named by a digest of the device (USB vendor, product and
# serial number, else port). It contains "DATE: reason"; records of old versions are JSON.


def latch(device: str, reason: str) -> None:
    """Record a fault of a board, unless an earlier fault is recorded."""
    if find_latch(device) is None:
        path = _record(device)
        make_folder(path.parent)
        write_bytes(path, f"{time.strftime('%Y-%m-%d %H:%M:%S')}: {reason}".encode())


def find_latch(device: str | None) -> str | None:
    """Return date and reason of a latched fault, or None. An unreadable record counts as a
    fault."""
    try:
        return None if device is None else _record(device).read_text("utf-8", "replace")
    except FileNotFoundError:
        return None
    except OSError as error:
        return f"an unknown date: the record of the fault cannot be read ({error})"


def clear_latch(device: str | None) -> str | None:
    """Remove the fault record of a board, and return its content as `find_latch` does."""
    record = find_latch(device)
    if device is not None:
        _record(device).unlink(missing_ok=True)
    return record


def _record(device: str) -> Path:
    name = hashlib.sha256(device.encode()).hexdigest()[:32]
    return user_state_path("smarttouch", appauthor=False) / "latched" / f"{name}.json"
