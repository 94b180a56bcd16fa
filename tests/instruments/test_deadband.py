"""A hand at rest is at rest."""

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from smarttouch.instruments.electric_mouse import SLIDES, STICKS, Deadband

PLACE = st.floats(-1e3, 1e3)


@given(x=PLACE, y=PLACE, angle=st.floats(0, 7), seed=st.integers(0, 99))
def test_after_one_still_look_jitter_of_a_count_moves_nothing(x, y, angle, seed):
    """Wherever the hand came from, and wherever within its jitter the still look was."""
    steady, random = Deadband(1.0), np.random.default_rng(seed)
    for way in np.arange(30, 0, -0.7):
        steady.follow(x + way * math.cos(angle), y + way * math.sin(angle))
    jumps = random.integers(-1, 2, (300, 2))
    places = [steady.follow(x + jump[0], y + jump[1]) for jump in jumps]
    still = next(k for k in range(1, 300) if places[k] == places[k - 1])
    assert len(set(places[still:])) == 1


@given(x=PLACE, y=PLACE)
def test_it_is_never_farther_behind_than_it_sticks(x, y):
    steady = Deadband(0.5)
    assert math.dist(steady.follow(x, y), (x, y)) <= 0.5 * STICKS + 1e-9
    assert math.dist(steady.follow(x + 30, y), (x + 30, y)) <= 0.5 * SLIDES + 1e-9


@given(x=PLACE, y=PLACE)
def test_what_is_exact_is_followed_exactly(x, y):
    steady = Deadband(0.0)
    steady.follow(1.0, 2.0)
    assert math.dist(steady.follow(x, y), (x, y)) < 1e-9


def test_jitter_on_a_slow_motion_is_no_motion_back():
    steady, random = Deadband(0.03), np.random.default_rng(5)
    x = [steady.follow(0.01 * k + 0.03 * random.integers(-1, 2), 0.0)[0] for k in range(1000)]
    assert (np.diff(x) >= 0).all()
    assert x[-1] > 9.7
