"""Frame in, scan sequence out: pure, without I/O and without a clock."""

import contextlib

import numpy as np

from smarttouch.errors import ScheduleError, SmartTouchError
from smarttouch.imaging.mapping import TactileMapper
from smarttouch.imaging.tactile_image import TactileImage
from smarttouch.kernels.bank import KernelBank
from smarttouch.primary import Mode, Primary
from smarttouch.profile import Profile
from smarttouch.running.config import RunConfig
from smarttouch.running.step import Step
from smarttouch.sources.frame import Frame, Pose, PulseRequest
from smarttouch.stimulation.intensity import SoftStart, force_gate
from smarttouch.stimulation.schedule import PointScan
from smarttouch.stimulation.timing import ScanTiming


class Pipeline:
    """Turns frames into scan sequences. Time comes in with each frame.

    Parameters
    ----------
    profile : Profile
        Device and finger.
    bank : KernelBank
        Kernels of the profile's array.
    config : RunConfig, optional
        Mode, rate, scan and tone; in natural mode the rate is the profile's.
    timing : ScanTiming, optional
        What the board fixes about the time of a scan.
    vibrated : bool
        Whether mechanical vibrators do what PC is to feel, and no current (paper, Section V).
    """

    def __init__(
        self,
        profile: Profile,
        bank: KernelBank,
        config: RunConfig | None = None,
        timing: ScanTiming | None = None,
        *,
        vibrated: bool = False,
    ) -> None:
        config = config or RunConfig()
        self._profile, self._bank, self._config = profile, bank, config
        self._timing, self._vibrated = timing, vibrated
        self._sharing = config.sharing(profile)
        self._mapper = TactileMapper(profile, config.light_on_dark, config.tone)
        self._soft_start = SoftStart(profile.limits.ramp_s)
        self._restarted = True
        self._scans: dict[Mode, PointScan] = {}
        self.change_mode(Mode(config.mode))

    def change_mode(self, mode: Mode) -> None:
        """Drive other afferents from the next frame on; intensity begins at zero.

        Raises
        ------
        SmartTouchError
            If the board, the profile or its kernels do not offer the mode; then the mode
            stays as it was.
        """
        self._scan(mode)
        self.mode = mode
        self.restart_softly()

    def offered(self) -> tuple[Mode, ...]:
        """Return the modes that the board, the profile and its kernels offer.

        Where each frame asks for its pulses, that is the one it asks in.
        """
        if self.mode is Mode.COLOR:
            return (self.mode,)
        modes = []
        for mode in Mode:
            if mode is Mode.COLOR:
                continue
            with contextlib.suppress(SmartTouchError):
                self._scan(mode)
                modes.append(mode)
        return tuple(modes)

    def _scan(self, mode: Mode) -> PointScan:
        if mode not in self._scans:
            bank, config, vibrated = self._bank, self._config, self._vibrated
            classes, vibrated = mode.primaries, vibrated and mode is Mode.COLOR
            if mode is Mode.COLOR:
                made = {*bank.weights, *((Primary.PC,) if vibrated else ())}
                classes = tuple(each for each in classes if each in made)
            # A rate asked for in one mode is not for the two of natural mode.
            natural = mode is Mode.NATURAL and bool(self._scans)
            softness = config.softness
            self._scans[mode] = PointScan(
                self._profile,
                bank,
                classes,
                None if natural else config.rate_hz,
                self._timing,
                self._profile.pulse.softness if softness is None else softness,
                vibrated,
                self._sharing,
            )
        return self._scans[mode]

    def process(self, frame: Frame, level: float = 1.0) -> Step:
        """Return the tactile image and the scan sequence of a frame.

        A frame that asks for its pulses gets just those.

        Parameters
        ----------
        frame : Frame
            Its force gates intensity; one that is not a number is no contact.
        level : float, in [0, 1]
            What the user asked for, of the strongest.
        """
        request, wanted, period_us = frame.request, level, None
        if request is not None:
            tactile = TactileImage(request.activation, frame.time_ns, frame.force_n)
            wanted, period_us = level * request.level, request.period_us
        elif self.mode is Mode.COLOR:
            raise ScheduleError(
                "mode color is for sources that ask for their pulses: choose RA",
                about="mode",
                problem="impossible",
                value="color",
                allowed="RA",
            )
        else:
            tactile = self._mapper.map(frame, self.mode)
        pressure = force_gate(frame.force_n, self._profile.force)
        intensity = self._soft_start.follow(pressure * wanted, frame.time_ns)
        scan = self._scans[self.mode]
        sequence = scan.schedule(tactile, intensity, pressure, period_us)
        restarted, self._restarted = self._restarted, False
        return Step(frame, tactile, sequence, self.mode, level, restarted, scan.asked_us)

    def restart_softly(self) -> None:
        """Let intensity rise from zero again, after the skin has felt nothing for a while."""
        self._soft_start.restart()
        for scan in self._scans.values():
            scan.restart()
        self._restarted = True

    def warm_up(self) -> None:
        """Run a printed frame through a twin of this pipeline, which is then thrown away.

        First calls import and allocate; in the loop that would cost a pulse.
        """
        twin = Pipeline(
            self._profile, self._bank, self._config, self._timing, vibrated=self._vibrated
        )
        optics, force = self._profile.optics, self._profile.force
        image = np.full((optics.sensor_rows, optics.sensor_columns), 230, np.uint8)
        image[::2, : optics.sensor_columns // 2] = 20
        request = None
        if self.mode is Mode.COLOR:
            active = np.ones((len(Primary), len(self._profile.electrodes)), np.float32)
            active[[each for each in Primary if each not in self._bank.weights]] = 0
            request = PulseRequest(active, 20_000)
        for time_ns in (0, 10**9):
            twin.process(Frame(image, time_ns, Pose(0, 0), force.full_n, request=request))
