"""Serial ports are found without a byte to anything unknown."""

from smarttouch.boards import open
from smarttouch.boards.open import serial_ports


def test_serial_ports_are_listed_and_none_is_opened(monkeypatch):
    class Found:
        def __init__(self, device, description):
            self.device, self.description = device, description

    monkeypatch.setattr(
        open.list_ports,
        "comports",
        lambda: [Found("/dev/ttyUSB1", "CP2102"), Found("/dev/ttyS0", "n/a")],
    )
    assert serial_ports() == [("/dev/ttyUSB1", "CP2102")]
