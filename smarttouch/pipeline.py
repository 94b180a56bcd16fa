"""Frame in, scan sequence out: pure, without I/O and without a clock."""

import math
from dataclasses import dataclass

import numpy as np

from smarttouch.imaging.mapping import TactileMapper
from smarttouch.imaging.tactile_image import TactileImage
from smarttouch.modes.bank import KernelBank
from smarttouch.primary import Primary
from smarttouch.profile import Profile
from smarttouch.scan.intensity import SoftStart, force_gate
from smarttouch.scan.schedule import PointScan
from smarttouch.scan.sequence import ScanSequence
from smarttouch.scan.timing import ScanTiming
from smarttouch.sensing.frame import Frame, Pose


@dataclass(frozen=True)
class Step:
    """One frame's way through the corridor."""

    frame: Frame
    tactile: TactileImage
    sequence: ScanSequence


class Pipeline:
    """Turns frames into scan sequences. Time comes in with each frame.

    Parameters
    ----------
    profile : Profile
        Device and finger.
    bank : KernelBank
        Kernels of the profile's array.
    primary : Primary
        The tactile primary color to stimulate.
    rate_hz : float, optional
        Sequences a second; the profile's own if not given.
    light_on_dark : bool
        For light print on dark paper.
    timing : ScanTiming, optional
        What the board fixes about the time of a scan.
    """

    def __init__(
        self,
        profile: Profile,
        bank: KernelBank,
        primary: Primary = Primary.RA,
        rate_hz: float | None = None,
        light_on_dark: bool = False,
        timing: ScanTiming | None = None,
    ) -> None:
        if rate_hz is None:
            rate_hz = profile.pulse.rate_hz
        self.period_us = math.ceil(1e6 / rate_hz) if rate_hz > 0 else 0
        self._settings = (profile, bank, primary, rate_hz, light_on_dark, timing)
        self._profile = profile
        self._mapper = TactileMapper(profile, primary, light_on_dark)
        self._soft_start = SoftStart(profile.limits.ramp_s)
        self._scan = PointScan(profile, bank, primary, rate_hz, timing)

    def process(self, frame: Frame) -> Step:
        """Return the tactile image and the scan sequence of a frame."""
        tactile = self._mapper.map(frame)
        wanted = force_gate(frame.force_n, self._profile.force)
        intensity = self._soft_start.follow(wanted, frame.time_ns)
        return Step(frame, tactile, self._scan.schedule(tactile, intensity))

    def restart_softly(self) -> None:
        """Let intensity rise from zero again, after the skin has felt nothing for a while."""
        self._soft_start.restart()

    def warm_up(self) -> None:
        """Run a printed frame through a twin of this pipeline, which is then thrown away.

        First calls import and allocate; in the loop that would cost a pulse.
        """
        twin = Pipeline(*self._settings)
        optics, force = self._profile.optics, self._profile.force
        image = np.full((optics.sensor_rows, optics.sensor_columns), 230, np.uint8)
        image[::2, : optics.sensor_columns // 2] = 20
        for time_ns in (0, 10**9):
            twin.process(Frame(image, time_ns, Pose(0, 0), force.full_n))
