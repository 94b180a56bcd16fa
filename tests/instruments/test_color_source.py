"""A mixture asked for in time, late or not, and what went out of it."""

import numpy as np
import pytest

from smarttouch.base.afferent import Afferent
from smarttouch.instruments.color_mix import mix_colors
from smarttouch.instruments.color_source import LONGEST_US, ColorSource, notes, open_vibration
from smarttouch.instruments.skin_trace import open_trace

from ..said import numbers_in


@pytest.fixture
def make_source(profile, bank):
    def make(spec, seconds=0.5, **options):
        mixture = mix_colors(open_trace(spec, seconds), profile, bank, **options)
        return ColorSource(spec, profile, mixture), mixture

    return make


def asked(source, stretch=1.0):
    """Return time and stimulus of each read, each sequence as much longer than asked."""
    frames, now_us = [], 0
    while (frame := source.read(now_us * 1000)) is not None:
        frames.append((now_us, frame))
        now_us += int(frame.period_us * stretch)
    return frames


def test_every_request_comes_at_its_time(make_source):
    source, mixture = make_source("tone:30Hz,9um+tone:250Hz,1.5um+press:0.45N")
    pulsing = [(time, each) for time, each in asked(source) if each.activation.any()]
    assert [time for time, _ in pulsing] == mixture.time_us.tolist()
    drives = [each.activation[:, mixture.sites[0]] for _, each in pulsing]
    np.testing.assert_array_equal(drives, mixture.drive)
    for afferent in Afferent:
        np.testing.assert_array_equal(source.error_us(afferent), mixture.error_us(afferent))


def test_between_pulses_the_finger_is_looked_at(make_source):
    source, _ = make_source("tone:10Hz,20um")
    frames = asked(source)
    times = np.array([time for time, _ in frames])
    assert 5000 <= np.diff(times).min() <= np.diff(times).max() <= LONGEST_US
    assert source.frames == len(frames)


def test_where_sequences_are_longer_pulses_wait_and_none_is_lost(make_source):
    source, mixture = make_source("tone:30Hz,9um+press:0.45N")
    late = asked(source, stretch=1.7)
    assert sum(each.activation.any() for _, each in late) < len(mixture.time_us)
    for afferent in (Afferent.RA, Afferent.SAI):
        error_us = source.error_us(afferent)
        assert len(error_us) >= mixture.pulses(afferent) - 1
        assert error_us.max() > 5000
        # What would be due before long goes along.
        moved_us = error_us - mixture.error_us(afferent)[: len(error_us)]
        assert -mixture.least_us // 2 <= moved_us.min() < 0


def test_a_vibrator_goes_on_between_requests(make_source):
    source, mixture = make_source("tone:250Hz,1.5um", vibrated=True)
    row = Afferent.PC, mixture.sites[0]
    levels = [each.activation[row] for time, each in asked(source, 0.3) if 1e5 < time < 4e5]
    assert len(levels) > 20
    assert min(levels) > 0.8


def test_whose_word_on_force_counts(profile, make_source):
    source, mixture = make_source("press:1N")
    assert not source.knows_force
    assert np.isnan(source.read(0).force_n)
    pressing = ColorSource("it", profile, mixture, 0.7)
    assert pressing.knows_force
    assert pressing.read(0).force_n == 0.7
    assert pressing.duration_s == 0.5
    assert pressing.read(500_000_000) is None


def test_a_note_says_what_pc_costs_unless_a_vibrator_plays_it(profile, bank):
    source = open_vibration("tone:250Hz,1.5um", profile, seconds=0.5)
    (note,) = source.notes
    assert numbers_in(note) == [pytest.approx(bank.off_target[Afferent.PC].max(), abs=0.05)]
    # Not only by the bank's word: the kernel's own activation of RA nodes is beyond PC's.
    kernel = bank.weights[Afferent.PC][35]
    assert bank.receptor[Afferent.PC][35] @ kernel == pytest.approx(1, rel=1e-5)
    assert 1 < (bank.receptor[Afferent.RA] @ kernel).max() < numbers_in(note)[0]
    assert open_vibration("tone:250Hz,1.5um", profile, vibrated=True).notes == []


def test_notes_count_what_was_sent(profile, bank, make_source):
    spec = "tone:30Hz,9um+press:0.45N"
    source, mixture = make_source(spec, sites=range(64))
    asked(source)
    (first,) = notes(mixture)
    assert "RA" in first
    assert numbers_in(first)[:4] == [7, 14, 64, 38.4]
