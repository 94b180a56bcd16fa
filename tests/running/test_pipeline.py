"""Tests of the pipeline: from frames, stimuli and measured voltages to safe scan sequences."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from smarttouch.base.afferent import Afferent, Mode
from smarttouch.base.clock import SimulatedClock
from smarttouch.base.errors import BoardError, ScheduleError
from smarttouch.boards.kits.kajimoto61 import Kajimoto61Driver
from smarttouch.emulator.drivers import MemoryDriver, SimulatedDriver
from smarttouch.kernels.bank import load_bank
from smarttouch.profile import load_profile
from smarttouch.running.config import RunConfig
from smarttouch.running.display import open_display
from smarttouch.running.pipeline import Pipeline, Regulator, make_regulator
from smarttouch.running.runner import run
from smarttouch.sources.source_contract import Frame, Pose, Stimulus, StimulusSource
from smarttouch.stimulation.charge_balance import ChargeBalance, RechargeRules
from smarttouch.stimulation.impedance_control import ImpedanceControl
from smarttouch.stimulation.safety_gate import SafetyGate, SafetyLimits
from smarttouch.stimulation.scan_sequence import ScanTiming

from ..support.checks import raises
from ..support.full import sample
from ..support.runs import undisturbed
from ..support.scans import board_without_finger, prove_alone

RA, SAI, PC = Afferent
SECOND_NS, PERIOD_NS = 10**9, 20_000_000


@pytest.fixture(scope="session")
def pipeline_of(profile, bank):
    """Return a function that makes pipelines with one slot for each point."""

    def make(mode=Mode.RA, timing=None, *, profile=profile, bank=bank, vibrated=False, **settings):
        config = RunConfig(mode=mode, scan="points", **settings)
        return Pipeline(profile, bank, config, timing, vibrated=vibrated)

    return make


@pytest.mark.parametrize("taller", [1, 7])
def test_a_bar_fires_the_electrodes_over_it(pipeline_of, make_frame, patch, taller):
    """Frames can have any size, and their size can change during a run."""
    pipeline = pipeline_of()
    pipeline.process(make_frame(patch(), 0))
    step = pipeline.process(make_frame(patch(24, 40).repeat(taller, 0), SECOND_NS))
    active = step.tactile.activation[RA].reshape(8, 8) > 0
    assert active[:, 3:5].all()
    assert not active[:, [0, 1, 6, 7]].any()
    assert sorted(step.sequence.site) == list(np.flatnonzero(active.ravel()))
    assert not step.tactile.activation[SAI].any()


def test_warming_up_changes_nothing(pipeline_of, make_frame, patch):
    plain, warmed = pipeline_of(), pipeline_of()
    warmed.warm_up()
    for time_ns in (0, SECOND_NS):
        one, other = (p.process(make_frame(patch(), time_ns)).sequence for p in (plain, warmed))
        assert np.array_equal(one.current_ua, other.current_ua)


_FORCES = st.floats(-1, 20) | st.just(float("nan"))
_MOMENTS = st.tuples(st.integers(0, 2**32 - 1), st.integers(1, 10**9), _FORCES)


@given(st.lists(_MOMENTS, min_size=1, max_size=8))
def test_any_sensor_input_is_safe(profile, pipeline_of, moments):
    pipeline, gate, time_ns = pipeline_of(), SafetyGate(SafetyLimits.of(profile)), 0
    for seed, wait, force in moments:
        rng = np.random.default_rng(seed)
        image = rng.integers(0, 256, (16, 16), np.uint8).repeat(4, 0).repeat(4, 1)
        gate.check(pipeline.process(Frame(image, time_ns, Pose(0, 0), force)).sequence)
        time_ns += wait


def test_a_change_of_mode_begins_at_zero(pipeline_of, make_frame, patch):
    pipeline = pipeline_of()
    steps = []
    for index in range(120):
        if index == 60:
            pipeline.change_mode(Mode.NATURAL)
        steps.append(pipeline.process(make_frame(patch(), index * PERIOD_NS)))
    assert [step.restarted for step in steps] == [i in (0, 60) for i in range(120)]
    assert [steps[at].sequence.intensity for at in (59, 60, 119)] == [1, 0, 1]
    # In natural mode a static image stimulates only SAI.
    assert not steps[-1].tactile.activation[RA].any()
    assert steps[-1].tactile.activation[SAI].any()


def test_modes_that_a_board_offers(pipeline_of):
    for_images = (Mode.RA, Mode.SAI, Mode.PC, Mode.NATURAL)
    assert pipeline_of().offered() == pipeline_of(rate_hz=40).offered() == for_images
    assert pipeline_of(Mode.COLOR).offered() == (Mode.COLOR,)
    one_rate = pipeline_of(timing=ScanTiming(whole_hz=True))
    assert one_rate.offered() == (Mode.RA, Mode.SAI, Mode.PC)
    with raises(ScheduleError, names="mode", value="natural", allowed=("RA", "SAI")):
        one_rate.change_mode(Mode.NATURAL)
    assert one_rate.mode is Mode.RA
    kit = load_profile("kajimoto-61")
    timing = Kajimoto61Driver.timing
    assert pipeline_of(timing=timing, profile=kit, bank=load_bank(kit)).offered() == (Mode.RA,)


# -- stimuli: pulses of the requested classes at the requested period, within all limits


def asking(activation, period_us=20_000, time_ns=0, level=1.0, force_n=0.9, electrodes=64):
    rows = np.zeros((3, electrodes), np.float32)
    for afferent, sites in activation.items():
        rows[afferent, list(sites)] = 1
    return Stimulus(rows, time_ns, force_n, period_us, level)


@pytest.fixture
def settled(pipeline_of):
    """Return a function that makes pipelines at full intensity; their next input is at `NOW`."""

    def make(mode, **options):
        pipeline = pipeline_of(mode, **options)
        for time_ns in range(0, SECOND_NS, PERIOD_NS):
            pipeline.process(asking({RA: (27,)}, time_ns=time_ns))
        return pipeline

    return make


NOW = 3 * SECOND_NS


def test_each_class_pulses_with_its_own_kernel_where_it_is_asked_for(profile, bank, settled):
    asked = {RA: (9, 20), SAI: (30,), PC: (35, 36, 40)}
    sequence = settled(Mode.COLOR).process(asking(asked, 25_000, NOW)).sequence
    assert (sequence.period_us, sequence.slots) == (25_000, 6)
    assert sorted(sequence.site[:2]) == [9, 20]
    for slot, afferent in enumerate([RA] * 2 + [SAI] + [PC] * 3):
        site = sequence.site[slot]
        expected = bank.kernels(afferent)[site] * profile.full_ma[site] * 1000
        np.testing.assert_allclose(sequence.current_ua[slot], expected, atol=10)


@pytest.mark.parametrize(("asked", "period_us", "slots"), [
    # All pulses have the same sign. The level is too low for net current to limit the rate.
    ({}, 7_000, 0), ({RA: (27,)}, 66_667, 1), ({RA: (27,)}, 22_222, 1), ({RA: (27,)}, 5_000, 1),
])  # fmt: skip
def test_any_period_down_to_the_limit_is_kept(settled, asked, period_us, slots):
    sequence = settled(Mode.RA).process(asking(asked, period_us, NOW, level=0.4)).sequence
    assert (sequence.slots, sequence.period_us) == (slots, period_us)


def test_pulses_that_do_not_fit_lengthen_the_period_with_a_note(profile, settled):
    everything = {each: range(64) for each in Afferent}
    step = settled(Mode.COLOR).process(asking(everything, 10_000, NOW))
    assert step.asked_us == 10_000
    # PC is stimulated one row below the receptor, so the 8 points of the last row have no slot.
    assert step.sequence.slots == 3 * 64 - 8
    assert step.sequence.period_us >= step.sequence.slots * 300
    prove_alone(profile, step.sequence)


def test_level_and_force_and_soft_start_count_as_for_everyone(pipeline_of):
    pipeline, site = pipeline_of(), {RA: (27,)}
    rising = [pipeline.process(asking(site, time_ns=PERIOD_NS * each)) for each in range(30)]
    assert rising[0].sequence.slots == 0
    assert [rising[at].sequence.intensity for at in (1, 12, 29)] == pytest.approx([0.04, 0.48, 1])
    half = pipeline.process(asking(site, time_ns=SECOND_NS, level=0.25), 0.5)
    assert (half.sequence.intensity, half.level) == (0.125, 0.5)
    faint = asking(site, time_ns=2 * SECOND_NS, force_n=0.1)
    assert pipeline.process(faint).sequence.slots == 0


@pytest.mark.parametrize(("mode", "profile_name", "given", "wrong"), [
    (Mode.RA, "electric-mouse", asking({SAI: (3,)}), {"value": "SAI", "allowed": ("RA",)}),
    (Mode.RA, "electric-mouse", asking({RA: (3,)}, 4_999), {"value": 4_999, "allowed": 5_000}),
    (Mode.COLOR, "electric-mouse", asking({RA: (27,)}, None), {}),
    (Mode.COLOR, "electric-mouse", Frame(np.full((64, 64), 255, np.uint8), 0, Pose(0, 0), 0.9),
     {"value": "color", "allowed": "RA"}),
    (Mode.COLOR, "kajimoto-61", asking({PC: (5,)}, electrodes=61), {"value": "PC"}),
])  # fmt: skip
def test_what_cannot_be_driven_is_refused(pipeline_of, mode, profile_name, given, wrong):
    profile = load_profile(profile_name)
    pipeline = pipeline_of(mode, profile=profile, bank=load_bank(profile))
    pipeline.warm_up()
    with raises(ScheduleError, **wrong):
        pipeline.process(given)


def test_a_vibrator_takes_pc_over(profile, settled):
    stimulus = asking({PC: (35, 36), RA: (4,)}, time_ns=NOW, level=0.5)
    sequence = settled(Mode.COLOR, vibrated=True).process(stimulus).sequence
    assert sequence.site.tolist() == [4]
    assert np.flatnonzero(sequence.vibration).tolist() == [35, 36]
    assert sequence.vibration.max() == sequence.intensity == 0.5
    prove_alone(profile, sequence)


def test_a_sensation_is_placed_at_the_receptor(profile, settled, changed):
    """PC is felt at the receptor, but stimulated where its axons run (paper, Section III-B.4)."""
    shifted = changed(profile, {"perception.pc_shift_mm": (0.0, -2.0)})
    pipeline = settled(Mode.COLOR, profile=shifted, bank=load_bank(shifted))
    sequence = pipeline.process(asking({PC: (27, 60), RA: (27,)}, time_ns=NOW)).sequence
    # PC at electrode 27 is stimulated 2 mm lower, at 35. Below electrode 60 there is no electrode.
    assert sequence.site.tolist() == [27, 35]


BRIGHTER_NS = 1_200_000_000


class Brighter(StimulusSource):
    """Source of pulses on one electrode: weak ones until `BRIGHTER_NS`, then the strongest."""

    knows_force = True

    def __init__(self, period_us):
        super().__init__("weak, then strong")
        self._period_us = period_us

    def read(self, time_ns):
        if time_ns > 2 * BRIGHTER_NS:
            return None
        stimulus = asking({RA: (27,)}, self._period_us, time_ns)
        return replace(
            stimulus, activation=stimulus.activation * (0.05 if time_ns < BRIGHTER_NS else 1)
        )


@pytest.mark.realtime
@pytest.mark.parametrize("url", sample(["emulator:", "memory:"]))
@pytest.mark.parametrize("period_us", sample([20_000, 120_000]))
def test_strong_pulses_after_weak_ones_rise_by_the_ramp(url, period_us, profile, changed):
    """Weak pulses with .17 of full current raise the ramp to 4 times .17. Strong pulses rise from
    this level. The board refuses no sequence."""
    sensitive = changed(profile, {"perception.threshold_ma": 0.3, "perception.comfort_ratio": 8.0})

    def attempt():
        display, results = open_display(url, sensitive), []
        if url == "memory:":
            display.board.clock = SimulatedClock()
        return run(Brighter(period_us), display, listeners=[results.append]), results

    (results,) = undisturbed(attempt)
    assert all(each.number is not None for each in results)
    weak, strong = ([each for each in results if (each.step.input.time_ns < BRIGHTER_NS) is early]
                    for early in (True, False))  # fmt: skip
    assert weak[-1].step.sequence.intensity == 1
    rising = [each.step.sequence.intensity for each in strong]
    # The strongest electrode also carries the rounding remainder, up to 32 µA.
    weak = 4 * (0.125 + 0.05 * 0.875)
    assert weak + 85 / 500 - 0.001 < rising[0] < weak + 85 / 500 + 4 * 32 / 2400
    steps = rising[: rising.index(1) + 1]
    assert set(rising[len(steps) :]) <= {1}
    # Each rise is at most what the ramp allows in the time since the last sequence, which is more
    # than a period if a busy computer delays a sequence.
    gaps_ms = np.diff([each.step.sequence.time_ns for each in strong[: len(steps)]]) / 1e6
    assert min(np.diff(steps)) > 0
    assert (np.diff(steps) <= np.minimum(gaps_ms, 80) / 500 + 0.01).all()


# -- regulation: measured voltages are stored in steps and change the next sequence


@pytest.fixture
def regulated(pipeline_of, make_frame, patch):
    """Return a function that processes a frame after each of several voltage measurements."""

    def regulated(regulator, *volts):
        pipeline, steps = pipeline_of(), []
        pipeline.regulator = regulator
        for index, each in enumerate(volts):
            measured = []
            if each is not None:
                before = steps[-1].sequence
                measured = [(before, np.full(before.slots, each, np.float32))]
            frame = make_frame(patch(), SECOND_NS * index)
            steps.append(pipeline.process(frame, allowed=1.0, observed=measured))
        return steps

    return regulated


def test_what_was_measured_is_kept_and_changes_what_is_sent(profile, regulated):
    steps = regulated(Regulator(ImpedanceControl(profile, "energy", 300.0)), None, 50, 100)
    assert [len(step.observed) for step in steps] == [0, 1, 1]
    assert steps[2].observed[0][0] is steps[1].sequence
    peaks = [np.abs(step.sequence.current_ua.astype(int)).max() for step in steps]
    # At twice the impedance, the current is divided by the square root of 2.
    assert peaks[2] == pytest.approx(peaks[1] / np.sqrt(2), rel=0.01)


@pytest.mark.parametrize("timing", [ScanTiming(own_widths=False), ScanTiming(width_us=200)])
def test_a_board_with_one_width_holds_energy_and_no_charge(profile, timing):
    def measures(driver, line, limits):
        return replace(MemoryDriver.open(driver, line, limits), measures=True, compliance_v=300.0)

    kind = type("Measuring", (MemoryDriver,), {"timing": timing, "open": measures})
    with board_without_finger(profile, kind) as board:
        assert make_regulator(board, profile, RunConfig(hold="energy"), print).impedance
        with raises(BoardError, names="hold=charge"):
            make_regulator(board, profile, RunConfig(hold="charge"), print)


def test_the_user_is_told_what_regulation_could_not_do(profile, regulated):
    """Pulses of this profile have the largest allowed width: hold=charge cannot lengthen them."""
    held = Regulator(ImpedanceControl(profile, "charge", 100.0))
    carried = Regulator(ledger=ChargeBalance(64), recharge=rules_of(profile))
    carried.ledger.charge_pc[:2] = [9_000_000, -9_000_000]
    reversing = Regulator(ledger=ChargeBalance(64))
    assert Regulator().notes() == held.notes() == []
    step = regulated(held, None, *[100] * 20)[-1]
    regulated(carried, None)
    regulated(reversing, *[None] * 4)
    (of_held,), (of_carried,), (of_reversing,) = (
        each.notes() for each in (held, carried, reversing)
    )
    assert f"{len(set(step.sequence.site))} sites" in of_held
    assert f"{carried.ledger.worst_uc:.2f} µC" in of_carried
    # The note says that reversed scans stimulate the other class.
    assert all(words in of_reversing for words in ("2 of 4 scans", "SAI", "RA"))


def rules_of(profile):
    return RechargeRules.of(profile, ScanTiming())


def test_after_a_lost_sequence_recharge_phases_are_what_the_gate_lets_through(
    profile, pipeline_of, make_frame, patch
):
    """The gate counts the charge of each proved sequence, even a lost one. So must the ledger."""
    pipeline, gate, recharges = pipeline_of(), SafetyGate(SafetyLimits.of(profile)), 0
    pipeline.regulator = Regulator(ledger=ChargeBalance(64), recharge=rules_of(profile))
    for index in range(40):
        frame = make_frame(patch(index, index + 9), index * 60_000_000)
        sequence = gate.check(pipeline.process(frame).sequence)
        recharges += sequence.recharge_us > 0
        if index % 3 == 2:
            pipeline.regulator.take_back(sequence)
    assert recharges > 20


@pytest.mark.parametrize(
    ("mode", "left_uc"),
    # Some PC scans leave more charge than one recharge phase can balance. Later scans balance it.
    sample([(Mode.RA, 0.02), (Mode.SAI, 0.02), (Mode.NATURAL, 0.02), (Mode.PC, 2.0)], 3),
)
def test_by_the_emulators_books_charge_is_back_and_the_same_is_felt(
    profile, pipeline_of, make_frame, patch, mode, left_uc
):
    ways = {
        "without": Regulator(),
        "reversing": Regulator(ledger=ChargeBalance(64)),
        "recharging": Regulator(ledger=ChargeBalance(64), recharge=rules_of(profile)),
    }
    passed_uc, pulses = {}, {}
    for way, regulator in ways.items():
        pipeline = pipeline_of(mode)
        pipeline.regulator = regulator
        with board_without_finger(profile, SimulatedDriver) as board:
            for index in range(40):
                # The period is long enough for each method, so all methods get the same frames.
                frame = make_frame(patch(index, index + 9), index * 60_000_000)
                board.send(pipeline.process(frame).sequence)
            books = board.driver._firmware.books
            passed_uc[way], pulses[way] = np.abs(books.passed_uc), board.driver.take_pulses()
            assert (books.violations, books.unsafe) == (0, 0)
            assert books.max_net_charge_uc < 1e-3
            assert (books.recharges > 20) == (way == "recharging")
    assert passed_uc["recharging"].max() < left_uc < 5 < passed_uc["without"].max()
    for was, now in zip(pulses["without"], pulses["recharging"], strict=True):
        assert np.array_equal(was, now), "recharge phases have changed the slots"
    turned = (pulses["reversing"][2] != pulses["without"][2]).any(axis=1)
    assert 0.2 < turned.mean() < 0.8, "the share of reversed slots is not between 0.2 and 0.8"
