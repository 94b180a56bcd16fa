"""In a mixture of classes, each class has its own pulse rate and its own strength."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import smarttouch
from smarttouch.base.afferent import Afferent, Mode
from smarttouch.base.errors import ScheduleError
from smarttouch.instruments.vibration_stimuli import (
    LONGEST_US,
    VIBRATION_US,
    ColorSource,
    disc,
    merged,
    mix_colors,
    notes,
    open_vibration,
    stimulated,
)
from smarttouch.instruments.vibration_trace import open_trace, split_trace
from smarttouch.kernels.bank import load_bank
from smarttouch.profile import load_profile
from smarttouch.stimulation.scan_sequence import ScanTiming

from ..support.checks import numbers_in, raises

ALL = "tone:30Hz,9um+tone:250Hz,1.5um+press:0.45N"

trains = st.lists(
    st.lists(st.integers(4999, 40_000), max_size=30).map(lambda steps: np.cumsum(steps)), max_size=3
)


@given(trains)
def test_no_pulse_is_moved_by_more_than_half_of_the_shortest_sequence(times):
    begins, carried = merged([np.array(each, np.int64) for each in times], 5000)
    assert (np.diff(begins) >= 5000).all()
    for ideal, which in zip(times, carried, strict=True):
        assert len(np.unique(which)) == len(ideal)  # one sequence for each pulse
        assert (np.abs(begins[which] - ideal) <= 2501).all()
    used = np.unique(np.concatenate([np.empty(0, int), *carried]))
    assert len(used) == len(begins)  # each sequence has a pulse


def test_stimuli_are_within_limits_and_at_the_right_sites(profile, bank):
    mixture = mix_colors(open_trace(ALL, 1.0), profile, bank, sites=[27, 36])
    times_us = [each.time_ns // 1000 for each in mixture.stimuli]
    np.testing.assert_array_equal(times_us, mixture.time_us)
    for each, after_us in zip(mixture.stimuli, [*times_us[1:], None], strict=True):
        assert each.period_us >= 1e6 / profile.limits.rate_hz
        assert after_us is None or each.time_ns // 1000 + each.period_us == after_us
        active = each.activation.any(axis=0)
        assert set(np.flatnonzero(active)) == {27, 36}
        assert each.activation.dtype == np.float32
        assert 0 <= each.activation.min() <= each.activation.max() <= 1
    assert mixture.mode is Mode.COLOR


def test_pc_is_slowed_to_what_current_can_do(profile, bank):
    def pc_us(hz):
        mixture = mix_colors(open_trace(f"tone:{hz}Hz,6um", 1.0), profile, bank)
        return np.median(np.diff(mixture.ideal_us[Afferent.PC]))

    np.testing.assert_allclose([pc_us(hz) for hz in (100, 250, 400)], [10000, 8000, 7500], atol=1)


def test_a_vibrator_does_it_instead_of_pulses_of_pc(profile, bank):
    mixture = mix_colors(open_trace(ALL, 1.0), profile, bank, vibrated=True)
    assert mixture.vibrated
    assert Afferent.PC not in mixture.ideal_us
    assert np.diff(mixture.time_us).max() <= 1.5 * VIBRATION_US
    # All stimuli contain the PC drive, including stimuli for RA and SAI pulses.
    middle = (mixture.time_us > 100_000) & (mixture.time_us < 900_000)
    assert (mixture.drive[middle, Afferent.PC] > 0.8).all()
    assert mixture.pulses(Afferent.RA) == 29
    quiet = mix_colors(open_trace("tone:30Hz,9um", 1.0), profile, bank, vibrated=True)
    assert not quiet.vibrated


def test_a_board_without_pc_leaves_it_out_or_refuses():
    profile = load_profile("kajimoto-61")
    bank = load_bank(profile)
    mixture = mix_colors(open_trace(ALL, 0.5), profile, bank)
    assert mixture.left_out == (Afferent.SAI, Afferent.PC)
    assert not mixture.drive[:, [Afferent.SAI, Afferent.PC]].any()
    only = {"value": (Afferent.PC,), "allowed": (Afferent.RA,)}
    with raises(ScheduleError, **only):
        mix_colors(open_trace("tone:250Hz,1um", 0.5), profile, bank)
    assert mix_colors(open_trace("tone:250Hz,1um", 0.5), profile, bank, vibrated=True).vibrated


def test_a_board_with_one_rate_takes_one_class(profile, bank):
    timing = ScanTiming(whole_hz=True)
    assert mix_colors(open_trace("tone:30Hz,9um"), profile, bank, timing=timing).mode is Mode.RA
    both = {"value": (Afferent.RA, Afferent.SAI)}
    with raises(ScheduleError, **both):
        mix_colors(open_trace("tone:30Hz,9um+press:1N"), profile, bank, timing=timing)


def test_nothing_to_answer_is_no_stimulus(profile, bank):
    mixture = mix_colors(open_trace("press:0N", 1.0), profile, bank)
    assert (mixture.stimuli, mixture.end_us) == ([], 1_000_000)


def test_where_pc_is_felt_elsewhere_its_pulses_move(profile, bank):
    assert profile.perception.pc_shift_mm == (0, -2)
    assert stimulated(profile, Afferent.PC, np.array([3, 59])).tolist() == [11]
    assert stimulated(profile, Afferent.RA, np.array([3, 59])).tolist() == [3, 59]
    with raises(ScheduleError, value=(Afferent.PC,)):
        mix_colors(open_trace("tone:250Hz,1um", 0.3), profile, bank, sites=[59])


def test_masked_sites_are_not_in_the_disc(profile, changed):
    assert disc(changed(profile, {"output.masked": (27,)})).tolist() == [28, 35, 36]
    with raises(ScheduleError, names="site", value=64):
        mix_colors(open_trace(ALL, 1.0), profile, load_bank(profile), sites=[64])


@pytest.fixture
def make_source(profile, bank):
    def make(spec, seconds=0.5, **options):
        mixture = mix_colors(open_trace(spec, seconds), profile, bank, **options)
        return ColorSource(spec, profile, mixture), mixture

    return make


def asked(source, stretch=1.0):
    """Return the time, µs, and stimulus of each read. Periods are ``stretch`` times as long."""
    frames, now_us = [], 0
    while (frame := source.read(now_us * 1000)) is not None:
        frames.append((now_us, frame))
        now_us += int(frame.period_us * stretch)
    return frames


def test_between_pulses_the_finger_is_looked_at(make_source):
    source, _ = make_source("tone:10Hz,20um")
    frames = asked(source)
    times = np.array([time for time, _ in frames])
    assert 5000 <= np.diff(times).min() <= np.diff(times).max() <= LONGEST_US
    assert source.frames == len(frames)


@pytest.mark.parametrize("stretch", [1.0, 1.7])
def test_where_sequences_are_longer_pulses_wait_and_none_is_lost(make_source, stretch):
    source, mixture = make_source("tone:30Hz,9um+press:0.45N")
    first = 0
    for now_us, stimulus in asked(source, stretch):
        due = int((mixture.time_us <= now_us + mixture.least_us // 2).sum())
        wanted = mixture.drive[first:due].max(axis=0, initial=0)
        np.testing.assert_array_equal(stimulus.activation[:, mixture.sites[0]], wanted)
        first = due
    assert first >= len(mixture.time_us) - 1


def test_a_note_says_what_pc_costs_unless_a_vibrator_plays_it(profile, bank):
    source = open_vibration("tone:250Hz,1.5um", profile, seconds=0.5)
    (note,) = source.notes
    assert numbers_in(note) == [pytest.approx(bank.off_target[Afferent.PC].max(), abs=0.05)]
    # This PC kernel activates RA more strongly than PC. The note states the strongest of all.
    kernel = bank.weights[Afferent.PC][35]
    assert bank.receptor[Afferent.PC][35] @ kernel == pytest.approx(1, rel=1e-5)
    assert 1 < (bank.receptor[Afferent.RA] @ kernel).max() < numbers_in(note)[0]
    assert open_vibration("tone:250Hz,1.5um", profile, vibrated=True).notes == []


def test_notes_count_what_was_sent(make_source):
    spec = "tone:30Hz,9um+press:0.45N"
    source, mixture = make_source(spec, sites=range(64))
    asked(source)
    (first,) = notes(mixture)
    assert "RA" in first
    assert numbers_in(first)[:4] == [7, 14, 64, 38.4]


ALONE = {
    Afferent.RA: ("tone:30Hz,8um", 30.0),
    Afferent.SAI: ("press:0.45N", 25.0),
    Afferent.PC: ("tone:250Hz,1.5um", 125.0),
}
"""Traces to which only one class responds, and the pulse rate of this class in Hz. RA has one pulse
per cycle, PC one per two cycles. At half of the full force, SAI has half of its full rate."""
LEVEL = 0.25
"""Intensity at which the limit of net current still allows PC pulses at 125 Hz."""


@pytest.mark.parametrize("classes", [[each] for each in Afferent] + [list(Afferent)])
def test_what_is_mixed_is_sent_at_the_rate_and_drive_of_each_class(classes, profile):
    source = open_vibration("+".join(ALONE[each][0] for each in classes), profile)
    steps = [
        step
        for step in smarttouch.steps(source, profile, intensity=LEVEL, **source.settings)
        if step.sequence.intensity == LEVEL and step.sequence.slots
    ]
    for afferent in Afferent:
        sent = [step for step in steps if step.tactile.activation[afferent].any()]
        assert bool(sent) == (afferent in classes)
        if sent:
            spec, rate_hz = ALONE[afferent]
            time_s = np.array([step.sequence.time_ns for step in sent]) / 1e9
            assert (len(sent) - 1) / np.ptp(time_s) == pytest.approx(rate_hz, rel=0.01)
            drive = np.median([step.tactile.activation[afferent].max() for step in sent])
            answer = split_trace(open_trace(spec), sai_full_n=profile.force.full_n)[afferent]
            # In a mixture, the filter of a class passes a little of the other class's vibration.
            within = 0.02 if len(classes) == 1 else 0.06
            assert drive == pytest.approx(np.median(answer.drive[2400:7200]), abs=within)
