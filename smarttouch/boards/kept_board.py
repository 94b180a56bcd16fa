"""Base class of drivers for free-running boards, which a keeper process puts at zero."""

from smarttouch.boards.kept_line import KeptLine
from smarttouch.boards.streamed import StreamedBoard
from smarttouch.errors import OtherDeviceError
from smarttouch.wire.port import LINE_ERRORS, Port, reason

KEPT_MS = 100.0  # longest time from the end or hang of this program to the first byte of zero

MORE_S = 0.03  # wait for more than the answer: USB chips keep bytes for 16 ms


class KeptBoard(StreamedBoard):
    """Streamed board that repeats its last pattern without a host. A driver calls `_promise_zero`
    before anything that can become a current."""

    def _wrap(self, port: Port) -> Port:
        return KeptLine(port)

    def _promise_zero(self, zero: bytes, slow: bool) -> None:
        """Set the keeper's zero command; see `KeptLine.promise_zero`."""
        assert self._serial is not None
        try:
            self._serial.promise_zero(zero, slow)
        except LINE_ERRORS as error:
            raise self._lost(f"has vanished ({reason(error)})") from None

    def _at_zero(self) -> bool:
        return self._serial is not None and bool(self._serial.at_zero)

    def _ask_again(self, question: bytes, answer: bytes, within_s: float, silence_s: float) -> None:
        """Query again, after a silence if need be, and raise OtherDeviceError unless the board
        gives this answer."""
        # No zeros before the query: another device might act on them.
        for pause_s in (0.0, silence_s):
            self._pause(pause_s)
            self._flush()
            self._write(question)
            if received := self._read(len(answer), within_s):
                # A longer answer is another device's; zero waits only briefly for that.
                received += self._read(1, MORE_S)
                break
        if received != answer:
            raise OtherDeviceError(
                f"what is at {self._port_name} now does not answer as that board did: nothing but "
                "this question was sent",
                about="board",
            )

    def _aftermath(self) -> str:
        if self._at_zero():
            return ""
        return "; the board goes on with its last pattern: lift the finger, then switch it off"
