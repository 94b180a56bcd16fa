"""From a trace to the skin and back: each class gets what it answers, alone or with others."""

import contextlib
import itertools
from dataclasses import dataclass

import numpy as np
import pytest
from scipy.io import wavfile

from smarttouch.base.afferent import Afferent
from smarttouch.base.clock import SimulatedClock
from smarttouch.base.stopping import StopRequest
from smarttouch.emulator.emulated_boards import SimulatedDriver
from smarttouch.instruments.color_mix import ColorSource, mix_colors
from smarttouch.instruments.receptor_responses import split_trace
from smarttouch.instruments.skin_trace import open_trace
from smarttouch.running.config import RunConfig
from smarttouch.running.inputs import Controls, ControlState
from smarttouch.running.loop import Loop
from smarttouch.running.pipeline import Pipeline
from smarttouch.running.run_statistics import RunStatistics
from smarttouch.running.step import Listener, as_listeners
from smarttouch.views.vibrator import Vibrator

from ..support.full import sample
from ..support.scans import board_without_finger
from .recover import recover

ALONE = {
    Afferent.RA: ("tone:30Hz,8um", 30.0),
    Afferent.SAI: ("press:0.45N", 25.0),
    Afferent.PC: ("tone:250Hz,1.5um", 125.0),
}
"""What drives one class, and the rate at which it pulses then: RA at every cycle, PC at every
second one, SAI at half of its full rate under half of the full force."""
RATE_WITHIN = 0.01
DRIVE_WITHIN = 0.02
"""Tolerances of what is recovered from delivered currents; beside one another 0.06, as each
class's filter lets a little of the other's vibration through."""


def drive_of(spec, afferent, profile):
    answers = split_trace(open_trace(spec), sai_full_n=profile.force.full_n)
    return float(np.median(answers[afferent].drive[2400:7200]))


@pytest.mark.parametrize("afferent", Afferent)
def test_each_class_is_driven_alone(afferent, profile, bank):
    spec, rate_hz = ALONE[afferent]
    got = feel(spec, profile, bank)
    assert set(got) == {afferent}
    assert got[afferent].rate_hz == pytest.approx(rate_hz, rel=RATE_WITHIN)
    median = np.median(got[afferent].drive)
    assert median == pytest.approx(drive_of(spec, afferent, profile), abs=DRIVE_WITHIN)


@pytest.mark.parametrize("pair", sample(itertools.combinations(Afferent, 2), 3))
def test_two_mixed_give_back_both(pair, profile, bank):
    got = feel("+".join(ALONE[each][0] for each in pair), profile, bank)
    assert set(got) == set(pair)
    for each in pair:
        spec, rate_hz = ALONE[each]
        assert got[each].rate_hz == pytest.approx(rate_hz, rel=RATE_WITHIN)
        assert np.median(got[each].drive) == pytest.approx(drive_of(spec, each, profile), abs=0.06)


def test_a_vibrator_plays_as_pc_answers_and_pc_gets_no_pulses(profile, bank, tmp_path):
    path = tmp_path / "pc.wav"
    spec = "+".join(spec for spec, _ in ALONE.values())
    got = feel(spec, profile, bank, vibrator=Vibrator(path))
    assert set(got) == {Afferent.RA, Afferent.SAI}
    assert got[Afferent.RA].rate_hz == pytest.approx(30, rel=RATE_WITHIN)
    rate_hz, wave = wavfile.read(path)
    lasting = wave[int(0.7 * rate_hz) : int(1.7 * rate_hz)].astype(float) / np.iinfo(wave.dtype).max
    assert np.abs(np.fft.rfft(lasting)).argmax() == 250
    drive = drive_of(ALONE[Afferent.PC][0], Afferent.PC, profile)
    assert np.sqrt(2) * lasting.std() == pytest.approx(LEVEL * drive, abs=0.06 * LEVEL)


def test_only_the_sites_that_were_chosen_pulse(profile, bank):
    got = feel("tone:30Hz,8um+press:0.3N", profile, bank, seconds=1.0, sites=[3, 60])
    assert [row.sites for row in got.values()] == [{3, 60}, {3, 60}]
    got = feel("tone:250Hz,1um", profile, bank, seconds=0.8, sites=[3, 20])
    assert got[Afferent.PC].sites == {11, 28}  # felt a pitch farther up


def test_more_vibration_is_more_current(profile, bank):
    medians = [
        np.median(feel(f"tone:30Hz,{um}um", profile, bank, seconds=1.0)[Afferent.RA].drive)
        for um in sample((7, 8.5, 10))
    ]
    assert medians == sorted(medians)
    assert medians[0] < 0.25 < 0.6 < medians[-1]


LEVEL = 0.25
"""Of the strongest: net current leaves PC its 125 Hz."""
RISEN_S = 0.55
"""By then intensity has risen."""


@dataclass
class Got:
    """Pulses of one class since intensity has risen, with drives as at full intensity."""

    time_s: np.ndarray
    drive: np.ndarray
    sites: set

    @property
    def rate_hz(self):
        return (len(self.time_s) - 1) / np.ptp(self.time_s)


def feel(spec, profile, bank, seconds=2.0, vibrator=None, **options):
    """Return what each class got, by afferent class."""
    trace = open_trace(spec, seconds)
    vibrated = vibrator is not None
    mixture = mix_colors(trace, profile, bank, vibrated=vibrated, **options)
    sensor = ColorSource(spec, profile, mixture, force_n=2 * profile.force.full_n)
    began_s = {}

    def watch(sent):
        began_s[sent.number] = sent.step.sequence.time_ns / 1e9

    board = board_without_finger(profile, SimulatedDriver)
    if vibrated:
        vibrator.prepare(None)
    with board, contextlib.closing(vibrator or Listener()):
        Loop(
            sensor,
            Pipeline(profile, bank, RunConfig(mode=mixture.mode, scan="points"), vibrated=vibrated),
            board,
            stop=StopRequest(),
            statistics=RunStatistics(),
            listeners=as_listeners([watch, *([vibrator] if vibrated else [])]),
            controls=Controls(ControlState(mixture.mode, LEVEL)),
            clock=SimulatedClock(),
        ).run()
        numbers, _, current_ua = board.driver.take_pulses()
        assert board.report().violations == 0
    time_s = np.array([began_s[number] for number in numbers.tolist()])
    risen = time_s > RISEN_S
    time_s, pulses = time_s[risen], recover(current_ua[risen] / LEVEL, profile, bank)
    assert pulses.likeness.min(initial=1) > 0.999
    got = {}
    for afferent in Afferent:
        its = pulses.afferent == afferent
        if its.any():
            sites = set(pulses.site[its].tolist())
            got[afferent] = Got(np.unique(time_s[its]), pulses.drive[its], sites)
    return got
