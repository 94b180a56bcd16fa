"""Tests that the plug-in contracts find faulty drivers, boards, sources and forces."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

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
    # A changed sequence, with the proved one that it replaces.

    proved: object
    sequence: object
    times: int


class Lent:
    # A line that accepts a `Sent` because it checks only the proved sequence inside.

    def __init__(self, line):
        self.line = line
    def current(self, sent=None):
        return self.line.current(getattr(sent, "proved", sent))


class Through(JournalDriver):
    times = None

    def other(self, sequence):
        return {}
    def open(self, line, limits):
        return super().open(Lent(line), limits)
    def write(self, proved):
        sequence = replace(proved.sequence, **self.other(proved.sequence))
        super().write(Sent(proved, sequence, self.times or proved.times))


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
    "Unbalanced": lambda sent: {"current_ua": sent.current_ua + (np.arange(8) == 7)},
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
        times = 1


class TestTwice(Changed):
    class kind(JournalDriver):
        def write(self, proved):
            super().write(proved)
            super().write(proved)


class Around:
    # A fake line without checks, so that each write reaches the file.

    def current(self, proved=None):
        return contextlib.nullcontext()


class TestLooksTooEarly(Changed):
    class kind(JournalDriver):
        def look(self):
            self._line.require_running()
        def write(self, proved):
            self.look()
            line, self._line = self._line, Around()
            try:
                super().write(proved)
            finally:
                self._line = line


class TestLooksNotAtStop(Changed):
    class kind(TestLooksTooEarly.kind):
        def look(self): ...


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
CLOSES = {"closing_puts_it_at_zero[closed]", "closing_puts_it_at_zero[broken]"}
FOUND = {
    **dict.fromkeys(
        ("Reversed", "OnePolarity", "Wide", "Hundredfold", "Twofold", "FiftiethMore", "Unbalanced",
         "Swapped", "Backwards", "Unmasked", "Undischarged", "Faster", "Once", "Twice"), SENT,
    ),
    "LooksNotAtStop": {ANY_LINE}, "LooksTooEarly": {ANY_LINE},
    "StopsNot": CLOSES | {ANY_LINE}, "StopsLater": {ANY_LINE}, "ClosesWithCurrent": CLOSES,
}  # fmt: skip


def failed(folder, text, *options):
    """Run pytest on a file with this text; return the names of failing tests by class."""
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


@pytest.mark.long
def test_what_is_sent_otherwise_fails_the_test_that_is_about_it(tmp_path, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", str(EXAMPLE), prepend=":")
    kinds = " or ".join(f"Test{name}" for name in FOUND)
    tests = " or ".join(name.partition("[")[0] for name in set().union(*FOUND.values()))
    assert failed(tmp_path, MUTANTS, "-k", f"({kinds}) and ({tests})") == FOUND


BROKEN = """
import math, time
from dataclasses import replace
import numpy as np
from smarttouch import Frame, OpticalSource, Stimulus, StimulusSource
from smarttouch.emulator.drivers import MemoryDriver
from smarttouch.plugins import ForceSource, Pose
from smarttouch.testing import ZERO, DriverContract, ForceContract, SourceContract, StimulusContract
from smarttouch.testing.driver_contract import planned_pulses


class Drivers(DriverContract):
    def make(self, limits):
        return self.kind("", limits)

    def pulses(self):
        return [*self.made.pulses]


class Device(MemoryDriver):
    def __init__(self, rest, limits):
        super().__init__(rest, limits)
        self.pulses = []
    def write(self, proved):
        with self._line.current(proved):
            self.pulses += planned_pulses(proved.sequence, proved.times)
    def zero(self):
        with self._line.current():
            self.pulses.append(ZERO)


class TestNever(Drivers):
    class kind(Device):
        def zero(self): ...


class TestUncounted(Drivers):
    class kind(Device):
        def open(self, line, limits):
            return replace(super().open(line, limits), acknowledges=True)


class Sources(SourceContract):
    def make(self, profile):
        return self.kind("a source")


class Plain(OpticalSource):
    duration_s, wait_s = 1.0, 0.0
    def read(self, time_ns):
        time.sleep(self.wait_s)
        if time_ns > 1e9:
            return None
        self.frames += 1
        return self.seen(time_ns)
    def seen(self, time_ns):
        image = np.full((4, 4), self.frames, np.uint8)
        return Frame(image, time_ns, Pose(0, 0), math.nan, self.frames - 1)


class TestPlain(Sources):
    kind = Plain


class TestShared(Sources):
    class kind(Plain):
        image = np.zeros((4, 4), np.uint8)
        def seen(self, time_ns):
            self.image[:] = self.frames
            return Frame(self.image, time_ns, Pose(0, 0), math.nan, self.frames - 1)


class TestNumbers(Sources):
    class kind(Plain):
        def seen(self, time_ns):
            return Frame(np.zeros((4, 4), np.uint8), time_ns, Pose(0, 0), math.nan, 7)


class TestWide(Sources):
    class kind(Plain):
        def seen(self, time_ns):
            return Frame(np.zeros((4, 4)), time_ns, Pose(0, 0), math.nan, self.frames - 1)


class TestWaits(Sources):
    class kind(Plain):
        wait_s = 0.02


class TestOnce(Sources):
    class kind(Plain):
        closed = False
        def close(self):
            assert not self.closed
            self.closed = True


class TestEndless(Sources):
    class kind(Plain):
        def read(self, time_ns):
            self.frames += 1
            return self.seen(time_ns)


class Stimuli(StimulusContract):
    def make(self, profile):
        return self.kind("stimuli")


class Right(StimulusSource):
    most, period_us = 1.0, 20_000
    def read(self, time_ns):
        if time_ns > 1e9:
            return None
        self.frames += 1
        activation = np.full((3, 64), self.most, np.float32)
        return Stimulus(activation, time_ns, 0.9, self.period_us, number=self.frames - 1)


class TestRight(Stimuli):
    kind = Right


class TestStrong(Stimuli):
    class kind(Right):
        most = 1.01


class TestUnknown(Stimuli):
    class kind(Right):
        most = math.nan


class TestFrames(Stimuli):
    kind = Plain


class Forces(ForceContract):
    def make(self, profile):
        return self.kind("a force")


class TestPull(Forces):
    class kind(ForceSource):
        def read(self, time_ns):
            return -1.0
"""

COUNTED = "every_frame_is_counted_and_one_number_is_one_image"
SHOWN = {
    "Never": {"closing_puts_it_at_zero", "a_stop_at_any_line_of_the_driver"},
    "Uncounted": {"what_is_sent_is_counted"},
    "Shared": {"each_is_what_it_is_to_be", COUNTED},
    "Numbers": {COUNTED},
    "Wide": {"each_is_what_it_is_to_be"},
    "Waits": {"reading_waits_for_nothing"},
    "Once": {"it_can_be_closed_twice"},
    "Endless": {"it_ends_and_stays_at_its_end"},
    "Strong": {"each_is_what_it_is_to_be"},
    "Unknown": {"each_is_what_it_is_to_be"},
    "Frames": {
        "each_is_what_it_is_to_be", COUNTED, "reading_waits_for_nothing",
    },
    "Pull": {
        "it_is_a_force_or_not_known_and_waits_for_nothing",
        "it_can_be_closed_twice_and_still_be_read",
    },
}  # fmt: skip


@pytest.mark.long
def test_what_is_broken_fails_the_test_that_is_about_it(tmp_path):
    found = failed(tmp_path, BROKEN)
    assert {
        kind: {name.partition("[")[0] for name in names} for kind, names in found.items()
    } == SHOWN
