"""A trace all the way to the skin: what each class got, recovered from delivered currents alone."""

import contextlib
from dataclasses import dataclass

import numpy as np

from smarttouch.base.afferent import Afferent
from smarttouch.base.clock import SimulatedClock
from smarttouch.base.stopping import StopRequest
from smarttouch.emulator.emulated_boards import SimulatedDriver
from smarttouch.instruments.color_mix import mix_colors
from smarttouch.instruments.color_source import ColorSource
from smarttouch.instruments.skin_trace import open_trace
from smarttouch.running.config import RunConfig
from smarttouch.running.inputs import Controls, ControlState
from smarttouch.running.loop import Loop
from smarttouch.running.pipeline import Pipeline
from smarttouch.running.run_statistics import RunStatistics
from smarttouch.running.step import Listener, as_listeners

from ..played import played
from ..reference.recover import recover

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
    """Return what each class got, by afferent class, and the sensor that asked for it."""
    trace = open_trace(spec, seconds)
    vibrated = vibrator is not None
    mixture = mix_colors(trace, profile, bank, vibrated=vibrated, **options)
    sensor = ColorSource(spec, profile, mixture, force_n=2 * profile.force.full_n)
    began_s = {}

    def watch(sent):
        began_s[sent.number] = sent.step.sequence.time_ns / 1e9

    board = played(profile, SimulatedDriver)
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
    return got, sensor
