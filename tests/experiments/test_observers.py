"""Simulated observers: one judges the spikes of a finger, the other answers at random."""

import math

import numpy as np
import pytest
from scipy.special import ndtr

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import ExperimentError
from smarttouch.experiments.observers import (
    BASE_WEBER,
    SHARPNESS,
    BlindObserver,
    Interval,
    Nerve,
    SimulatedObserver,
    believable_hz,
)
from smarttouch.physiology.finger import Finger

from ..support.checks import raises
from ..support.full import sample

RA, SAI, PC = Afferent
MIDDLE = 27


def weber_fraction(standard_hz, ratio):
    """Return the Weber fraction at 75 % in closed form; infinite if no comparison reaches 75 %."""
    n, limit_hz = SHARPNESS, believable_hz(ratio)
    left = (standard_hz**-n + limit_hz**-n) * (1 + BASE_WEBER) ** -n - limit_hz**-n
    return float(left ** (-1 / n) / standard_hz - 1) if left > 0 else math.inf


@pytest.fixture(scope="module")
def pulse(profile, bank):
    """Return a function that makes the currents of a pulse, (E,) µA, from a kernel of the bank."""

    def make(afferent=RA, site=MIDDLE, level=1.0):
        current_ua = 1000 * level * profile.full_ma[site] * bank.kernels(afferent)[site]
        return np.rint(current_ua).astype(np.int16)

    return make


@pytest.fixture(scope="module")
def train(pulse):
    """Return a function that makes an interval of equal pulses at one frequency."""

    def make(hz, afferent=RA, site=MIDDLE, level=1.0, seconds=0.5, width_us=200):
        time_s = np.arange(0, seconds, 1 / hz)
        current = np.tile(pulse(afferent, site, level), (len(time_s), 1))
        return Interval(time_s, np.full(len(time_s), width_us, np.float32), current)

    return make


@pytest.fixture(scope="module")
def finger(profile):
    """Return the finger that is simulated by default."""
    return Finger(profile, 1, "paper")


@pytest.fixture
def observer(finger):
    def make(**parameters):
        return SimulatedObserver(finger, **parameters)

    return make


NOTHING = Interval(np.zeros(0), np.zeros(0, np.float32), np.zeros((0, 64), np.int16))


def share(count, ask, wanted):
    return sum(ask() == wanted for _ in range(count)) / count


class TestNerve:
    def test_silence_has_no_frequency_and_no_place(self, finger, train):
        for interval in (NOTHING, train(50, level=0.01)):
            response = Nerve(finger).of(interval)
            assert (response.hz, response.ratio, response.per_slot) == (0, 0, 0)
            assert np.isnan(response.center_mm).all()
        assert Nerve(finger).of(train(50, seconds=0.01)).hz == 0

    def test_places_are_those_of_the_receptors(self, finger, profile, train):
        nerve = Nerve(finger)
        for site in (9, 27, 54):
            found = nerve.of(train(50, site=site)).center_mm
            assert np.linalg.norm(found - profile.electrodes.position_mm[site]) < 1.0


class TestTheThresholdsOfThePaper:
    """The model agrees with the paper's Fig. 16, to which it is fitted, and with Fig. 18."""

    @pytest.fixture
    def ratio_of(self, finger, train):
        """Return a function that gives the ratio of PC to RA spikes, when a class is stimulated."""
        return lambda afferent: Nerve(finger).of(train(20, afferent, seconds=1)).ratio

    def test_in_ra_mode_frequency_is_lost_above_60_hz(self, ratio_of):
        weber = {hz: weber_fraction(hz, ratio_of(RA)) for hz in (15, 30, 45, 60, 75, 90)}
        assert max(weber[15], weber[30], weber[45]) < 0.20
        assert 0.27 < weber[60] < 0.35
        assert weber[75] == pytest.approx(0.70, abs=0.03)
        assert weber[90] == math.inf

    def test_in_pc_mode_it_goes_on(self, ratio_of):
        assert max(weber_fraction(hz, ratio_of(PC)) for hz in (45, 60, 75, 90, 100)) < 0.22

    @pytest.mark.parametrize(
        ("afferent", "standard_hz"), sample([(RA, 75), (RA, 30), (PC, 100), (PC, 75)])
    )
    def test_trials_agree_with_the_closed_form(
        self, observer, ratio_of, train, afferent, standard_hz
    ):
        subject = observer(seed=7, lapse=0.0)
        weber = weber_fraction(standard_hz, ratio_of(afferent))
        standard = train(standard_hz, afferent, seconds=0.2)
        comparison = train(standard_hz * (1 + weber), afferent, seconds=0.2)
        right = share(300, lambda: subject.respond("faster", [standard, comparison], "12"), "2")
        right += share(300, lambda: subject.respond("faster", [comparison, standard], "12"), "1")
        assert right / 2 == pytest.approx(0.75, abs=0.035)


class TestTheTasks:
    def test_lapses_are_answers_at_random(self, observer, train):
        subject = observer(seed=3, lapse=0.4)
        trial = [train(20), train(40)]
        felt = share(500, lambda: subject.respond("faster", trial, "12"), "2")
        assert felt == pytest.approx(0.8, abs=0.05)

    def test_more_current_is_felt_more_often(self, observer, train):
        subject = observer(seed=4, guess=0.1)
        found = []
        for level in (0.2, 0.6, 0.8, 1.0):
            trial = [train(50, level=level)]
            found.append(share(50, lambda trial=trial: subject.respond("felt", trial, "yn"), "y"))
        assert found[0] == pytest.approx(0.1, abs=0.1)
        assert found == pytest.approx(sorted(found), abs=0.1)
        assert found[-1] > 0.9

    def test_sides_are_distinguished_in_two_intervals_or_one(self, observer, train, finger):
        subject = observer(seed=8, lapse=0.0)
        left, right = (train(50, site=site, seconds=0.2) for site in (26, 27))
        at_mm = [Nerve(finger).of(each).center_mm[0] for each in (left, right)]
        truth = float(ndtr((at_mm[1] - at_mm[0]) / (math.sqrt(2) * subject.place_mm)))
        assert truth > 0.6
        for trial, wanted in (([left, right], "r"), ([right, left], "l")):
            told = share(150, lambda trial=trial: subject.respond("side", trial, "lr"), wanted)
            assert told == pytest.approx(truth, abs=0.11)

    @pytest.mark.parametrize(("task", "alternatives"), [
        ("faster", "12"), ("side", "lr"),
    ])  # fmt: skip
    def test_where_nothing_was_felt_it_guesses(self, observer, task, alternatives):
        subject = observer(seed=10)
        trial = [NOTHING, NOTHING]
        first = share(100, lambda: subject.respond(task, trial, alternatives), alternatives[0])
        assert first == pytest.approx(0.5, abs=0.15)

    def test_an_unknown_task_is_named(self, observer):
        with raises(ExperimentError, value="smell", allowed="faster"):
            observer().respond("smell", [NOTHING], "12")


def test_a_blind_subject_answers_anything():
    guessing = BlindObserver(seed=1)
    answers = [guessing.respond("which", [], "ABCD") for _ in range(800)]
    counts = [answers.count(each) for each in "ABCD"]
    assert min(counts) > 150
    assert max(counts) < 250


def test_the_softness_of_a_single_pulse_is_guessed(observer, train):
    answers = [
        observer(seed=seed).respond("softer", (train(1), train(30)), "12") for seed in range(10)
    ]
    assert {*answers} == {"1", "2"}
