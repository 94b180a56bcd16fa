"""SmartTouch: touch what a sensor sees.

Optical frames of print become a tactile image, the tactile image becomes a
time-division scan sequence of optimizer-designed kernels, and the sequence is
proved safe before an electro-tactile display board gets it::

    import smarttouch as st

    profile = st.load_profile("electric-mouse")
    with st.open_source("text:touch", profile) as source, \\
            st.open_display("emulator:", profile) as display:
        statistics = st.run(source, display, mode="RA")

Nothing heavy is imported before it is used.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from smarttouch.version import __version__

if TYPE_CHECKING:
    from smarttouch.afferent import Afferent
    from smarttouch.boards.board import Board
    from smarttouch.errors import (
        BoardError,
        LevelNotReachedError,
        ProfileError,
        SafetyError,
        SmartTouchError,
        SourceError,
    )
    from smarttouch.front import design_kernel, load_kernels, replay, run, steps
    from smarttouch.physiology.finger import Finger
    from smarttouch.profile import Profile, list_profiles, load_profile
    from smarttouch.recording.recorded_run import RecordedRun, load_recording
    from smarttouch.recording.recorder import Recorder
    from smarttouch.running.config import RunConfig
    from smarttouch.running.display import Display, open_display
    from smarttouch.running.listener import Listener
    from smarttouch.running.session import Session, Shown, show_together
    from smarttouch.running.statistics import RunStatistics
    from smarttouch.running.step import StepResult
    from smarttouch.sources import open_source
    from smarttouch.sources.frame import Frame
    from smarttouch.sources.source import OpticalSource, StimulusSource
    from smarttouch.stimulation.safety import SafetyLimits
    from smarttouch.stimulation.sequence import ScanSequence
    from smarttouch.tactile_image import TactileImage


__all__ = [
    "Afferent",
    "Board",
    "BoardError",
    "Display",
    "Finger",
    "Frame",
    "LevelNotReachedError",
    "Listener",
    "OpticalSource",
    "Profile",
    "ProfileError",
    "RecordedRun",
    "Recorder",
    "RunConfig",
    "RunStatistics",
    "SafetyError",
    "SafetyLimits",
    "ScanSequence",
    "Session",
    "Shown",
    "SmartTouchError",
    "SourceError",
    "StepResult",
    "StimulusSource",
    "TactileImage",
    "__version__",
    "design_kernel",
    "list_profiles",
    "load_kernels",
    "load_profile",
    "load_recording",
    "open_display",
    "open_source",
    "replay",
    "run",
    "show_together",
    "steps",
]

_WHERE = {
    "boards.board": ("Board",),
    "errors": (
        "BoardError",
        "LevelNotReachedError",
        "ProfileError",
        "SafetyError",
        "SourceError",
        "SmartTouchError",
    ),
    "front": ("design_kernel", "load_kernels", "replay", "run", "steps"),
    "tactile_image": ("TactileImage",),
    "physiology.finger": ("Finger",),
    "afferent": ("Afferent",),
    "profile": ("Profile", "list_profiles", "load_profile"),
    "recording.recorded_run": ("RecordedRun", "load_recording"),
    "recording.recorder": ("Recorder",),
    "running.config": ("RunConfig",),
    "running.display": ("Display", "open_display"),
    "running.listener": ("Listener",),
    "running.session": ("Session", "Shown", "show_together"),
    "running.statistics": ("RunStatistics",),
    "running.step": ("StepResult",),
    "sources": ("open_source",),
    "sources.frame": ("Frame",),
    "sources.source": ("OpticalSource", "StimulusSource"),
    "stimulation.safety": ("SafetyLimits",),
    "stimulation.sequence": ("ScanSequence",),
}
_MODULE = {name: f"smarttouch.{module}" for module, names in _WHERE.items() for name in names}


if not TYPE_CHECKING:  # else any name would be one to a type checker

    def __getattr__(name: str) -> Any:
        """Import a public name when it is used first."""
        if name not in _MODULE:
            raise AttributeError(f"module 'smarttouch' has no attribute {name!r}")
        value = getattr(import_module(_MODULE[name]), name)
        globals()[name] = value
        return value


def __dir__() -> list[str]:
    return list(__all__)
