"""The rules in whole arrays are the rules: two oracles beside each other, on every display."""

import pytest

from ..whole import sample
from .agreement import RunStatistics, stream
from .displays import display_names
from .gates import Answer
from .oracle import Oracle
from .quick import judge_alone_quickly
from .rules import judge_alone

STREAMS = 2


class OtherForm:
    """An oracle in the place of a gate, with the other form of the rules."""

    def __init__(self, profile):
        self._oracles = [Oracle(profile, judge) for judge in (judge_alone, judge_alone_quickly)]

    def ask(self, sequence, clock_ns, times=1, written=True):
        first, second = (
            oracle.judge(sequence, clock_ns, times, written=written) for oracle in self._oracles
        )
        assert first == second
        return Answer(not first, limit=",".join(first))


@pytest.mark.parametrize("name", sample(display_names(), 5))
def test_both_forms_agree(name):
    tally = RunStatistics()
    for seed in range(STREAMS):
        stream(name, seed, tally, OtherForm)
    assert tally.asked > 130
    assert tally.disagreements == 0
    assert min(tally.accepted, tally.refused) > 30
