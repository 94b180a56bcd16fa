"""SmartTouch: touch what a sensor sees.

Optical frames of print become a tactile image, the tactile image becomes a
time-division scan sequence of optimizer-designed kernels, and the sequence is
proved safe before an electro-tactile display board gets it::

    import smarttouch as st

    profile = st.load_profile("electric-mouse")
    with st.open_source("text:touch", profile) as source, \\
            st.open_display("simulated:", profile) as display:
        statistics = st.run(source, display, mode="RA")

Nothing heavy is imported before it is used.
"""

from typing import TYPE_CHECKING

from smarttouch.base.lazy_names import lazy_names
from smarttouch.base.version import __version__

if TYPE_CHECKING:
    from smarttouch.base.afferent import Afferent
    from smarttouch.base.errors import (
        BoardError,
        LevelNotReachedError,
        ProfileError,
        SafetyError,
        SmartTouchError,
        SourceError,
    )
    from smarttouch.base.tactile_image import TactileImage
    from smarttouch.boards.board import Board
    from smarttouch.boards.driver import Driver
    from smarttouch.kernels.bank import load_kernels
    from smarttouch.kernels.switched_design import design_kernel
    from smarttouch.physiology.finger import Finger
    from smarttouch.profile import Profile, list_profiles, load_profile
    from smarttouch.running.config import RunConfig
    from smarttouch.running.display import Display, Session, open_display, show_together
    from smarttouch.running.program import Shown
    from smarttouch.running.recorder import Recorder
    from smarttouch.running.recording import RecordedRun, load_recording
    from smarttouch.running.run_statistics import RunStatistics
    from smarttouch.running.runner import replay, run, steps
    from smarttouch.running.step import Listener, StepResult
    from smarttouch.sources import open_source
    from smarttouch.sources.source_contract import Frame, OpticalSource, Stimulus, StimulusSource
    from smarttouch.stimulation.safety_gate import SafetyLimits
    from smarttouch.stimulation.scan_sequence import ScanSequence
    from smarttouch.views.delivered_drawing import DeliveredPicture
    from smarttouch.views.vibrator import Vibrator

__all__ = [
    "Afferent", "Board", "BoardError", "DeliveredPicture", "Display", "Driver", "Finger",
    "Frame", "LevelNotReachedError", "Listener", "OpticalSource", "Profile", "ProfileError",
    "RecordedRun", "Recorder", "RunConfig", "RunStatistics", "SafetyError", "SafetyLimits",
    "ScanSequence", "Session", "Shown", "SmartTouchError", "SourceError", "StepResult", "Stimulus",
    "StimulusSource", "TactileImage", "Vibrator", "__version__", "design_kernel", "list_profiles",
    "load_kernels", "load_profile", "load_recording", "open_display", "open_source", "replay",
    "run", "show_together", "steps",
]  # fmt: skip

if not TYPE_CHECKING:  # else any name would be one to a type checker
    __getattr__ = lazy_names(__name__)


def __dir__() -> list[str]:
    return list(__all__)
