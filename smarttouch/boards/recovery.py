"""Restart of a lost board, at zero."""

from collections.abc import Callable

from smarttouch.errors import (
    BoardError,
    BoardStoppedError,
    LineLostError,
    OtherDeviceError,
    SilentBoardError,
)

TIMES = 3


def start_anew(start: Callable[[], None], lost: LineLostError) -> None:
    """Restart a board after its line was lost, up to three times, as the line may be lost again
    meanwhile; ``start`` waits for the port and puts the board at zero."""
    for left in reversed(range(TIMES)):
        try:
            return start()
        except BoardStoppedError:
            raise
        except OtherDeviceError as other:
            raise BoardError(f"{lost}; {other}", about=other.about) from None
        except BoardError as again:
            if not left or not isinstance(again, LineLostError | SilentBoardError):
                raise lost from None
    return None
