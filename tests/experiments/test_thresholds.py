"""The method of ascending limits finds simulated thresholds, and the board's limits are kept."""

import contextlib
import math
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from smarttouch.base.errors import CalibrationError, ExperimentError, LineLostError
from smarttouch.base.stopping import StopRequest
from smarttouch.emulator.drivers import MemoryDriver
from smarttouch.experiments.contact_and_force_calibration import file_to_calibrate
from smarttouch.experiments.thresholds import (
    MOST_HURRIED,
    STOP_KEYS,
    AscendingLimits,
    Progress,
    ThresholdProcedure,
    Thresholds,
    filled,
    measuring_profile,
    sentence,
    threshold_trials,
)
from smarttouch.experiments.trial_source import MOST_SPOILED, TrialSource
from smarttouch.experiments.trials import STEP_S
from smarttouch.kernels.bank import single_bank
from smarttouch.profile import list_profiles, load_profile
from smarttouch.running.config import RunConfig
from smarttouch.running.display import Display
from smarttouch.running.runner import Runner
from smarttouch.running.step_records import Listener, OnStep
from smarttouch.stimulation.safety_gate import SafetyLimits

from ..support.checks import raises
from ..support.full import WHOLE, sample
from ..support.scans import board_without_finger
from .simulated import SimulatedSubject


@pytest.fixture
def begun(tmp_path):
    """Return a function that opens the results file, or closes and reopens an open file."""
    open_ones = []

    def begin():
        for each in open_ones:
            each.close()
        open_ones.append(Progress(tmp_path / "p.csv", ABOUT))
        return open_ones[-1]

    yield begin
    for each in open_ones:
        each.close()


class Finger(Listener):
    """Listener that lets simulated participants feel each sequence and press keys."""

    def __init__(self, source, subjects):
        super().__init__()
        self.source, self.subjects = source, subjects

    def step(self, result):
        asked = re.search(r"electrode (\d+)", self.source.title)
        if asked and self.subjects[int(asked[1])].presses(
            level_of(result.sequence), result.sequence.period_us / 1e6
        ):
            self.source.press("x")


def level_of(sequence):
    return float(sequence.source_ua.max(initial=0)) / 1000


def subjects(profile, **options):
    return [SimulatedSubject(1.1, 1.9, seed=i, **options) for i in range(len(profile.electrodes))]


def silent(profile):
    return [SimulatedSubject(1e3, 1e4, guess=0)] * len(profile.electrodes)


def display_of(profile, kind=MemoryDriver):
    """Return a display whose board accepts each sequence at once, in simulated time."""
    measuring = measuring_profile(profile)
    return Display(board_without_finger(measuring, kind, simulated_time=True), measuring)


def run(display, profile, felt_by, sites, progress, stop=None, listeners=(), **options):
    """Run a session in simulated time; return the lines that report results."""
    shown = []
    trials = threshold_trials(profile, display.board, sites, progress, shown.append, **options)
    source = TrialSource(trials, display.profile, "thresholds")
    Runner(
        source,
        display,
        RunConfig(scan="points", intensity=1.0),
        listeners=[Finger(source, felt_by), *listeners],
        stop=stop,
        load_kernels=single_bank,
    ).run()
    return shown


def test_every_sequence_goes_through_one_electrode_and_rises_by_the_ramp(profile, begun):
    progress, display = begun(), display_of(profile)
    wanted = [3, 9]
    run(display, profile, subjects(profile), wanted, progress, repeats=1)
    last_ma, last_ns, sites = 0.0, 0, set()
    levels = np.array([level_of(each) for each in display.board.driver.sequences])
    starts = levels[1:][(levels[:-1] == 0) & (levels[1:] > 0)]
    assert len(starts) >= 2
    slew_ma_s = float(display.profile.full_ma[0]) / display.profile.limits.ramp_s
    assert starts.max() <= slew_ma_s * 2 * STEP_S
    slew = float(profile.full_ma.max()) / profile.limits.ramp_s
    for sequence in display.board.driver.sequences:
        level_ma = level_of(sequence)
        rise_ma = slew * (sequence.time_ns - last_ns) / 1e9
        # Currents are rounded to whole µA.
        assert level_ma - last_ma <= rise_ma + 1.1e-3
        last_ma, last_ns = level_ma, sequence.time_ns
        sites |= set(sequence.site.tolist())
        assert sequence.slots <= 1
    assert sites == {*wanted}
    assert last_ma == 0
    for site in wanted:
        assert progress.found[site].threshold_ma == pytest.approx(1.1, rel=0.2)
        assert progress.found[site].comfort_ma == pytest.approx(1.9, rel=0.2)


