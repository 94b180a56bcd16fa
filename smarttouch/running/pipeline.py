"""Conversion of inputs to scan sequences, without I/O and without a clock."""

import contextlib
import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from smarttouch.base.afferent import Afferent, Mode
from smarttouch.base.errors import BoardError, SmartTouchError
from smarttouch.boards.board import Board
from smarttouch.imaging.tactile_mapper import TactileMapper
from smarttouch.kernels.bank import KernelBank
from smarttouch.profile import Profile
from smarttouch.profile.project_ceilings import CEILING_NET_MA
from smarttouch.running.config import RunConfig
from smarttouch.running.step_records import Measured, Step
from smarttouch.sources.source_contract import Frame, Input, Pose, Stimulus
from smarttouch.stimulation.charge_balance import ChargeBalance, RechargeRules, add_recharge
from smarttouch.stimulation.impedance_control import RESERVED, ImpedanceControl
from smarttouch.stimulation.line_cue import LineCueMapper
from smarttouch.stimulation.safety_gate import Ramp
from smarttouch.stimulation.safety_limits import SafetyLimits, parts_per_billion
from smarttouch.stimulation.scan_sequence import KernelTable, ScanSequence, ScanTiming
from smarttouch.stimulation.scheduler import NetPlan, ScanScheduler, SchedulerContext, force_gate
from smarttouch.stimulation.sequence_limits import strength_ppb
from smarttouch.stimulation.slots import FrameSlots

_ROUNDING_UC = 0.02  # largest net charge, µC, due to the rounding of recharge currents to 1 µA


@dataclass
class Regulator:
    """Feedback from measured voltages and net charge to the next sequences.

    ``impedance`` keeps charge or energy constant while impedance drifts. ``ledger`` contains the
    net charge of each electrode. Recharge phases or reversed scans bring this charge back to zero.
    """

    impedance: ImpedanceControl | None = None
    ledger: ChargeBalance | None = None
    recharge: RechargeRules | None = None
    _scans: int = 0
    _reversed: int = 0
    _waited: int = 0

    def balance(self, sequence: ScanSequence, ledger: ChargeBalance) -> ScanSequence:
        """Return a balanced version of a sequence, and add this version's charge to the ledger."""
        if self.recharge is None:
            balanced = ledger.balancing(sequence)
            self._reversed += balanced is not sequence
        else:
            balanced = add_recharge(sequence, ledger.charge_pc, self.recharge)
        ledger.add(balanced)
        if balanced.slots:
            self._scans += 1
            self._waited += ledger.worst_uc > _ROUNDING_UC
        return balanced

    def take_back(self, sequence: ScanSequence) -> None:
        """Remove from the ledger a sequence that did not reach the board. With recharge phases, do
        nothing: the gate still counts the sequence, and ledger and gate must agree."""
        if self.ledger is not None and self.recharge is None:
            self.ledger.add(sequence, -1)

    def notes(self) -> list[str]:
        """Return notes for the user after the run."""
        notes = []
        if self.impedance is not None and (limited := self.impedance.limited):
            end = "full current" if self.impedance.holds == "energy" else "longest width"
            notes.append(
                f"{self.impedance.holds} could not be kept constant at {len(limited)} sites, "
                f"because pulses there have reached their {end}"
            )
        if self._reversed:
            notes.append(
                f"{self._reversed} of {self._scans} scans were reversed to balance charge: they "
                "stimulated the other class, SAI instead of RA or RA instead of SAI"
            )
        if self.recharge is not None and self.ledger is not None and self._waited:
            notes.append(
                f"{self._waited} of {self._scans} scans left more net charge than one recharge "
                f"phase can remove; at the end of the run {self.ledger.worst_uc:.2f} µC remain"
            )
        return notes


