"""Base of the firmware of every emulated device, the log of what flowed, and the source of kits."""

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
"""Largest µA, µs and µC on any electrode that are safe, whatever the firmware allows."""
RECHARGE = 0xFFFF  # slot and site of a recharge phase
_ROUNDING = 1 + 1e-6
_FLOWS_UA = 0.5


@dataclass
class DeliveryLog:
    """Counters, maxima and state; with a folder they are kept on disk as well."""

    electrodes: int
    folder: Path | None = None
    sequences: int = 0
    slots: int = 0
    pulses: int = 0
    violations: int = 0  # number of sequences that the firmware refused
    unsafe: int = 0  # number of delivered pulses above a safe value, one for each pulse of a slot
    framing_errors: int = 0
    old_packets: int = 0  # refused by a link board
    foreign_packets: int = 0  # as `old_packets`, but of another session
    max_current_ma: float = 0.0
    max_charge_uc: float = 0.0
    max_net_charge_uc: float = 0.0  # largest charge that was left on an electrode after a slot
    max_volts: float = 0.0  # largest voltage of a source between its poles
    recharges: int = 0  # recharge phases; not counted in slots, pulses or maxima
    passed_uc: NDArray[np.float64] = field(init=False)
    """Net charge that sources have driven through each electrode, (E,), positive cathodic:
    pulses and recharge phases, without what flows back while all electrodes are shorted."""
    state: str = "shorted"
    reason: str = "start"
    zero_after_ms: float = 0.0  # from the host's last sign of life to the last cut-off
    stood_still_ms: float = 0.0  # for which the board's clock stood still with its process
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
        """Record one pulse of a slot, with the charge left on each electrode, (E,), after the
        slot's discharge and its start by the board's clock; ``more`` if another pulse of the slot
        follows. The slot `RECHARGE` is a recharge phase, or the part of it before it was cut
        off."""
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
        """Take a pulse; for subclasses."""

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
    """Return the last state that an emulator wrote."""
    state: dict[str, object] = json.loads((folder / STATE_FILE).read_text(encoding="utf-8"))
    return state


def read_slots(folder: Path, recharges: bool = False) -> NDArray[Any]:
    """Return every pulse of a slot that an emulator delivered, or every recharge phase, a
    structured array (N,).

    Its fields are ``number``, ``slot``, ``site``, ``time_us``, and per electrode (E,)
    ``current_ua`` (mean over the pulse), ``charge_uc`` of the pulse, ``volts`` (against the tissue
    at its end) and ``residual_uc`` (charge left after the discharge), all positive cathodic.
    """
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
    """A device between its line and what it touches; it has no clock of its own."""

    books: DeliveryLog
    longest_step_ns = 10_000_000  # a process kept waiting for longer stops the device's time
    backlog = 65536  # as soon as so many bytes wait for the host, messages are dropped

    @property
    def busy(self) -> bool:
        """Whether something is due soon."""
        return False

    def wait_s(self, clock: "DeviceClock") -> float:
        """Return how long to wait for bytes from the host, s."""
        return 0.001 if self.busy else 0.004

    def feed(self, data: bytes, now_ns: int) -> bytes:
        """Process bytes from the host; return the answer."""
        return self.advance(now_ns)

    @abstractmethod
    def advance(self, now_ns: int) -> bytes:
        """Execute all that is due; return what there is to send."""

    def idle(self, now_ns: int) -> None:
        """Let time pass without a line; what would be sent is lost."""
        self.advance(now_ns)

    def hang_up(self, now_ns: int) -> None:
        """Handle the end of the line to the host, which a device may not detect."""
        self.idle(now_ns)

    def zero(self, reason: str, now_ns: int) -> None:
        """Lose power."""
        self.books.state, self.books.reason = "shorted", reason


class DeviceClock:
    """The device's time, from 0 on, which stands still while the machine runs other processes for
    longer than ``longest_step_ns``: hardware never waits, so a delay of the emulator must not count
    as the host's silence or as delivered pulses."""

    def __init__(self, longest_step_ns: int = Firmware.longest_step_ns) -> None:
        self._longest_step_ns = longest_step_ns
        self._begun = self._last = time.monotonic_ns()
        self.stood_still_ns: int = 0

    def now_ns(self) -> int:
        now = time.monotonic_ns()
        self.stood_still_ns += max(0, now - self._last - self._longest_step_ns)
        self._last = now
        return now - self._begun - self.stood_still_ns


VOLTS_PER_COUNT = 0.0893  # scale of the eTactileKit's converter; assumed for its relative's as well
LARGEST_READING = 4095


class KitFirmware(Firmware):
    """Base of kits: commands, and one source with the skin connected; a shunt is a load beside the
    skin."""

    codes: Collection[int]  # first bytes of commands; others are skipped between these

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
        """Return the length of the command that has begun."""

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
        """Forget everything, as at a loss of power."""
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
        """Deliver a pulse, ground all outputs for the rest after it, and record both; return the
        converter's reading at its end.

        Current is positive cathodic; the first ``among`` electrodes take part, one against the
        others. Before it, outputs were ``grounded`` or unconnected; with ``more``, another pulse of
        the slot follows. The slot's number is the electrode's if not given.
        """
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
