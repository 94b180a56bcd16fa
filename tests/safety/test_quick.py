"""Rules for a single sequence, each at its limit."""

import math

import numpy as np
import pytest

from .quick import judge_alone
from .short_sequences import FULL, pair, sequence


def shaken(*strengths):
    return np.array(strengths, np.float32)


def recharged(*phase, us=1000):
    return {"recharge_ua": np.array(phase, np.int16), "recharge_us": us}


WIDE = [[-9, 9, 0, 0], [1750, 1750, -2800, -700]]
EDGES = [
    ("rate", sequence([], period=10_000), sequence([], period=9_999)),
    ("range", sequence([], period=60_000_000), sequence([], period=60_000_001)),
    ("range", sequence([], time_ns=2**62 - 1), sequence([], time_ns=2**62)),
    ("range", sequence([], time_ns=0), sequence([], time_ns=-1)),
    ("range", sequence([], intensity=0), sequence([], intensity=-1e-300)),
    ("range", sequence([], intensity=1), sequence([], intensity=math.nextafter(1, 2))),
    ("types", sequence([], period=np.uint16(20_000)), sequence([], period=20_000.0)),
    ("types", sequence([], time_ns=np.int64(5)), sequence([], time_ns=True)),
    ("types", sequence([], intensity=np.float32(1)), sequence([], intensity=True)),
    ("types", sequence([]), sequence([], vibration=np.zeros(4))),
    ("types", sequence([]), sequence([], vibration=shaken(0, 0, 0))),
    ("period", sequence(pair(1, 2), discharge=9_900), sequence(pair(1, 2), discharge=(9900, 9901))),
    ("duty", sequence(pair(0, 50), width=200), sequence(pair(0, 51), width=[200] * 50 + [1])),
    ("balance", sequence([[3, -1, -1, -1]]), sequence([[3, -1, -1, 0]])),
    ("width", sequence(pair(1), width=200), sequence(pair(1), width=201)),
    ("width", sequence(pair(1), width=1), sequence(pair(1), width=0)),
    ("current", sequence([[-700, 0, 0, 700]]), sequence([[-701, 0, 0, 701]])),
    ("total", sequence(WIDE), sequence([*WIDE, [1751, 1750, -2801, -700]])),
    ("charge", sequence(pair(2000), width=200), sequence(pair(2001), width=200)),
    ("discharge", sequence(pair(1), discharge=20), sequence(pair(1), discharge=19)),
    ("intensity", sequence(pair(1503), intensity=0.5), sequence(pair(1504), intensity=0.5)),
    ("strong pulses", sequence(pair(600, 30)), sequence(pair(600, 31))),
    ("strong pulses", sequence(pair(600, 60), period=10**6), sequence(pair(600, 61), period=10**6)),
    ("strong pulses", sequence([*pair(600, 30), *pair(599, 5)]), sequence(pair(-600, 31))),
    ("mean current", sequence(pair(2000, 25), width=200), sequence(
        [*pair(2000, 25), [1, -1, 0, 0]], width=[200] * 25 + [1])),
    ("vibration", sequence([], vibration=shaken(0, 1, 0, 0)), sequence(
        [], vibration=shaken(0, 1.000002, 0, 0))),
    ("vibration", sequence([], vibration=shaken(-0.0, 0, 0, 0)), sequence(
        [], vibration=shaken(-1e-30, 0, 0, 0))),
    ("vibration", sequence([]), sequence([], vibration=shaken(0, np.nan, 0, 0))),
    ("recharge", sequence(pair(9), **recharged(60, 0, 0, -60)), sequence(
        pair(9), **recharged(61, 0, 0, -61))),
    ("recharge", sequence(pair(9), **recharged(100, -100, 0, 0, us=19_850), period=50_000),
     sequence(pair(9), **recharged(101, -101, 0, 0, us=19_850), period=50_000)),
    ("recharge", sequence(pair(9), **recharged(1, -1, 0, 0, us=1)), sequence(
        pair(9), **recharged(1, -1, 0, 0, us=0))),
    ("recharge", sequence(pair(9), **recharged(1, -1, 0, 0)), sequence(
        pair(9), **recharged(1, -2, 0, 0))),
    ("recharge", sequence(pair(9), **recharged(1, -1, 0, 0)), sequence(
        [], **recharged(1, -1, 0, 0))),
    ("recharge", sequence(pair(9)), sequence(pair(9), recharge_us=1)),
    ("range", sequence(pair(9), **recharged(1, -1, 0, 0, us=19_850), period=40_000), sequence(
        pair(9), **recharged(1, -1, 0, 0, us=20_001), period=60_000)),
    ("duty", sequence(pair(9), **recharged(1, -1, 0, 0, us=9_900)), sequence(
        pair(9), **recharged(1, -1, 0, 0, us=9_901))),
    ("period", sequence(pair(9), discharge=10_080, **recharged(1, -1, 0, 0, us=9_800)), sequence(
        pair(9), discharge=10_081, **recharged(1, -1, 0, 0, us=9_800))),
    ("mean current", sequence(pair(2000, 24), width=200, **recharged(1, -1, 0, 0)), sequence(
        pair(2000, 25), width=200, **recharged(1, -1, 0, 0))),
]  # fmt: skip
"""Rules, each with a sequence that keeps all rules, and one that breaks only this rule. Most pairs
are just within and just beyond a limit."""


def broken(made, bounds=FULL):
    return judge_alone(made, bounds).broken


@pytest.mark.parametrize(("rule", "inside", "outside"), EDGES)
def test_a_single_sequence(rule, inside, outside):
    assert broken(inside) == []
    assert broken(outside) == [rule]


@pytest.mark.parametrize(("name", "wrong", "rule"), [
    ("current_ua", np.zeros((1, 4), np.int32), "types"),
    ("current_ua", np.zeros((1, 4), ">i2"), "types"),
    ("current_ua", np.zeros((1, 5), np.int16), "types"),
    ("current_ua", [[0, 0, 0, 0]], "types"), ("width_us", np.array(9, np.uint16), "types"),
    ("discharge_us", np.full(1, 50.0), "types"), ("site", None, "types"),
    ("site", np.array([4], np.uint16), "range"), ("period_us", math.nan, "types"),
    ("intensity", "1", "types"), ("intensity", np.int64(1), "types"), ("recharge_us", 1.0, "types"),
])  # fmt: skip
def test_wrong_types_end_it(name, wrong, rule):
    good = sequence(pair(9))
    object.__setattr__(good, name, wrong)
    assert broken(good) == [rule]
