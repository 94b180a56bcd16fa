"""Base of sources and of what knows the force."""

from smarttouch.closing import Closing


class Device(Closing):
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
        Warnings after a run, a sentence each.
    """

    def __init__(self, title: str) -> None:
        self.title = title
        self.url = ""
        self.notes: list[str] = []
