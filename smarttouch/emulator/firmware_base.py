"""Base classes of emulated firmware, and the delivery log."""

import json
import math
import time
from abc import ABC, abstractmethod
from collections.abc import Collection
from dataclasses import asdict, dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from smarttouch.emulator.skin import Delivered, EmulatedFinger, SkinCircuit

STATE_FILE = "state.json"
DELIVERED_FILE = "delivered.bin"
SAFE_PULSE, SAFE_RECHARGE = (5000, 200, 0.5), (500, 20_000, 2.0)
"""Largest safe values of a pulse and of a recharge phase: current, µA; duration, µs; charge, µC.
These values are independent of the limits that the firmware checks."""
RECHARGE = 0xFFFF  # slot number and site that mark a recharge phase
_ROUNDING = 1 + 1e-6
_FLOWS_UA = 0.5


@dataclass
class DeliveryLog:
    """Counts and largest values of delivered pulses. `write` saves them in ``folder``, if given."""

    electrodes: int
    folder: Path | None = None
    sequences: int = 0
    slots: int = 0
    pulses: int = 0
    violations: int = 0  # number of sequences that the firmware refused
    unsafe: int = 0  # number of delivered pulses above `SAFE_PULSE` or `SAFE_RECHARGE`
    framing_errors: int = 0
    old_packets: int = 0  # number of packets that a link board refused as old
    foreign_packets: int = 0  # number of packets refused because they are from another session
    max_current_ma: float = 0.0
    max_charge_uc: float = 0.0
    max_net_charge_uc: float = 0.0  # largest charge left on an electrode after a slot
    max_volts: float = 0.0  # largest voltage between the poles of a source
    recharges: int = 0  # number of recharge phases, which do not count as slots or pulses
    passed_uc: NDArray[np.float64] = field(init=False)
    """Net charge of each electrode from pulses and recharge phases, (E,), positive cathodic. Charge
    that flows while electrodes are shorted does not count."""
    state: str = "shorted"
    reason: str = "start"
    zero_after_ms: float = 0.0  # time from the host's last sign of life to the last stop
    stood_still_ms: float = 0.0  # total time for which `DeviceClock` stood still
    _delivered: bytearray = field(default_factory=bytearray, repr=False)

    def __post_init__(self) -> None:
        self.passed_uc = np.zeros(self.electrodes)

    def enter(
        self,
        number: int,
        slot: int,
        site: int,
        delivered: Delivered,
        width_us: float,
        residual_uc: NDArray[np.float64],
        time_us: float,
        *,
        more: bool = False,
    ) -> None:
        """Record one pulse of a slot. ``residual_uc``, (E,), is the charge left on each electrode
        after the discharge. ``time_us`` is the start of the pulse by the board's clock. With
        ``more``, another pulse of the slot follows. Slot `RECHARGE` is a recharge phase."""
        recharges = slot == RECHARGE
        magnitude_ua = np.abs(delivered.current_ua)
        peak_ua = float(magnitude_ua.max(initial=0))
        peak_uc = peak_ua * width_us * 1e-6
        most_ua, most_us, most_uc = SAFE_RECHARGE if recharges else SAFE_PULSE
        self.unsafe += (
            peak_ua > most_ua * _ROUNDING
            or peak_uc > most_uc * _ROUNDING
            or (width_us > most_us * _ROUNDING and peak_ua >= _FLOWS_UA)
        )
        self.recharges += recharges
        if not recharges:
            self.slots += not more
            self.pulses += int(np.count_nonzero(magnitude_ua >= _FLOWS_UA))
            self.max_current_ma = max(self.max_current_ma, peak_ua / 1000)
            self.max_charge_uc = max(self.max_charge_uc, peak_uc)
            self.max_volts = max(self.max_volts, delivered.source_v)
            self.keep(number, width_us, delivered.current_ua)
        charge_uc = delivered.charge_pc * 1e-6
        self.passed_uc += charge_uc
        if not more:
            left_uc = float(np.abs(residual_uc).max(initial=0))
            self.max_net_charge_uc = max(self.max_net_charge_uc, left_uc)
        if self.folder is not None:
            current_ua, head = np.rint(delivered.current_ua), (number, slot, site, time_us)
            record = (*head, current_ua, charge_uc, delivered.volts, residual_uc)
            self._delivered += np.array([record], _record(self.electrodes)).tobytes()

    def keep(self, number: int, width_us: float, current_ua: NDArray[np.float64]) -> None:
        """Store a pulse in memory; this base class stores nothing."""

    def write(self) -> None:
        if self.folder is None:
            return
        with (self.folder / DELIVERED_FILE).open("ab") as file:
            file.write(self._delivered)
        self._delivered.clear()
        account = asdict(self)
        account["folder"], account["passed_uc"] = None, self.passed_uc.tolist()
        del account["_delivered"]
        temporary = self.folder / (STATE_FILE + ".new")
        temporary.write_text(json.dumps(account), encoding="utf-8")
        temporary.replace(self.folder / STATE_FILE)


