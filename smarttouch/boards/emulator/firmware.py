"""Base of the firmware of every emulated device."""

from abc import ABC, abstractmethod
from typing import Protocol

from smarttouch.boards.emulator.delivery_log import DeliveryLog


class Clock(Protocol):
    """The device's time."""

    def now_ns(self) -> int: ...


class Firmware(ABC):
    """A device between its line and what it touches; it has no clock of its own."""

    books: DeliveryLog | None = None
    longest_step_ns = 10_000_000  # a process kept waiting for longer stops the device's time
    backlog = 65536  # as soon as so many bytes wait for the host, messages are dropped
    wrong: frozenset[str] = frozenset()  # faults at this time, other than those of the line

    @property
    def busy(self) -> bool:
        """Whether something is due soon."""
        return False

    def wait_s(self, clock: Clock) -> float:
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
        """Handle that the host has closed the line, which a device need not notice."""
        self.idle(now_ns)

    # Not abstract: sensors carry no current and leave it out.
    def zero(self, reason: str, now_ns: int) -> None:  # noqa: B027, may be left out
        """Lose power; sensors do nothing."""

    def take_order(self, words: list[str]) -> bool:
        """Execute a line of input; return whether it was an order."""
        return False
