"""Contract tests of a source of finger force: subclass `ForceContract` beside yours."""

import math
import time
from collections.abc import Iterator

import pytest

from smarttouch.errors import SourceError
from smarttouch.profile import DEFAULT_PROFILE, Profile, load_profile
from smarttouch.registry import fault_of
from smarttouch.sources.forces.force import ForceSource


class ForceContract:
    """Contract of every source of force: subclass it as ``TestMine``, with `make`.

    Attributes
    ----------
    quickest_s : float, s
        The quickest of many reads takes no longer: it waits for nothing.
    largest_n : float, N
        No finger presses harder.
    """

    quickest_s = 0.005
    largest_n = 100.0

    def make(self, profile: Profile) -> ForceSource:
        """Return a new source of force."""
        # Not abstract: pytest could not make the class to run what needs no device.
        raise NotImplementedError("return your source of force")

    def make_impossible(self, profile: Profile) -> None:
        """Open one that is not there, as a file without a name; replace it."""
        pytest.skip("make_impossible is not given")

    @pytest.fixture
    def profile(self) -> Profile:
        """Profile of the finger."""
        return load_profile(DEFAULT_PROFILE)

    @pytest.fixture
    def force(self, profile: Profile) -> Iterator[ForceSource]:
        """Return a new source of force, closed after the test."""
        with self.make(profile) as force:
            yield force

    def test_its_class_keeps_the_contract(self, force: ForceSource) -> None:
        assert fault_of(type(force), ForceSource) is None
        assert force.title
        assert all(isinstance(note, str) and note for note in force.notes)

    def test_it_is_a_force_or_not_known(self, force: ForceSource) -> None:
        for time_ns in (*range(0, 10**9, 10**8), 10**12, 0):
            force_n = force.read(time_ns)
            assert isinstance(force_n, float)
            assert math.isnan(force_n) or 0 <= force_n <= self.largest_n

    def test_reading_waits_for_nothing(self, force: ForceSource) -> None:
        force.read(0)
        took_s = []
        for number in range(1, 30):
            start = time.perf_counter()
            force.read(number * 10**7)
            took_s.append(time.perf_counter() - start)
        assert min(took_s) < self.quickest_s

    def test_it_can_be_closed_twice_and_still_be_read(self, force: ForceSource) -> None:
        force.read(0)
        force.close()
        force.close()
        force_n = force.read(10**8)
        assert math.isnan(force_n) or force_n >= 0

    def test_one_that_is_not_there_is_an_error_with_a_sentence(self, profile: Profile) -> None:
        with pytest.raises(SourceError) as error:
            self.make_impossible(profile)
        assert str(error.value)
        assert "\n" not in str(error.value)