@pytest.mark.parametrize("name", sample(list_profiles(), 8))
def test_the_ceiling_of_every_profile_is_one_that_its_board_sends(name, begun):
    """If nothing is felt, the current rises to the ceiling, and the gate accepts each sequence."""
    profile = load_profile(name)
    display, site = display_of(profile), len(profile.electrodes) - 1
    progress = begun()
    run(display, profile, silent(profile), [site], progress, repeats=1)
    strongest_ma = max(level_of(each) for each in display.board.driver.sequences)
    most_ma = display.board.capabilities.max_current_ma
    ceiling_ma = min(display.profile.full_ma[site], most_ma)
    assert strongest_ma == pytest.approx(ceiling_ma, abs=1.1e-3)
    assert strongest_ma <= profile.limits.current_ma
    assert strongest_ma * profile.pulse.width_us / 1000 <= profile.limits.charge_uc
    assert not progress.found[site].felt


@pytest.mark.parametrize("name", list_profiles())
def test_only_comfort_is_another_limit_while_it_is_measured(name):
    profile = load_profile(name)
    usual, limits = SafetyLimits.of(profile), SafetyLimits.of(measuring_profile(profile))
    assert limits.full_ma / limits.ramp_s == pytest.approx(usual.full_ma / usual.ramp_s)
    for field in ("current_ma", "pulse_us", "charge_uc", "rate_hz", "duty", "total_ma",
                  "electrode_ma", "session_s", "session_mc"):  # fmt: skip
        assert getattr(limits, field) == getattr(usual, field), field


def test_an_interrupted_session_goes_on_where_it_was(profile, begun):
    first, stop = begun(), StopRequest()

    def stop_after_two(_result):
        if len(first.found) >= 2:
            stop.ask("enough")

    stopping = [OnStep(stop_after_two)]
    run(display_of(profile), profile, subjects(profile), range(3), first, stop, stopping, repeats=1)
    assert list(first.found) == [0, 1]
    again = begun()
    assert again.found == first.found
    second = display_of(profile)
    shown = run(second, profile, subjects(profile), range(3), again, repeats=1)
    assert len(shown) == 1
    assert shown[0].startswith("electrode 2: threshold ")
    assert {int(s) for each in second.board.driver.sequences for s in each.site} == {2}


def test_a_stop_comes_at_once_and_nothing_is_sent_after(profile, begun):
    stop, display, sent = StopRequest(), display_of(profile), []

    def stop_at_a_level(result):
        sent.append(result)
        if level_of(result.sequence) > 0.8:
            stop.ask("enough")

    progress = begun()
    run(display, profile, subjects(profile), [0], progress, stop, [OnStep(stop_at_a_level)])
    assert level_of(sent[-1].sequence) > 0.8
    assert len(display.board.driver.sequences) == len(sent)
    assert display.board._stopped.is_set()
    assert not progress.found


class Losing(MemoryDriver):
    """Driver whose connection breaks after ``n`` sequences, once for each ``n`` in `at`."""

    at = ()

    def write(self, proved):
        if len(self.sequences) in self.at:
            self.at = [each for each in self.at if each != len(self.sequences)]
            raise LineLostError("the line broke")
        super().write(proved)


def test_a_board_that_was_lost_begins_again_at_zero(profile, begun):
    progress, display = begun(), display_of(profile, Losing)
    display.board.driver.at = lost = [300, 700]
    run(display, profile, subjects(profile), [0], progress, repeats=1)
    sequences = display.board.driver.sequences
    for each in lost:
        assert level_of(sequences[each - 1]) > 0
        assert [sequence.slots for sequence in sequences[each : each + 10]] == [0] * 10
    assert len(display.board.notes) == len(lost)
    assert progress.found[0].threshold_ma == pytest.approx(1.1, rel=0.2)


