"""Frame in, safe sequence out, and nothing remembered that should not be."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from smarttouch.base.afferent import Afferent, Mode
from smarttouch.base.errors import ScheduleError
from smarttouch.boards.kits.kajimoto61 import Kajimoto61Driver
from smarttouch.kernels.bank import load_bank
from smarttouch.profile import load_profile
from smarttouch.running.config import RunConfig
from smarttouch.running.pipeline import Pipeline
from smarttouch.sources.source_contract import Frame, Pose
from smarttouch.stimulation.pulse_rates import ScanTiming
from smarttouch.stimulation.safety_gate import SafetyGate, SafetyLimits

from ..raising import raises


def test_a_bar_fires_the_electrodes_over_it(profile, bank, make_frame, patch):
    pipeline = Pipeline(profile, bank, RunConfig(scan="points"))
    pipeline.process(make_frame(patch(), 0))
    step = pipeline.process(make_frame(patch(24, 40), 10**9))
    active = step.tactile.activation[Afferent.RA].reshape(8, 8) > 0
    assert active[:, 3:5].all()
    assert not active[:, [0, 1, 6, 7]].any()
    assert sorted(step.sequence.site) == list(np.flatnonzero(active.ravel()))
    assert not step.tactile.activation[Afferent.SAI].any()


def test_warming_up_changes_nothing(profile, bank, make_frame, patch):
    plain, warmed = (
        Pipeline(profile, bank, RunConfig(scan="points")),
        Pipeline(profile, bank, RunConfig(scan="points")),
    )
    warmed.warm_up()
    for time_ns in (0, 10**9):
        one, other = (p.process(make_frame(patch(), time_ns)).sequence for p in (plain, warmed))
        assert np.array_equal(one.current_ua, other.current_ua)


@given(
    st.lists(
        st.tuples(
            st.integers(0, 2**32 - 1),
            st.integers(1, 10**9),
            st.floats(-1, 20) | st.just(float("nan")),
        ),
        min_size=1,
        max_size=8,
    )
)
def test_any_sensor_input_is_safe(profile, bank, moments):
    pipeline, gate = (
        Pipeline(profile, bank, RunConfig(scan="points")),
        SafetyGate(SafetyLimits.of(profile)),
    )
    time_ns = 0
    for seed, wait, force in moments:
        rng = np.random.default_rng(seed)
        image = rng.integers(0, 256, (16, 16), np.uint8).repeat(4, 0).repeat(4, 1)
        gate.check(pipeline.process(Frame(image, time_ns, Pose(0, 0), force)).sequence)
        time_ns += wait


def test_the_board_s_time_is_planned_for(profile, bank, make_frame, patch):
    timing = ScanTiming(scan_us=30_000, in_index_order=True)
    pipeline = Pipeline(profile, bank, RunConfig(scan="points"), timing)
    pipeline.warm_up()
    pipeline.process(make_frame(patch(), 0))
    sequence = pipeline.process(make_frame(patch(), 10**9)).sequence
    assert sequence.period_us == 30_000 + 300 * sequence.slots
    assert np.all(np.diff(sequence.site.astype(int)) > 0)
    with raises(ScheduleError, names="pulse.width_us", value=200, allowed=50):
        Pipeline(profile, bank, RunConfig(scan="points"), ScanTiming(width_us=50))


def test_frames_of_another_size_are_taken(profile, bank, make_frame, patch):
    pipeline = Pipeline(profile, bank, RunConfig(scan="points"))
    pipeline.process(make_frame(patch(), 0))
    large = patch(24, 40).repeat(10, 1).repeat(7, 0)
    step = pipeline.process(make_frame(large, 10**9))
    assert (step.tactile.activation[Afferent.RA].reshape(8, 8)[:, 3:5] > 0).all()


def test_a_change_of_mode_begins_at_zero(profile, bank, make_frame, patch):
    pipeline = Pipeline(profile, bank, RunConfig(scan="points"))
    for step in range(60):
        sequence = pipeline.process(make_frame(patch(), step * 20_000_000)).sequence
    assert sequence.intensity == 1
    pipeline.change_mode(Mode.NATURAL)
    steps = [pipeline.process(make_frame(patch(), (60 + i) * 20_000_000)) for i in range(60)]
    assert [step.restarted for step in steps] == [i == 0 for i in range(60)]
    assert steps[0].sequence.intensity == 0
    assert steps[-1].sequence.intensity == 1
    # What stays is felt by SAI alone.
    assert not steps[-1].tactile.activation[Afferent.RA].any()
    assert steps[-1].tactile.activation[Afferent.SAI].any()


def test_modes_that_a_board_offers(profile, bank):
    for_images = (Mode.RA, Mode.SAI, Mode.PC, Mode.NATURAL)
    assert Pipeline(profile, bank, RunConfig(scan="points")).offered() == for_images
    assert Pipeline(profile, bank, RunConfig(rate_hz=40, scan="points")).offered() == for_images
    assert Pipeline(profile, bank, RunConfig(mode=Mode.COLOR, scan="points")).offered() == (
        Mode.COLOR,
    )
    one_rate = Pipeline(profile, bank, RunConfig(scan="points"), ScanTiming(whole_hz=True))
    assert one_rate.offered() == (Mode.RA, Mode.SAI, Mode.PC)
    with raises(ScheduleError, names="mode", value="natural", allowed=("RA", "SAI")):
        one_rate.change_mode(Mode.NATURAL)
    assert one_rate.mode is Mode.RA
    kit = load_profile("kajimoto-61")
    assert Pipeline(
        kit, load_bank(kit), RunConfig(scan="points"), Kajimoto61Driver.timing
    ).offered() == (Mode.RA,)
