"""Scans of a board with a clock of its own, located by brackets."""

import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from smarttouch.boards.kits.scan_lock import ScanLock, Span

T = 20_000_000


@pytest.fixture
def lock():
    return ScanLock(T)


def test_without_a_bracket_only_ranges_are_known(lock):
    assert lock.last is None
    assert lock.starts(Span(0, 0), Span(T // 2, T // 2)) == (0, 1)
    assert lock.starts(Span(0, 0), Span(5 * T, 5 * T)) == (4, 6)
    assert lock.starts(Span(0, T), Span(3 * T + T // 2, 4 * T)) == (2, 5)


def test_wide_brackets_do_not_lock(lock):
    lock.learn(Span(0, T // 4 + 5000))
    assert lock.last is None


def test_a_contradiction_ends_all_knowledge(lock):
    lock.learn(Span(0, 1_000_000))
    lock.learn(Span(8_000_000, 9_000_000))
    assert lock.last is None


def test_what_is_not_renewed_is_forgotten(lock):
    lock.learn(Span(0, 1_000_000))
    lock.check(400 * T)
    assert lock.last is not None
    lock.check(700 * T)
    assert lock.last is None


@given(
    phase=st.integers(0, T - 1),
    drift=st.floats(-200e-6, 200e-6),
    seed=st.integers(0, 1000),
    step=st.integers(1, 30),
)
def test_it_is_never_wrong(phase, drift, seed, step):
    rng = random.Random(seed)
    true = T * (1 + drift)
    lock = ScanLock(T)
    for number in range(0, 40 * step, step):
        start = phase + number * true
        bracket = Span(int(start - rng.uniform(0, 1e6)), int(start + rng.uniform(1, 1e6)))
        lock.learn(bracket)
        assert lock.last is not None
        for other in range(-3, 4):
            at = start + other * true
            scan = lock.scan(lock.first_after(int(at - T // 2)))
            assert scan.early <= at + 1
            assert at - 1 <= scan.late
        begin, end = sorted(rng.uniform(start, start + 5 * T) for _ in range(2))
        happened = sum(begin < phase + k * true < end for k in range(number - 1, number + 8))
        spread = rng.uniform(0, 1e6)
        least, most = lock.starts(
            Span(int(begin - spread), int(begin + spread)), Span(int(end), int(end + spread))
        )
        assert least <= happened <= most
