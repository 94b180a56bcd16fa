"""Stimuli get just the pulses that they ask for, within the same limits as everything."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from smarttouch.base.afferent import Afferent, Mode
from smarttouch.base.clock import SimulatedClock
from smarttouch.base.errors import SafetyError, ScheduleError
from smarttouch.kernels.bank import load_bank
from smarttouch.profile import load_profile
from smarttouch.running.config import RunConfig
from smarttouch.running.display import open_display
from smarttouch.running.pipeline import Pipeline
from smarttouch.running.runner import run
from smarttouch.sources.source_contract import Frame, Pose, Stimulus, StimulusSource
from smarttouch.stimulation.point_slots import perceived_at
from smarttouch.stimulation.safety_gate import SafetyGate, SafetyLimits

from ..raising import raises
from ..whole import sample

FULL_N = 0.9
BLANK = np.full((64, 64), 255, np.uint8)


def asking(activation, period_us=20_000, time_ns=0, level=1.0, force_n=FULL_N):
    rows = np.zeros((3, 64), np.float32)
    for afferent, sites in activation.items():
        rows[afferent, list(sites)] = 1
    return Stimulus(rows, time_ns, force_n, period_us, level)


def settled(profile, bank, mode, **options):
    """Return a pipeline at full intensity, and the time of its next frame."""
    config = RunConfig(mode=mode, scan="points")
    pipeline = Pipeline(profile, bank, config, **options)
    for time_ns in range(0, 10**9, 20_000_000):
        pipeline.process(asking({Afferent.RA: (27,)}, time_ns=time_ns))
    return pipeline, 3 * 10**9


def test_each_class_pulses_with_its_own_kernel_where_it_is_asked_for(profile, bank):
    pipeline, now = settled(profile, bank, Mode.COLOR)
    asked = {Afferent.RA: (9, 20), Afferent.SAI: (30,), Afferent.PC: (35, 36, 40)}
    sequence = pipeline.process(asking(asked, 25_000, now)).sequence
    assert (sequence.period_us, sequence.slots) == (25_000, 6)
    assert sorted(sequence.site[:2]) == [9, 20]
    for slot, afferent in enumerate([Afferent.RA] * 2 + [Afferent.SAI] + [Afferent.PC] * 3):
        site = sequence.site[slot]
        expected = bank.kernels(afferent)[site] * profile.full_ma[site] * 1000
        np.testing.assert_allclose(sequence.current_ua[slot], expected, atol=10)


def test_nothing_asked_is_silence_of_just_that_time(profile, bank):
    pipeline, now = settled(profile, bank, Mode.RA)
    sequence = pipeline.process(asking({}, 7_000, now)).sequence
    assert (sequence.slots, sequence.period_us) == (0, 7_000)


def test_any_period_down_to_the_limit_is_kept(profile, bank):
    pipeline, now = settled(profile, bank, Mode.RA)
    for step, period_us in enumerate((66_667, 22_222, 5_000)):
        # So weak that net current, all of one sign, leaves every rate to it.
        frame = asking({Afferent.RA: (27,)}, period_us, now + step, level=0.4)
        assert pipeline.process(frame).sequence.period_us == period_us
    with raises(ScheduleError, value=4_999, allowed=5_000):
        pipeline.process(asking({Afferent.RA: (27,)}, 4_999, now + 9))


def test_pulses_that_do_not_fit_lengthen_the_period_with_a_note(profile, bank):
    pipeline, now = settled(profile, bank, Mode.COLOR)
    everything = {each: range(64) for each in Afferent}
    step = pipeline.process(asking(everything, 10_000, now))
    assert step.asked_us == 10_000
    # PC of the last row would have to be stimulated below it: its 8 points have no slot.
    assert step.sequence.slots == 3 * 64 - 8
    assert step.sequence.period_us >= step.sequence.slots * 300
    SafetyGate(SafetyLimits.of(profile)).prove(step.sequence, ramped=False)


def test_level_and_force_and_soft_start_count_as_for_everyone(profile, bank):
    pipeline = Pipeline(profile, bank, RunConfig(mode=Mode.RA, scan="points"))
    site = {Afferent.RA: (27,)}
    assert pipeline.process(asking(site)).sequence.slots == 0
    rising = [pipeline.process(asking(site, time_ns=20_000_000 * each)) for each in range(1, 30)]
    assert rising[0].sequence.intensity == 0.04
    assert rising[11].sequence.intensity == pytest.approx(0.48)
    assert rising[-1].sequence.intensity == 1
    half = pipeline.process(asking(site, time_ns=10**9, level=0.25), 0.5)
    assert half.sequence.intensity == 0.125
    assert half.level == 0.5
    assert pipeline.process(asking(site, time_ns=2 * 10**9, force_n=0.1)).sequence.slots == 0


def test_a_class_that_cannot_be_driven_is_refused(profile, bank):
    pipeline, now = settled(profile, bank, Mode.RA)
    with raises(ScheduleError, value="SAI", allowed=("RA",)):
        pipeline.process(asking({Afferent.SAI: (3,)}, time_ns=now))
    board = load_profile("kajimoto-61")
    pipeline = Pipeline(board, load_bank(board), RunConfig(mode=Mode.COLOR, scan="points"))
    pipeline.warm_up()
    rows = np.zeros((3, 61), np.float32)
    rows[Afferent.PC, 5] = 1
    frame = replace(asking({}), activation=rows)
    with raises(ScheduleError, value="PC"):
        pipeline.process(frame)


def test_color_is_not_for_images(profile, bank):
    with raises(ScheduleError, value="color", allowed="RA"):
        Pipeline(profile, bank, RunConfig(mode=Mode.COLOR, scan="points")).process(
            Frame(BLANK, 0, Pose(0, 0), FULL_N)
        )


def test_all_classes_at_once_need_periods(profile, bank):
    pipeline, now = settled(profile, bank, Mode.COLOR)
    with raises(ScheduleError):
        pipeline.process(asking({Afferent.RA: (27,)}, None, now))


def test_a_vibrator_takes_pc_over(profile, bank):
    pipeline, now = settled(profile, bank, Mode.COLOR, vibrated=True)
    frame = asking({Afferent.PC: (35, 36), Afferent.RA: (4,)}, time_ns=now, level=0.5)
    sequence = pipeline.process(frame).sequence
    assert sequence.site.tolist() == [4]
    assert np.flatnonzero(sequence.vibration).tolist() == [35, 36]
    assert sequence.vibration.max() == sequence.intensity == 0.5
    gate = SafetyGate(SafetyLimits.of(profile))
    gate.prove(sequence, ramped=False)
    for wrong in (
        np.full(64, 0.6, np.float32), np.full(64, np.nan, np.float32), np.zeros(63, np.float32),
        np.full(64, -0.1, np.float32), np.zeros(64),
    ):  # fmt: skip
        with raises(SafetyError, limit="vibration"):
            gate.prove(replace(sequence, vibration=wrong), ramped=False)


def test_a_sensation_is_placed_at_the_receptor(profile, bank, changed):
    """A sensation at a place is stimulated where its axons run (Section III-B.4)."""
    shifted = changed(profile, {"perception.pc_shift_mm": (0.0, -2.0)})
    pipeline, now = settled(shifted, load_bank(shifted), Mode.COLOR)
    asked = {Afferent.PC: (27, 60), Afferent.RA: (27,)}
    sequence = pipeline.process(asking(asked, time_ns=now)).sequence
    # Felt 2 mm above where it is stimulated; below the last row there is nothing to stimulate.
    assert sequence.site.tolist() == [27, 35]


@given(shift=st.tuples(st.floats(-20, 20), st.floats(-20, 20)), afferent=st.sampled_from(Afferent))
def test_every_point_is_felt_within_half_a_cell_of_where_it_should_be(
    profile, changed, shift, afferent
):
    felt = perceived_at(
        changed(profile, {f"perception.{afferent.name.lower()}_shift_mm": shift}), afferent
    )
    if felt is None:
        assert shift == (0, 0)
        return
    place = profile.electrodes.position_mm
    here = felt < 64
    away = np.abs(place[here] + shift - place[felt[here]])
    assert (away <= np.array(profile.electrodes.cell_mm) / 2 + 1e-6).all()
    # Nowhere else: a place that no point is felt at lies more than half a cell from all of them.
    beyond = place[~here] + shift
    outside = np.abs(beyond) > np.abs(place).max(axis=0) + np.array(profile.electrodes.cell_mm) / 2
    assert outside.any(axis=1).all()


BRIGHTER_NS = 1_200_000_000


class Brighter(StimulusSource):
    """One electrode: weak pulses, and then the strongest."""

    knows_force = True

    def __init__(self, profile, period_us=20_000):
        super().__init__("weak, then strong")
        self._press_n, self._period_us = profile.force.full_n, period_us

    def read(self, time_ns):
        if time_ns > 2 * BRIGHTER_NS:
            return None
        activation = np.zeros((len(Afferent), 64), np.float32)
        activation[Afferent.RA, 27] = 0.05 if time_ns < BRIGHTER_NS else 1
        return Stimulus(activation, time_ns, self._press_n, self._period_us)


@pytest.mark.usefixtures("patient_boards")
@pytest.mark.parametrize("url", ["memory:", "emulator:"])
@pytest.mark.parametrize("period_us", sample([20_000, 120_000]))
def test_strong_pulses_after_weak_ones_rise_by_the_ramp(url, period_us, profile, changed):
    """Thresholds of an eighth: pulses of .17 of a full one open .68, and nothing is refused."""
    sensitive = changed(profile, {"perception.threshold_ma": 0.3, "perception.comfort_ratio": 8.0})
    display = open_display(url, sensitive)
    clock = SimulatedClock() if url == "memory:" else None
    if clock is not None:
        display.board._clock = clock
    results = []
    run(Brighter(sensitive, period_us), display, listeners=[results.append])
    assert all(each.number is not None for each in results)
    weak, strong = ([each for each in results if (each.step.input.time_ns < BRIGHTER_NS) is early]
                    for early in (True, False))  # fmt: skip
    assert weak[-1].step.sequence.intensity == 1
    rising = [each.step.sequence.intensity for each in strong]
    # What rounding leaves over, up to 32 µA, goes to the strongest electrode.
    weak = 4 * (0.125 + 0.05 * 0.875)
    assert weak + 85 / 500 - 0.001 < rising[0] < weak + 85 / 500 + 4 * 32 / 2400
    steps = rising[: rising.index(1) + 1]
    assert set(rising[len(steps) :]) <= {1}
    # By no more than a step of the ramp each.
    assert 0 < min(np.diff(steps)) <= max(np.diff(steps)) <= min(period_us / 1000, 80) / 500 + 0.01