def test_a_board_that_is_lost_all_the_time(profile, begun):
    display, progress = display_of(profile, Losing), begun()
    display.board.driver.at = range(0, 20_000, 200)
    with raises(ExperimentError, names="trial", value=MOST_SPOILED + 1, allowed=MOST_SPOILED):
        run(display, profile, subjects(profile), [0], progress)
    assert display.board._stopped.is_set()
    assert not progress.found


@pytest.mark.parametrize("key", STOP_KEYS)
def test_a_person_is_instructed_and_stops(tmp_path, key):
    """Each stop key ends the session. So does an empty string, which means a lost terminal."""
    heeding, said = [], []

    @contextlib.contextmanager
    def keys(heed):
        heeding.append(heed)
        yield

    def say(line):
        said.append(line)
        if line.startswith("electrode 5"):
            heeding[0](key)

    file = file_to_calibrate("thresholds", None, "electric-mouse", tmp_path / "mine.toml")
    procedure = ThresholdProcedure(
        start="electric-mouse", file=file, board_url="memory:", sites=[5]
    )
    with procedure.progress() as progress, raises(CalibrationError, value=1):
        procedure.measure(progress, keys, say, StopRequest())
    assert "2.50 mA" in said[0]
    assert [line for line in said if line.startswith("electrode")] == said[-1:]


ABOUT = {"profile": "mouse", "electrodes": 64, "board": "emulator", "pulse_us": 200, "repeats": 3}


def found(threshold=1.0, comfort=2.0):
    return Thresholds(threshold, comfort, 0.05, 3, 1)


def test_what_was_not_measured_stays_as_it_was(profile, changed):
    measured = {0: found(), 1: found(np.nan, np.nan), 2: found(1.5, 1.5), 3: found(0.71234, 2.5)}
    threshold, comfort = filled(profile, measured)
    assert threshold == [1.0, 1.2, 1.2, 0.712] + [1.2] * 60
    assert comfort == [2.0, 2.4, 2.4, 2.5] + [2.4] * 60
    own = changed(
        profile, {"perception.threshold_ma": [1.1] * 64, "perception.comfort_ma": [2.2] * 64}
    )
    assert filled(own, {5: found()})[1] == [2.2] * 5 + [2.0] + [2.2] * 58
    assert sentence(measured).startswith("2 ")
    assert "[1, 2]" in sentence(measured)
    with raises(CalibrationError):
        filled(profile, {1: found(np.nan, np.nan)})


def test_progress_is_read_back_and_its_settings_count(tmp_path):
    path = tmp_path / "p.csv"
    with Progress(path, ABOUT) as mine:
        mine.keep(4, found())
        mine.keep(1, found(np.nan, np.nan))
        with raises((CalibrationError, ExperimentError), value=path):
            Progress(path, ABOUT)
    with Progress(path, ABOUT) as again:
        assert again.found[4] == mine.found[4]
        assert not again.found[1].felt
    with raises(ExperimentError, names="repeats", value=(3, 5)):
        Progress(path, ABOUT | {"repeats": 5})
    path.write_bytes(path.read_bytes()[:-20])
    with Progress(path, ABOUT) as cut:
        assert list(cut.found) == [4]
        cut.forget()
    with Progress(path, ABOUT):
        head = path.read_text("utf-8").splitlines(keepends=True)[0]
    assert not list(tmp_path.iterdir())
    path.write_text(head + "mouse,64,emulator,200,3,4,3,2,0,1,0,1\n", "utf-8")
    with raises(CalibrationError, value=path):
        Progress(path, ABOUT)


CEILING_MA = 5.0
FINGERS = 200 if WHOLE else 40


class Rising:
    """Method of ascending limits, one step of current at a time."""

    def __init__(self, ceiling_ma=CEILING_MA, expected_ma=1.2, **options):
        self.ceiling_ma = ceiling_ma
        self.course = AscendingLimits(ceiling_ma, expected_ma, **options).course()
        self.found = None
        self.level_ma = next(self.course)

    def answer(self, pressed):
        try:
            self.level_ma = self.course.send(bool(pressed))
            assert 0 <= self.level_ma <= self.ceiling_ma
        except StopIteration as end:
            self.found = end.value

    def until(self, level_ma):
        while self.level_ma < level_ma:
            self.answer(False)


