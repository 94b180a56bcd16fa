"""One sentence for each thing that goes wrong with a device, however often it does."""


class StandingNotes:
    """Sentences that are brought up to date instead of being repeated.

    Parameters
    ----------
    notes : list of str
        Where they stand; others may append to it, and nothing is ever removed.
    """

    def __init__(self, notes: list[str]) -> None:
        self._notes = notes
        self._places: dict[str, int] = {}

    def put(self, cause: str, sentence: str) -> None:
        """Say something of a cause, in the place of what was said of it before."""
        if cause in self._places:
            self._notes[self._places[cause]] = sentence
        else:
            self._notes.append(sentence)
            self._places[cause] = len(self._notes) - 1


class Episodes:
    """Something that is wrong for a while, now and then: how often, and how long in all.

    Parameters
    ----------
    notes : StandingNotes
    words : str
        What was wrong, as in "the load cell was silent".
    remedy : str
        What to do about it; nothing if empty.
    """

    def __init__(self, notes: StandingNotes, words: str, remedy: str = "") -> None:
        self._notes = notes
        self._words = words
        self._remedy = f": {remedy}" if remedy else ""
        self._since_ns: int | None = None
        self._past_ns = 0
        self.times = 0

    @property
    def is_on(self) -> bool:
        return self._since_ns is not None

    def update(self, is_on: bool, now_ns: int, since_ns: int | None = None) -> None:
        """Say whether it is so now; ``since_ns`` is when it began, if that is known."""
        if is_on and self._since_ns is None:
            self._since_ns = now_ns if since_ns is None else since_ns
            self.times += 1
        if self._since_ns is None:
            return
        lasted_ns = self._past_ns + now_ns - self._since_ns
        if not is_on:
            self._past_ns, self._since_ns = lasted_ns, None
        often = f" in all, {self.times} times" if self.times > 1 else ""
        seconds = f"{lasted_ns / 1e9:.1f} s{often}"
        self._notes.put(self._words, f"{self._words} for {seconds}{self._remedy}")
