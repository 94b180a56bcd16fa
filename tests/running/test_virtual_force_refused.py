"""Tests that current flows on a finger only at a stated or measured force, not a virtual one."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from smarttouch.base.afferent import Afferent
from smarttouch.base.clock import SimulatedClock
from smarttouch.base.errors import ProfileError, SourceError
from smarttouch.emulator.drivers import MemoryDriver
from smarttouch.imaging.reading_profile import reading_force_n
from smarttouch.instruments.electric_mouse import MouseSource, open_motion_over
from smarttouch.instruments.relief import open_texture
from smarttouch.running.config import RunConfig
from smarttouch.running.display import Display
from smarttouch.running.electrode_walk import Walk
from smarttouch.running.runner import Runner
from smarttouch.sources import open_source
from smarttouch.sources.force import ForceSource
from smarttouch.sources.source_contract import Source, Stimulus, StimulusSource

from ..support.checks import raises
from ..support.full import WHOLE, sample
from ..support.scans import board_without_finger

GOLDEN = Path(__file__).parents[1] / "running" / "goldens" / "ra.mcap"


class Pattern(StimulusSource):
    """Source of pulses on one electrode. ``measured`` says whether the source measures force."""

    knows_force = True

    def __init__(self, profile, measured=False):
        super().__init__("a pattern")
        self.measures_force, self._press_n = measured, reading_force_n(profile)

    def read(self, time_ns):
        activation = np.zeros((len(Afferent), 64), np.float32)
        activation[Afferent.RA, 27] = 1
        return Stimulus(activation, time_ns, self._press_n, 20_000)


def mouse(profile, folder):
    rows = [f"{k / 100},{k / 5},5,0.9" for k in range(200)]
    path = folder / "path.csv"
    path.write_text("\n".join(["time_s,x_mm,y_mm,force_n", *rows]))
    surface = open_texture("grating:2mm")
    return MouseSource(surface, open_motion_over(surface, f"path:{path}", profile), profile)


VIRTUAL = {
    "text": lambda profile, _: open_source("text:on", profile),
    "recording": lambda profile, _: open_source(f"recording:{GOLDEN}", profile),
    "stimuli": lambda profile, _: Pattern(profile),
    "walk": lambda profile, _: Walk(profile, 1.0, 0.5, sites=[27]),
    "mouse": mouse,
}
"""Sources with the force of a virtual finger, by name."""


class Pressed(MemoryDriver):
    """Board in memory that measures ``force_n``, or has no force sensor if this is None."""

    force_n = None

    def open(self, line, limits):
        if self.force_n is not None:
            line.board.force_n = self.force_n
        return replace(super().open(line, limits), force=self.force_n is not None)


@pytest.fixture
def flows(profile, bank):
    """Return a function that runs a source, and returns whether current flowed."""

    def run(source, force=None, *, on_board_n=None, in_profile=None, on_a_finger=True):
        law = profile.force.model_dump() | {"source": in_profile}
        kind = type("Pressed", (Pressed,), {"force_n": on_board_n})
        pressed = profile.model_copy(update={"force": law})
        board = board_without_finger(pressed, kind, clock=SimulatedClock(), on_a_finger=on_a_finger)
        Runner(
            source, Display(board, pressed), RunConfig(intensity=1.0, seconds=0.6), force=force,
            load_kernels=lambda _: bank,
        ).run()  # fmt: skip
        return any(each.current_ua.any() for each in board.driver.sequences)

    return run


@pytest.mark.parametrize("name", sample(VIRTUAL, 3))
def test_a_force_that_is_made_up_presses_on_no_finger(flows, profile, tmp_path, name):
    def source():
        return VIRTUAL[name](profile, tmp_path)

    with raises(SourceError, names="force"):
        flows(source())
    # Ways to give a real finger's force: for the run, in the profile, or measured by the board.
    ways = {
        "run": lambda newtons: flows(source(), f"fixed:{newtons}"),
        "profile": lambda newtons: flows(source(), in_profile=f"fixed:{newtons}"),
        "board": lambda newtons: flows(source(), on_board_n=newtons),
    }
    # To save time, test all ways only with "stimuli". Other sources get "run" and "board" only.
    for way in ways if WHOLE or name == "stimuli" else ("run",):
        assert ways[way](0.9)
    for way in ways if WHOLE or name == "stimuli" else ("board",):
        assert not ways[way](0)
    # Without a finger on the board, the virtual finger's force counts, whatever the profile says.
    assert flows(source(), on_a_finger=False, in_profile="hx711:/dev/nowhere")


def test_a_source_that_measures_force_needs_no_other(flows, profile):
    assert flows(Pattern(profile, measured=True))


def test_a_recorded_force_presses_on_no_finger(flows, profile):
    class Recorded(ForceSource):
        is_live = False

        def read(self, _time_ns):
            return 0.9

    with raises(SourceError, names="force"):
        flows(Pattern(profile), Recorded("a table"))
    assert flows(Pattern(profile), Recorded("a table"), on_a_finger=False)


def test_nothing_that_ships_measures_force_by_itself():
    import importlib
    import pkgutil

    import smarttouch

    for module in pkgutil.walk_packages(smarttouch.__path__, "smarttouch."):
        if module.name.partition(".")[2].partition(".")[0] not in ("__main__", "testing"):
            importlib.import_module(module.name)
    kinds = [Source]
    for kind in kinds:
        kinds += kind.__subclasses__()
    ours = [each for each in kinds if each.__module__.startswith("smarttouch.")]
    assert len(ours) > 10
    assert not [each for each in ours if each.measures_force]


@pytest.mark.parametrize("value", ["0.5", "fixed:", "", 0.5, math.nan])
def test_what_names_no_source_of_force(profile, value):
    law = profile.force.model_dump() | {"source": value}
    with raises(ProfileError, key="force.source"):
        profile.model_copy(update={"force": law})
