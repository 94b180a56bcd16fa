"""Base of what is closed at the end of its ``with`` block."""

from typing import Self


class Closing:
    """Closes itself at the end of its ``with`` block, whatever has happened in it."""

    def close(self) -> None:
        """Release everything held open; a second call does nothing."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
