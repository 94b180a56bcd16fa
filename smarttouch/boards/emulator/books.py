"""The emulator's own account of what it did: counted from what flowed, not from what was asked."""

import json
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

STATE_FILE = "state.json"
DELIVERED_FILE = "delivered.bin"


@dataclass
class Books:
    """Counters, maxima and state; with a folder they are kept on disk as well."""

    electrodes: int
    folder: Path | None = None
    sequences: int = 0
    slots: int = 0
    pulses: int = 0
    violations: int = 0
    framing_errors: int = 0
    max_current_ma: float = 0.0
    max_charge_uc: float = 0.0
    max_net_charge_uc: float = 0.0
    state: str = "shorted"
    reason: str = "start"
    zero_after_ms: float = 0.0
    """From the host's last byte to all electrodes shorted, the last time it was cut off."""
    _delivered: bytearray = field(default_factory=bytearray, repr=False)

    def enter(
        self,
        number: int,
        slot: int,
        site: int,
        current_ua: NDArray[np.float64],
        width_us: float,
        net_charge_uc: float,
    ) -> None:
        """Write down one slot that was delivered."""
        peak_ma = float(np.abs(current_ua).max(initial=0)) / 1000
        self.slots += 1
        self.pulses += int(np.count_nonzero(current_ua))
        self.max_current_ma = max(self.max_current_ma, peak_ma)
        self.max_charge_uc = max(self.max_charge_uc, peak_ma * width_us / 1000)
        self.max_net_charge_uc = max(self.max_net_charge_uc, net_charge_uc)
        if self.folder is not None:
            record = np.zeros((), _record(self.electrodes))
            record["number"], record["slot"], record["site"] = number, slot, site
            record["current_ua"] = np.rint(current_ua)
            self._delivered += record.tobytes()

    def write(self) -> None:
        """Put on disk what has been entered since the last time."""
        if self.folder is None:
            return
        with (self.folder / DELIVERED_FILE).open("ab") as file:
            file.write(self._delivered)
        self._delivered.clear()
        account = asdict(self)
        account["folder"] = None
        del account["_delivered"]
        temporary = self.folder / (STATE_FILE + ".new")
        temporary.write_text(json.dumps(account), encoding="utf-8")
        temporary.replace(self.folder / STATE_FILE)


def read_state(folder: Path) -> dict[str, object]:
    """Return the last state that an emulator wrote down."""
    state: dict[str, object] = json.loads((folder / STATE_FILE).read_text(encoding="utf-8"))
    return state


def read_delivered(
    folder: Path,
) -> tuple[NDArray[np.uint32], NDArray[np.uint16], NDArray[np.int16]]:
    """Return every slot an emulator delivered.

    Returns
    -------
    numbers : ndarray, (N,)
        Sequence of each slot.
    sites : ndarray, (N,)
        Point each slot was for.
    current_ua : ndarray, (N, E) int16, µA
        What flowed, positive cathodic.
    """
    electrodes = int(str(read_state(folder)["electrodes"]))
    kind = _record(electrodes)
    data = (folder / DELIVERED_FILE).read_bytes()
    table = np.frombuffer(data[: len(data) // kind.itemsize * kind.itemsize], kind)
    return table["number"], table["site"], table["current_ua"]


def _record(electrodes: int) -> np.dtype[np.void]:
    return np.dtype(
        [("number", "<u4"), ("slot", "<u2"), ("site", "<u2"), ("current_ua", "<i2", (electrodes,))]
    )