def rise(subject, ceiling_ma=CEILING_MA, **options):
    rising = Rising(ceiling_ma, **options)
    while rising.found is None:
        rising.answer(subject.presses(rising.level_ma, STEP_S))
    return rising.found


KINDS = {
    "usual": {}, "steep": {"slope": 0.05}, "shallow": {"slope": 0.2}, "drifting": {"drift": 0.03},
    "slow": {"reaction_s": 0.6}, "careless": {"guess": 0.02, "lapse": 0.05},
}  # fmt: skip


@pytest.mark.parametrize("kind", sample(KINDS))
def test_bias_and_spread_over_many_subjects(kind):
    """Results are accurate for thresholds from 0.6 to 2.4 mA, although 1.2 mA is expected."""
    rising, comfort = [], []
    for seed in range(FINGERS if kind == "usual" else 40):
        random = np.random.default_rng(seed)
        threshold = 1.2 * math.exp(0.25 * random.standard_normal())
        strongest = min(threshold * random.uniform(1.5, 2.2), 4.5)
        subject = SimulatedSubject(threshold, strongest, seed=seed, **KINDS[kind])
        found = rise(subject, seed=seed)
        rising.append(found.threshold_ma / threshold - 1)
        comfort.append(found.comfort_ma / strongest - 1)
    # Measured bias: thresholds −3 to +7 %, comfort levels −11 to +2 %. Spread: at most 9 %.
    assert abs(np.mean(rising)) < 0.1
    assert np.std(rising) < 0.11
    assert -0.13 < np.mean(comfort) < 0.03
    assert np.std(comfort) < 0.1


@pytest.mark.parametrize(("threshold", "runs", "comfort_ma"), [(50.0, 1, np.nan), (1.0, 3, 2.0)])
def test_what_is_never_felt_or_never_enough_ends_at_the_ceiling(threshold, runs, comfort_ma):
    found = rise(SimulatedSubject(threshold, 90.0, guess=0), ceiling_ma=2.0)
    assert found.runs == runs
    assert found.felt == found.usable == (runs > 1)
    assert found.comfort_ma == pytest.approx(comfort_ma, nan_ok=True)


def test_runs_that_differ_are_made_again():
    subject = SimulatedSubject(1.2, 2.4, slope=0.5, seed=7)
    assert rise(subject, seed=7).runs == 5


def test_keys_without_current_are_counted_and_restart_the_pause():
    rising = Rising(repeats=1)
    for _ in range(200):
        assert rising.level_ma == 0
        rising.answer(True)
    rising.until(1e-9)
    # A key press at the first step of current is too early to be a reaction.
    rising.answer(True)
    assert rising.level_ma == 0
    for level_ma in (1.0, 2.0):
        rising.until(level_ma)
        rising.answer(True)
    assert (rising.found.runs, rising.found.false_presses) == (1, 201)


def test_a_key_held_down_ends_the_run_at_zero_and_is_believed_in_the_end():
    """A held key may mean pain: the current stops, and the run is repeated at most twice."""
    rising = Rising(repeats=1)
    for run in range(MOST_HURRIED + 1):
        rising.until(1.0)
        rising.answer(True)
        rising.answer(True)
        if run < MOST_HURRIED:
            assert rising.level_ma == 0
    assert rising.found is not None
    assert not rising.found.usable


@given(
    ceiling=st.floats(0.05, 5),
    expected=st.floats(0.05, 5),
    share=st.floats(0, 0.3),
    seed=st.integers(0, 2**31),
)
def test_whatever_is_pressed_it_ends_within_the_ceiling(ceiling, expected, share, seed):
    random = np.random.default_rng(seed)
    rising = Rising(ceiling, expected, seed=seed)
    for _ in range(20_000):
        if rising.found is not None:
            break
        # Press only while current flows: a key press during the pause restarts the pause.
        rising.answer(rising.level_ma > 0 and random.random() < share)
    assert rising.found is not None or share > 0.02
    if rising.found is not None and rising.found.felt:
        assert 0 < rising.found.threshold_ma <= rising.found.comfort_ma <= ceiling
