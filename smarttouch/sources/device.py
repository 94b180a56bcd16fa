"""Base of sensors and sources of force."""

from smarttouch.closing import Closing


class Device(Closing):
    """Base of what is opened by its URL and closed, and has notes for the user.

    Parameters
    ----------
    title : str
        What it is, in a few words, for the screen.

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
