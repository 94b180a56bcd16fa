"""Contract tests for sources of frames, stimuli and finger force: subclass them in your tests."""

import contextlib
import math
import time
from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import SmartTouchError
from smarttouch.profile import DEFAULT_PROFILE, Profile, load_profile
from smarttouch.sources.force import ForceSource
from smarttouch.sources.source_contract import Frame, Input, Source, Stimulus

READS = 30  # largest number of reads in a test
QUICKEST_S = 0.01  # largest allowed duration of the fastest read; reads must not wait
LARGEST_N = 100.0  # largest plausible finger force


class _Opened:
    """Base class of the contracts, which provides a profile."""

    @pytest.fixture
    def profile(self) -> Profile:
        """Profile for the source."""
        return load_profile(DEFAULT_PROFILE)


class SourceContract(_Opened):
    """Contract tests of sources of frames: subclass as ``TestMine``, with `make`.

    Attributes
    ----------
    ends : bool
        Whether the source ends by itself.
    longest_s : float, s
        Time within which the source must end, if it ends by itself.
    step_s : float, s
        Time from one frame to the next.
    """

    ends = True
    longest_s: float = 120.0
    step_s: float = 0.02

    def make(self, profile: Profile) -> Source:
        """Return a new source."""
        # Not abstract: pytest must create the class for tests that need no device.
        raise NotImplementedError("override make: return your source")

    def pause(self) -> None:
        """Do nothing between two reads; override this to wait for a device."""

    @pytest.fixture
    def source(self, profile: Profile) -> Iterator[Source]:
        """Return a new source. It is closed after the test."""
        with self.make(profile) as source:
            yield source

    def read(self, source: Source) -> list[Input]:
        """Read until the source ends, or `READS` times. Fail if a read changes earlier inputs."""
        inputs: list[Input] = []
        copies: list[NDArray[Any]] = []
        time_ns = 0
        while len(inputs) < READS and (each := source.read(time_ns)) is not None:
            assert each.time_ns == time_ns
            inputs.append(each)
            copies.append(_content(each).copy())
            self.pause()
            time_ns += self.lasts_ns(each)
        for each, copy in zip(inputs, copies, strict=True):
            np.testing.assert_array_equal(_content(each), copy)
        return inputs

    def lasts_ns(self, given: Input) -> int:
        """Return the time from an input to the next read, ns."""
        return round(self.step_s * 1e9)

    def check(self, given: Input, first: Input, profile: Profile) -> None:
        """Check that an input is valid for a run, and has the type and shape of ``first``."""
        assert isinstance(given, Frame)
        assert isinstance(first, Frame)
        assert given.image.dtype == np.uint8
        assert given.image.shape == first.image.shape
        assert given.image.ndim == 2

    def check_same(self, one: Input, other: Input) -> None:
        """Check that two reads of one input have equal content."""
        np.testing.assert_array_equal(_content(one), _content(other))

    def test_each_is_what_it_is_to_be(self, source: Source, profile: Profile) -> None:
        inputs = self.read(source)
        assert inputs
        for one in inputs:
            self.check(one, inputs[0], profile)
            assert one.age_ns >= 0
            assert math.isnan(one.force_n) or one.force_n >= 0
            pose = one.pose
            assert np.isfinite([pose.x_mm, pose.y_mm, pose.angle_rad]).all()
        assert source.knows_force or not source.measures_force
        if source.knows_force:
            assert not all(math.isnan(one.force_n) for one in inputs)
        assert source.title
        assert source.ended
        assert source.duration_s is None or source.duration_s > 0
        assert all(isinstance(note, str) and note for note in source.notes)

    def test_every_frame_is_counted_and_one_number_is_one_image(self, source: Source) -> None:
        inputs = self.read(source)
        source.close()
        numbers = [frame.number for frame in inputs]
        assert numbers == sorted(numbers)
        assert numbers[0] >= 0
        assert source.frames == len(set(numbers)) + source.dropped_frames
        for one, next_one in pairwise(inputs):
            if one.number == next_one.number:
                self.check_same(one, next_one)

    def test_it_ends_and_stays_at_its_end(self, source: Source) -> None:
        if not self.ends:
            pytest.skip("the source never ends by itself")
        time_s, frame = 0.0, source.read(0)
        while frame is not None:
            assert time_s <= self.longest_s, f"the source has not ended in {self.longest_s:g} s"
            time_s += max(self.step_s, self.longest_s / 1000)
            self.pause()
            frame = source.read(round(time_s * 1e9))
        assert source.read(round(time_s * 1e9) + 1) is None

    def test_it_can_be_closed_twice(self, source: Source, profile: Profile) -> None:
        source.read(0)
        source.close()
        with contextlib.suppress(SmartTouchError):
            newest = source.read(round(self.step_s * 1e9))
            assert newest is None or isinstance(newest, Input)
        source.close()
        self.make(profile).close()

    def test_reading_waits_for_nothing(self, source: Source) -> None:
        # Do not time the first read, because it may wait for a device. A busy computer can delay
        # some of the other reads, so check the fastest one.
        newest, time_ns, took_s = source.read(0), 0, list[float]()
        while newest is not None and len(took_s) < READS:
            time_ns += self.lasts_ns(newest)
            start_s = time.perf_counter()
            newest = source.read(time_ns)
            took_s.append(time.perf_counter() - start_s)
        assert min(took_s) < QUICKEST_S


