"""Base of sources of input and of finger force."""

from smarttouch.closing import Closing


class Device(Closing):
    """Base of sources that are opened by URL, closed, and have notes for the user.

    Parameters
    ----------
    title : str
        Name in a few words.

    Attributes
    ----------
    url : str
        URL by which it was opened.
    notes : list of str
        Warnings after a run, a sentence each.
    """

    def __init__(self, title: str) -> None:
        self.title = title
        self.url = ""
        self.notes: list[str] = []

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.url or self.title!r})"
