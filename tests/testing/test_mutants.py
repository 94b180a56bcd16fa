"""The contract finds each way in which a driver sends another thing than was proved."""

import re
import subprocess
import sys
from pathlib import Path

from ..whole import WHOLE

EXAMPLE = Path(__file__).parents[2] / "examples" / "plugins" / "board"

MUTANTS = """
import contextlib
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import test_smarttouch_journal as own
from smarttouch_journal import JournalDriver



class Changed(own.TestJournal):
    def make(self, limits):
        return self.kind(str(self.path), limits)


class Sent(NamedTuple):
    # What stands for a proved sequence.

    proved: object
    sequence: object
    times: int


class Other(JournalDriver):
    def write(self, proved):
        self._proved = proved
        super().write(Sent(proved, self.change(proved.sequence), self.count(proved.times)))
    def change(self, sequence):
        return replace(sequence, **self.other(sequence))
    def count(self, times):
        return times
    def other(self, sequence):
        return {}


class Lent:
    # A line that lets through whatever stands for a proved sequence.

    def __init__(self, line):
        self.line = line
    def current(self, sent=None):
        return self.line.current(getattr(sent, "proved", sent))


class Through(Other):
    def open(self, line, limits):
        return super().open(Lent(line), limits)


def one_polarity(sequence):
    current_ua, rows = sequence.current_ua, np.arange(sequence.slots)
    sign = np.sign(current_ua[rows, sequence.site])[:, None]
    return {"current_ua": current_ua * np.where(sign, sign, 1)}


OTHERS = {
    "Reversed": lambda sent: {"current_ua": -sent.current_ua},
    "OnePolarity": one_polarity,
    "Wide": lambda sent: {"width_us": sent.width_us * 10},
    "Hundredfold": lambda sent: {"current_ua": sent.current_ua.astype(int) * 100},
    "Twofold": lambda sent: {"current_ua": sent.current_ua * 2},
    "FiftiethMore": lambda sent: {"current_ua": (sent.current_ua * 1.02).round().astype(int)},
    "Swapped": lambda sent: {"current_ua": sent.current_ua[:, [0, 1, 2, 3, 4, 5, 7, 6]]},
    "Backwards": lambda sent: {"current_ua": sent.current_ua[::-1]},
    "Unmasked": lambda sent: {"current_ua": np.where(sent.current_ua == 0, 20, sent.current_ua)},
    "Undischarged": lambda sent: {"discharge_us": sent.discharge_us * 0},
    "Faster": lambda sent: {"period_us": sent.period_us // 2},
}
for name, other in OTHERS.items():
    kind = type(name, (Through,), {"other": staticmethod(other), "__module__": __name__})
    globals()[f"Test{name}"] = type(f"Test{name}", (Changed,), {"kind": kind})


class TestOnce(Changed):
    class kind(Through):
        def count(self, times):
            return 1


class TestTwice(Changed):
    class kind(JournalDriver):
        def write(self, proved):
            super().write(proved)
            super().write(proved)


class Around:
    # No line: whatever is written goes to the file.

    def current(self, proved=None):
        return contextlib.nullcontext()


class TestLooksNotAtStop(Changed):
    class kind(JournalDriver):
        def write(self, proved):
            line, self._line = self._line, Around()
            try:
                super().write(proved)
            finally:
                self._line = line


class TestLooksTooEarly(Changed):
    class kind(JournalDriver):
        def write(self, proved):
            self._line.require_running()
            line, self._line = self._line, Around()
            try:
                super().write(proved)
            finally:
                self._line = line


class TestStopsNot(Changed):
    class kind(JournalDriver):
        def zero(self): ...


class TestStopsLater(Changed):
    class kind(JournalDriver):
        def zero(self): ...
        def close(self):
            print("zero", file=self._file, flush=True)
            super().close()


class TestClosesWithCurrent(Changed):
    class kind(JournalDriver):
        def close(self):
            print("scan: 1 x 10000 us\\n  100 us, then 50 us shorted: +9, -9 uA", file=self._file)
            super().close()
"""

SENT = {"what_the_device_is_sent_is_what_was_proved"}
ANY_LINE = "a_stop_at_any_line_of_the_driver[send]"
STOPS = {"a_stop_from_another_thread_ends_it"}
CLOSES = {"closing_puts_it_at_zero[closed]", "closing_puts_it_at_zero[broken]"}
FOUND = {
    **dict.fromkeys(
        ("Reversed", "OnePolarity", "Wide", "Hundredfold", "Twofold", "FiftiethMore", "Swapped",
         "Backwards", "Unmasked", "Undischarged", "Faster", "Once", "Twice"), SENT,
    ),
    "LooksNotAtStop": {ANY_LINE}, "LooksTooEarly": {ANY_LINE},
    "StopsNot": STOPS | CLOSES | {ANY_LINE}, "StopsLater": STOPS | {ANY_LINE},
    "ClosesWithCurrent": CLOSES,
}  # fmt: skip
DRAWN = ("FiftiethMore", "LooksTooEarly", "StopsLater", "ClosesWithCurrent")
"""One of each kind."""


def failed(folder, text, *options):
    """Return the names of tests that fail in a file of this text, by the class they are of."""
    (folder / "test_them.py").write_text(text, encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-rf", "--tb=no", "-p", "no:cacheprovider",
         *options, "."],
        cwd=folder, capture_output=True, text=True, timeout=110, check=False,
    )  # fmt: skip
    found = {}
    for kind, name in re.findall(r"^FAILED \S+::Test(\w+)::test_(\S+)", done.stdout, re.MULTILINE):
        found.setdefault(kind, set()).add(name)
    return found


def test_what_is_sent_otherwise_fails_the_test_that_is_about_it(tmp_path, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", str(EXAMPLE), prepend=":")
    found = {name: tests for name, tests in FOUND.items() if WHOLE or name in DRAWN}
    kinds = " or ".join(f"Test{name}" for name in found)
    tests = " or ".join(name.partition("[")[0] for name in set().union(*FOUND.values()))
    assert failed(tmp_path, MUTANTS, "-k", f"({kinds}) and ({tests})") == found
