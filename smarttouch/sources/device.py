"""Base of sources and of what knows the force."""

from types import TracebackType
from typing import Self


class Device:
    """Base of what is opened by its URL and closed, and has notes for the user.

    Parameters
    ----------
    title : str
        What it is, in a few words.

    Attributes
    ----------
    url : str
        By which it was opened.
    notes : list of str
        What a user should know of it after a run, a sentence each.
    """

    def __init__(self, title: str) -> None:
        self.title = title
        self.url = ""
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
