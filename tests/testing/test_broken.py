"""The contracts find what is broken in boards, sources and forces."""

from .test_mutants import failed

BROKEN = """
import math, time
import numpy as np
from smarttouch import Frame, OpticalSource, SmartTouchError, Stimulus, StimulusSource
from smarttouch.boards.open import MemoryDriver
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
        reports_delivery = True


class Sources(SourceContract):
    def make(self, profile):
        return self.kind("a source")
    def make_impossible(self, profile):
        raise SmartTouchError("no")


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
    def make_impossible(self, profile):
        raise SmartTouchError("no")


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
    def make_impossible(self, profile):
        raise SystemError("no")


class TestPull(Forces):
    class kind(ForceSource):
        def read(self, time_ns):
            return -1.0
"""

COUNTED = "every_frame_is_counted_and_one_number_is_one_image"
FOUND = {
    "Never": {
        "a_stop_from_another_thread_ends_it", "closing_puts_it_at_zero",
        "a_driver_that_breaks_is_put_at_zero", "a_stop_at_any_line_of_the_driver",
    },
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
        "one_that_is_not_there_is_an_error_with_a_sentence",
    },
}  # fmt: skip


def test_what_is_broken_fails_the_test_that_is_about_it(tmp_path):
    found = failed(tmp_path, BROKEN)
    assert {
        kind: {name.partition("[")[0] for name in names} for kind, names in found.items()
    } == FOUND