class StimulusContract(SourceContract):
    """Contract tests of sources of stimuli: subclass as ``TestMine``, with `make`.

    The time to the next read is the period of the stimulus, or `step_s` if it has no period.
    """

    def lasts_ns(self, given: Input) -> int:
        """Return the time from a stimulus to the next read, ns."""
        assert isinstance(given, Stimulus)
        return super().lasts_ns(given) if given.period_us is None else 1000 * given.period_us

    def check(self, given: Input, first: Input, profile: Profile) -> None:
        """Check that a stimulus is valid for a run."""
        assert isinstance(given, Stimulus)
        assert given.activation.dtype == np.float32
        assert given.activation.shape == (len(Afferent), len(profile.electrodes))
        # NaN also fails, as comparisons with it are false.
        assert 0 <= given.activation.min() <= given.activation.max() <= 1
        assert 0 <= given.level <= 1
        assert given.period_us is None or given.period_us > 0
        if given.image is not None:
            assert given.image.dtype == np.uint8
            assert given.image.ndim == 2

    def check_same(self, one: Input, other: Input) -> None:
        """Check that two reads of one stimulus have equal poses. Their activations may differ."""
        assert one.pose == other.pose


def _content(given: Input) -> NDArray[Any]:
    return given.image if isinstance(given, Frame) else given.activation


class ForceContract(_Opened):
    """Contract tests of force sensors: derive a class, such as ``TestMine``, and define `make`."""

    def make(self, profile: Profile) -> ForceSource:
        """Return a new source of force."""
        # Not abstract: pytest must create the class for tests that need no device.
        raise NotImplementedError("override make: return your source of force")

    @pytest.fixture
    def force(self, profile: Profile) -> Iterator[ForceSource]:
        """Return a new source of force. It is closed after the test."""
        with self.make(profile) as force:
            yield force

    def test_it_is_a_force_or_not_known_and_waits_for_nothing(self, force: ForceSource) -> None:
        took_s = []
        for time_ns in (*range(0, 10**9, 5 * 10**7), 10**12, 0):
            start_s = time.perf_counter()
            force_n = force.read(time_ns)
            took_s.append(time.perf_counter() - start_s)
            assert isinstance(force_n, float)
            assert math.isnan(force_n) or 0 <= force_n <= LARGEST_N
        assert min(took_s) < QUICKEST_S
        assert force.title
        assert all(isinstance(note, str) and note for note in force.notes)

    def test_it_can_be_closed_twice_and_still_be_read(self, force: ForceSource) -> None:
        force.read(0)
        force.close()
        force.close()
        force_n = force.read(10**8)
        assert math.isnan(force_n) or force_n >= 0