class Pipeline:
    """Conversion of frames and stimuli to scan sequences. Times come from the inputs.

    If ``vibrated``, mechanical vibrators stimulate PC, and PC gets no current. If ``in_sums``, each
    slot is a sum of quantized kernels, for boards that store kernels.
    """

    def __init__(
        self,
        profile: Profile,
        bank: KernelBank,
        config: RunConfig | None = None,
        timing: ScanTiming | None = None,
        *,
        vibrated: bool = False,
        in_sums: bool = False,
    ) -> None:
        config = config or RunConfig()
        self._profile, self._bank, self._config = profile, bank, config
        self._timing, self._vibrated = timing, vibrated
        self.electrodes: int = len(profile.electrodes)
        self._make_mapper = LineCueMapper if config.line_cue else TactileMapper
        self._mapper = self._make_mapper(profile, config.light_on_dark, config.tone)
        self._limits = SafetyLimits.of(profile)
        self.ramp: Ramp = Ramp(self._limits.ramp_ns)
        """Ramp for use without a board. It assumes that no sequence is sent late."""
        self.regulator: Regulator = Regulator()
        self._vibration, self._time_ns = 0.0, 0
        self._restarted = True
        self._common = SchedulerContext(config.sharing(profile))
        if not config.balance:
            self._common.net = NetPlan(self.electrodes)
        self._scans: dict[Mode, ScanScheduler] = {}
        self.table: KernelTable | None = None
        """Table of quantized kernels, if the board stores kernels. It contains the kernels of the
        bank and the kernels for shared slots."""
        if in_sums and profile.output.kind == "weighted":
            frames = {
                afferent: FrameSlots(profile, bank, afferent)
                for afferent in self._common.sharing.afferents
                if afferent in bank.weights
            }
            self._common.makers.update(frames)
            shared = {afferent: slots.kernels() for afferent, slots in frames.items()}
            self.table = self._common.table = KernelTable.of(bank.weights, shared)
            for slots in frames.values():
                slots.use_table(self.table)
        self.change_mode(Mode(config.mode))

    def change_mode(self, mode: Mode) -> None:
        """Change the mode for the next input; intensity restarts at zero.

        Raises an error and keeps the mode if board, profile or kernels do not offer the new mode.
        """
        self._scan(mode)
        self.mode = mode
        self.restart_at_zero()

    def offered(self) -> tuple[Mode, ...]:
        """Return the modes that board, profile and kernels offer. Changes to or from mode color are
        not offered, because this mode takes no frames."""
        modes = []
        for mode in Mode:
            with contextlib.suppress(SmartTouchError):
                if (mode is Mode.COLOR) == (self.mode is Mode.COLOR):
                    self._scan(mode)
                    modes.append(mode)
        return tuple(modes)

    def _scan(self, mode: Mode) -> ScanScheduler:
        if self._vibrated and mode is Mode.PC:
            raise SmartTouchError(
                "mode PC needs current, but in this run a vibrator stimulates PC: remove the "
                "vibrator, or use the source vibration:SPEC"
            )
        if mode not in self._scans:
            bank, config, classes = self._bank, self._config, mode.afferents
            vibrated, softness = self._vibrated and mode is Mode.COLOR, config.softness
            if mode is Mode.COLOR:
                possible = {*bank.weights, *[Afferent.PC] * vibrated}
                classes = tuple(afferent for afferent in classes if afferent in possible)
            # rate_hz is for one class. A change to natural mode restores the profile's two rates.
            natural = mode is Mode.NATURAL and bool(self._scans)
            self._scans[mode] = ScanScheduler(
                self._profile, bank, classes, None if natural else config.rate_hz, self._timing,
                self._profile.pulse.softness if softness is None else softness, vibrated,
                self._common,
            )  # fmt: skip
        return self._scans[mode]

    def process(
        self,
        given: Input,
        level: float = 1.0,
        allowed: float | None = None,
        observed: Sequence[Measured] = (),
    ) -> Step:
        """Return the tactile image and the scan sequence for a frame or stimulus.

        The force of the input scales intensity; NaN means no contact. ``level``, in [0, 1], is the
        user's intensity. ``allowed`` is the strength that the board's ramp allows, see
        `Ramp.allowed_level`. If it is None, the pipeline uses its own ramp. ``observed`` contains
        the voltages that the board has measured since the last input.
        """
        regulator = self.regulator
        if regulator.impedance is not None:
            for measured in observed:
                regulator.impedance.observe(*measured)
        tactile = given if isinstance(given, Stimulus) else self._mapper.map(given, self.mode)
        pressure, time_ns = force_gate(given.force_n, self._profile.force), given.time_ns
        wanted, activation = pressure * (level * tactile.level), tactile.activation
        scan, strength = self._scans[self.mode], allowed
        if strength is None:
            strength = self.ramp.allowed_level(time_ns)
        if self._vibrated:
            gone = max(0, 0 if self._restarted else time_ns - self._time_ns) / self._limits.ramp_ns
            self._vibration, self._time_ns = min(wanted, self._vibration + gone), time_ns
            if not np.delete(activation, Afferent.PC, axis=0).any():
                # Only the vibrator stimulates. Its ramp has been applied above.
                wanted, strength = self._vibration, 1.0
        sequence = scan.schedule(tactile, wanted, pressure, strength, regulator.impedance)
        if allowed is None:
            ppb, lasting_ns = parts_per_billion(sequence.intensity), 1000 * sequence.period_us
            flowing_ppb = strength_ppb(self._limits, ppb, sequence.peak_pc)
            self.ramp.claim(ppb, flowing_ppb, time_ns)
            self.ramp.note(ppb, flowing_ppb, time_ns, lasting_ns)
        if regulator.ledger is not None:
            sequence = regulator.balance(sequence, regulator.ledger)
        restarted, self._restarted = self._restarted, False
        return Step(
            given, tactile, sequence, self.mode, level, restarted, scan.asked_us, tuple(observed),
            allowed,
        )  # fmt: skip

    def restart_at_zero(self) -> None:
        """Restart the ramp at zero intensity, and restart the schedule of pulses."""
        self.ramp.restart()
        self._vibration = 0.0
        for scan in self._scans.values():
            scan.restart()
        self._restarted = True

    def notes(self) -> list[str]:
        """Return notes for the user after the run."""
        slowed = sum(scan.net_slowed for scan in self._scans.values())
        emptied = sum(scan.net_emptied for scan in self._scans.values())
        notes = self.regulator.notes()
        if not slowed and not emptied:
            return notes
        return [
            *notes,
            f"to keep the net current of each electrode below {1000 * CEILING_NET_MA:g} µA, "
            f"{slowed} sequences were slowed and {emptied} were sent without pulses: to reach the "
            "requested rate, use --set balance, show fewer points or lower the intensity",
        ]

    def warm_up(self) -> None:
        """Process two inputs with a temporary copy of this pipeline. The first call of a function
        may import modules and allocate memory. In the loop, this work would delay a pulse."""
        twin = copy.copy(self)
        config = self._config
        twin._mapper = self._make_mapper(self._profile, config.light_on_dark, config.tone)
        twin.ramp = Ramp(self._limits.ramp_ns)
        # The copy and this pipeline share the objects that make slots: these objects have no state.
        twin._scans, twin._common = {}, replace(self._common, net=None)
        twin.regulator = Regulator()
        twin.change_mode(self.mode)
        profile, force_n = self._profile, self._profile.force.full_n
        image = np.full((profile.optics.sensor_rows, profile.optics.sensor_columns), 230, np.uint8)
        image[::2, : profile.optics.sensor_columns // 2] = 20
        active = np.ones((len(Afferent), len(profile.electrodes)), np.float32)
        active[[kind for kind in Afferent if kind not in self._bank.weights]] = 0
        for time_ns in (0, 10**9):
            twin.process(
                Stimulus(active, time_ns, force_n, 20_000)
                if self.mode is Mode.COLOR
                else Frame(image, time_ns, Pose(0, 0), force_n)
            )


def make_regulator(
    board: Board, profile: Profile, config: RunConfig, note: Callable[[str], None]
) -> Regulator:
    """Return the regulator for the settings ``hold`` and ``balance`` on an open board.

    ``note`` receives sentences that the user should read before the run. Raises BoardError if the
    board does not support a setting.
    """
    can = board.capabilities
    if can.time_to_zero_ms is None:
        note(
            "If the connection is lost, this board keeps repeating its last pattern: keep the "
            "power switch within reach."
        )
    impedance = ledger = recharge = None
    if config.hold is not None:
        if not can.measures or can.compliance_v is None:
            raise BoardError(
                "hold needs a board that measures the voltage of each slot: leave hold out"
            )
        timing = board.driver.timing
        if config.hold == "charge" and not (timing.own_widths and timing.width_us is None):
            raise BoardError(
                "hold=charge needs a board with a pulse width for each slot, but this board has "
                "one width for all slots: set hold=energy"
            )
        if config.hold == "energy":
            note(
                f"To keep energy constant, currents start at {RESERVED:.0%} of their requested "
                "values: raise the intensity if needed. If the skin gets wet, currents rise, at "
                "most to the requested values."
            )
        impedance = ImpedanceControl(profile, config.hold, can.compliance_v)
    if config.balance:
        if can.recharges:
            recharge = RechargeRules.of(profile, board.driver.timing)
        elif len(can.polarities) < 2:
            raise BoardError(
                "balance needs currents of both polarities, but this board makes only "
                f"{can.polarities[0]} currents: leave balance out"
            )
        else:
            note(
                "This board has no recharge phase, so the setting balance reverses the currents of "
                "complete scans. These scans stimulate the other class: SAI instead of RA, and RA "
                "instead of SAI."
            )
        ledger = ChargeBalance(can.electrodes)
        ledger.charge_pc[:] = board.net_charge_pc
    return Regulator(impedance, ledger, recharge)