def read_state(folder: Path) -> dict[str, object]:
    """Read the newest counters that an emulator has written to ``folder``."""
    state: dict[str, object] = json.loads((folder / STATE_FILE).read_text(encoding="utf-8"))
    return state


def read_slots(folder: Path, recharges: bool = False) -> NDArray[Any]:
    """Read all delivered pulses, or all recharge phases, as a structured array (N,).

    Fields are ``number``, ``slot``, ``site``, ``time_us`` and, for each electrode, (E,):
    ``current_ua`` (mean over the pulse), ``charge_uc`` (of the pulse), ``volts`` (against tissue at
    the end of the pulse), ``residual_uc`` (left after the discharge). All are positive cathodic."""
    kind = _record(int(str(read_state(folder)["electrodes"])))
    data = (folder / DELIVERED_FILE).read_bytes()
    records = np.frombuffer(data[: len(data) // kind.itemsize * kind.itemsize], kind)
    return np.asarray(records[(records["slot"] == RECHARGE) == recharges])


@cache
def _record(electrodes: int) -> np.dtype[np.void]:
    shape = (electrodes,)
    return np.dtype(
        [
            ("number", "<u4"), ("slot", "<u2"), ("site", "<u2"), ("time_us", "<i8"),
            ("current_ua", "<i4", shape), ("charge_uc", "<f4", shape), ("volts", "<f2", shape),
            ("residual_uc", "<f2", shape),
        ]
    )  # fmt: skip


class Firmware(ABC):
    """Base class of emulated firmware. It has no clock: its methods receive the present time."""

    books: DeliveryLog
    longest_step_ns = 10_000_000  # see `DeviceClock`
    backlog = 65536  # messages are dropped while this number of bytes waits for the host

    @property
    def busy(self) -> bool:
        """Whether the server must call `advance` often, because actions are due soon."""
        return False

    def wait_s(self, clock: "DeviceClock") -> float:
        """Return how long to wait for bytes from the host, s."""
        return 0.001 if self.busy else 0.004

    def feed(self, data: bytes, now_ns: int) -> bytes:
        """Process bytes from the host; return the answer."""
        return self.advance(now_ns)

    @abstractmethod
    def advance(self, now_ns: int) -> bytes:
        """Execute everything that is due; return the bytes to send."""

    def idle(self, now_ns: int) -> None:
        """Advance the time without a host; bytes to send are lost."""
        self.advance(now_ns)

    def hang_up(self, now_ns: int) -> None:
        """Handle the host's closing of the line; by default the device does not notice it."""
        self.idle(now_ns)

    def zero(self, reason: str, now_ns: int) -> None:
        """Short all electrodes, as after a loss of power; log the reason."""
        self.books.state, self.books.reason = "shorted", reason


class DeviceClock:
    """Clock of an emulated device, ns from 0. If this process is delayed, the clock advances by at
    most ``longest_step_ns`` and then stands still. So a delay causes no host timeout."""

    def __init__(self, longest_step_ns: int = Firmware.longest_step_ns) -> None:
        self._longest_step_ns = longest_step_ns
        self._begun = self._last = time.monotonic_ns()
        self.stood_still_ns: int = 0

    def now_ns(self) -> int:
        now = time.monotonic_ns()
        self.stood_still_ns += max(0, now - self._last - self._longest_step_ns)
        self._last = now
        return now - self._begun - self.stood_still_ns


VOLTS_PER_COUNT = 0.0893  # scale of the eTactileKit's A/D converter, assumed for both kits
LARGEST_READING = 4095


class KitFirmware(Firmware):
    """Base class of the firmware of kits: a parser of commands, and one current source on a model
    of the skin. ``shunt_ohm`` is a load in parallel with the skin."""

    codes: Collection[int]  # first byte of each command; the parser skips other bytes

    def __init__(
        self,
        books: DeliveryLog,
        finger: EmulatedFinger | None,
        compliance_v: float,
        shunt_ohm: float = math.inf,
    ) -> None:
        self.books = books
        self._skin = SkinCircuit(books.electrodes, compliance_v=compliance_v)
        self._finger = finger or EmulatedFinger(books.electrodes)
        self._shunt_ohm = shunt_ohm
        self._state = np.zeros(books.electrodes, np.int8)
        self._received = bytearray()
        self._fed_ns = self._rested_ns = 0

    @abstractmethod
    def _length(self) -> int:
        """Return the length of the command at the start of the buffer."""

    def _next_command(self) -> bytes | None:
        received = self._received
        while received and received[0] not in self.codes:
            del received[0]
        if not received or len(received) < (length := self._length()):
            return None
        command = bytes(received[:length])
        del received[:length]
        return command

    def zero(self, reason: str, now_ns: int) -> None:
        """Reset the firmware, as after a loss of power."""
        super().zero(reason, now_ns)
        self._received.clear()
        self.books.zero_after_ms = (now_ns - self._fed_ns) / 1e6

    def _pulse(
        self,
        number: int,
        electrode: int,
        current_ua: float,
        width_us: float,
        start_ns: int,
        *,
        among: int,
        rest_us: float,
        slot: int | None = None,
        grounded: bool = True,
        more: bool = False,
    ) -> int:
        """Deliver a pulse, then ground all outputs for ``rest_us``; record the pulse in the log.

        Return the reading of the A/D converter at the end of the pulse. One pole is
        ``electrode``; the other pole is all other outputs from 0 to ``among`` − 1. ``current_ua``
        is positive cathodic. If ``grounded``, outputs were grounded before the pulse; otherwise
        they were unconnected. If ``more``, another pulse of the slot follows."""
        self._finger.at(start_ns / 1e9, self._skin)
        if start_ns > self._rested_ns:
            pass_time = self._skin.short if grounded else self._skin.idle
            pass_time((start_ns - self._rested_ns) / 1000)
        sign = 1 if current_ua > 0 else -1
        self._state[:among], self._state[among:] = -sign, 0
        if electrode < len(self._state):
            self._state[electrode] = sign
        delivered = self._skin.switched_pulse(
            self._state, abs(current_ua), width_us, self._shunt_ohm
        )
        if rest_us:
            self._skin.short(rest_us)
        self._rested_ns = start_ns + round(1000 * (width_us + rest_us))
        self.books.enter(
            number, electrode if slot is None else slot, electrode, delivered, width_us,
            self._skin.residual_uc, start_ns // 1000, more=more,
        )  # fmt: skip
        flowed = bool(delivered.current_ua.any())
        volts = delivered.source_v if flowed else self._skin.compliance_v
        return min(LARGEST_READING, int(volts / VOLTS_PER_COUNT))
