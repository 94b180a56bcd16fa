"""A simulated subject is given what the board delivered, and nothing else."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from smarttouch.base.errors import ExperimentError
from smarttouch.experiments.psychophysics.catalog import ExperimentOptions, new_experiment
from smarttouch.experiments.psychophysics.observers import BlindObserver
from smarttouch.experiments.psychophysics.simulated_subject import (
    Subject,
    TwoLooks,
    interval_of,
    make_observer,
)
from smarttouch.experiments.psychophysics.trial_rows import read_rows

from ...played import played
from ...raising import raises
from ...whole import WHOLE
from .sitting import sit


@given(st.lists(st.tuples(st.integers(1, 5), st.integers(0, 4)), min_size=1, max_size=6))
def test_slots_of_an_interval_keep_their_times(parts):
    """Sequences of an interval and of others, mixed, with any number of slots."""
    number, starts, expected, time_ns = [], {}, [], 5_000_000
    for index, (slots, kind) in enumerate(parts, start=1):
        number += [index] * slots
        if kind:
            starts[index] = (time_ns, 100)
            expected += [(time_ns, slot) for slot in range(slots)]
        time_ns += 20_000_000
    width_us = np.full(len(number), 200, np.float32)
    current_ua = np.arange(len(number), dtype=np.int16)[:, None].repeat(2, axis=1)
    felt = interval_of((np.array(number, np.uint32), width_us, current_ua), starts)
    begin_ns = min((time_ns for time_ns, _ in starts.values()), default=0)
    assert felt.time_s == pytest.approx(
        [(at_ns - begin_ns) / 1e9 + slot * 300e-6 for at_ns, slot in expected]
    )
    assert len(felt.width_us) == len(felt.current_ua) == len(expected)
    assert np.isin(current_ua[:, 0], felt.current_ua[:, 0]).tolist() == [
        each in starts for each in number
    ]


def test_an_interval_of_silence_is_empty():
    nothing = (np.zeros(0, np.uint32), np.zeros(0, np.float32), np.zeros((0, 4), np.int16))
    felt = interval_of(nothing, {3: (0, 0), 4: (20, 0)})
    assert felt.time_s.shape == (0,)
    assert felt.current_ua.shape == (0, 4)


def test_only_simulated_boards_have_simulated_subjects(profile):
    with raises(ExperimentError, names="board", allowed=("simulated:",)):
        Subject(None, BlindObserver("first")).attend(played(profile))


def test_observers_by_name(profile):
    for kind in ("random", "first", "silent"):
        assert make_observer(kind, profile, 3) == BlindObserver(kind, 3)
    assert isinstance(make_observer("model", profile, 0), TwoLooks)


class Says:
    def __init__(self, *answers):
        self.answers = list(answers)

    def respond(self, task, intervals, alternatives):
        assert (task, len(intervals), tuple(alternatives)) == ("felt", 1, ("y", "n"))
        return self.answers.pop(0)


def test_two_looks_make_a_choice():
    two = (None, None)
    assert TwoLooks(Says("y", "n")).respond("felt", two, ("1", "2")) == "1"
    assert TwoLooks(Says("n", "y")).respond("felt", two, ("1", "2")) == "2"
    tossed = [TwoLooks(Says("n", "n"), seed).respond("felt", two, ("1", "2")) for seed in range(40)]
    assert 8 < tossed.count("1") < 32


EXPERIMENTS = ["detection", "localization", "discomfort"]


@pytest.mark.parametrize("name", EXPERIMENTS if WHOLE else EXPERIMENTS[2:])
def test_the_model_sits_every_experiment(profile, bank, tmp_path, name):
    wanted = ExperimentOptions(repetitions=2, train_s=1.0 if name == "discomfort" else 0.1)
    made = new_experiment(name, profile, wanted)
    observer = make_observer("model", profile, 1)
    sat = sit(made, profile, bank, tmp_path / "rows.csv", observer, experiment=name)
    rows = read_rows(tmp_path / "rows.csv")
    assert sat.session.over
    assert all(row.response for row in rows)
    easy = sorted(rows, key=lambda row: abs(row.comparison))[-2:]
    if name != "discomfort":
        assert all(row.response == row.target for row in easy)


def test_the_model_finds_detection_in_two_intervals(profile, bank, tmp_path):
    made = new_experiment(
        "detection", profile, ExperimentOptions(repetitions=3, train_s=0.1, two_intervals=True)
    )
    sit(made, profile, bank, tmp_path / "rows.csv", make_observer("model", profile, 1))
    rows = sorted(read_rows(tmp_path / "rows.csv"), key=lambda row: row.comparison)
    assert sum(row.success for row in rows[-6:]) >= 5
    assert sum(row.success for row in rows[:9]) <= 8
