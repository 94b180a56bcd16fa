"""What sensors and sources of force have in common."""

from types import TracebackType
from typing import Self


class Device:
    """Something that is opened by its URL, has something to say, and is closed.

    Parameters
    ----------
    title : str
        What it is, in a few words, for the screen.

    Attributes
    ----------
    notes : list of str
        What a user should know of it after a run, a sentence each.
    """

    def __init__(self, title: str) -> None:
        self.title = title
        self.notes: list[str] = []

    def close(self) -> None:
        """Let go of what is held open; a second time does nothing."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()
