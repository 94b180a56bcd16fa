"""Device warnings: one sentence for each cause, however often it occurs."""


class DeviceWarnings:
    """Warnings that are updated instead of being repeated, in a list to which others may append."""

    def __init__(self, notes: list[str]) -> None:
        self._notes = notes
        self._places: dict[str, int] = {}

    def put(self, cause: str, sentence: str) -> None:
        """Set the warning of a cause, in the place of the earlier one."""
        if cause in self._places:
            self._notes[self._places[cause]] = sentence
        else:
            self._notes.append(sentence)
            self._places[cause] = len(self._notes) - 1


class OutageTracker:
    """Number and total duration of outages, described as in "the load cell was silent"."""

    def __init__(self, notes: DeviceWarnings, words: str, remedy: str = "") -> None:
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
        """Update the present state; ``since_ns`` is its start, if known."""
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
