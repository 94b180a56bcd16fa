"""Check of recordings: process the recorded inputs again, and compare the sequences exactly."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.errors import RecordingError
from smarttouch.kernels.bank import KernelBank, load_bank
from smarttouch.profile import Profile
from smarttouch.running.pipeline import Pipeline, Regulator
from smarttouch.running.recording_format import RecordedStep
from smarttouch.running.recording_reader import RecordedRun
from smarttouch.stimulation.charge_balance import ChargeBalance, RechargeRules
from smarttouch.stimulation.impedance_control import ImpedanceControl
from smarttouch.stimulation.scan_sequence import ScanSequence

KEPT = 20  # largest number of listed differences

_COMPARED = (
    "slots", "period_us", "intensity", "time_ns", "recharge_us", "vibration", "recharge_ua",
    "site", "width_us", "discharge_us", "current_ua",
)  # fmt: skip
"""Compared quantities of a sequence."""


@dataclass
class CheckReport:
    """Result of a check, with the numbers of compared items and the first `KEPT` differences.

    ``different`` counts all differences. ``left_out`` describes what could not be compared.
    """

    frames: int = 0
    sequences: int = 0
    slots: int = 0
    differences: list[str] = field(default_factory=list)
    different: int = 0
    left_out: str = ""

    @property
    def exact(self) -> bool:
        """Whether all compared values are identical."""
        return not self.different

    def describe(self) -> str:
        """Return the result as text, with one line for each listed difference."""
        head = f"{self.sequences:,} sequences, {self.slots:,} slots: "
        head += "identical" if self.exact else f"{self.different:,} differences"
        lines = [head + (f" ({self.left_out})" if self.left_out else "")]
        lines += self.differences
        if self.different > len(self.differences):
            lines.append(f"and {self.different - len(self.differences):,} more")
        return "\n".join(lines)


def check_recording(
    path: Path | str, *, bank: KernelBank | None = None, profile: Profile | None = None
) -> CheckReport:
    """Process the recorded frames and stimuli again, and compare the new and recorded sequences.

    By default this uses the recorded profile, with kernels of this version. Raises RecordingError
    if the recording cannot be read, has no sequences, or lacks settings.
    """
    recording = RecordedRun(path)
    profile = recording.profile if profile is None else profile
    pipeline = rebuild_pipeline(recording, profile, load_bank(profile) if bank is None else bank)
    report, image = CheckReport(), None
    for recorded in recording.steps():
        if recorded.index != report.sequences:
            # Sequences depend on earlier steps, so nothing after a gap can be compared.
            gap_s = recorded.step.input.time_ns / 1e9
            report.left_out = f"some steps are missing: from {gap_s:.1f} s on, nothing was compared"
            break
        if profile.limits.ramp_s != recording.profile.limits.ramp_s:
            recorded = replace(
                recorded, sent=replace(recorded.sent, step=replace(recorded.step, allowed=None))
            )
        was, now = recorded.step.sequence, _again(recorded, pipeline)
        before, image = image, recorded.step.input.image
        report.frames += image is not None and image is not before
        report.sequences += 1
        report.slots += was.slots
        for difference in _differences(recorded, was, now):
            report.different += 1
            if len(report.differences) < KEPT:
                report.differences.append(difference)
    if not report.sequences:
        raise RecordingError(f"{path} has no sequences: there is nothing to check")
    if not recording.whole:
        report.left_out = report.left_out or "the recording is cut or damaged"
    return report


def assert_replays(path: Path | str, **same: Any) -> None:
    """Raise AssertionError if a recorded sequence is not reproduced; see `check_recording`."""
    __tracebackhide__ = True
    report = check_recording(path, **same)
    if not report.exact:
        raise AssertionError(f"{path}: {report.describe()}")


def rebuild_pipeline(recording: RecordedRun, profile: Profile, bank: KernelBank) -> Pipeline:
    """Return a pipeline in the state that it had at the start of the recorded run."""
    run = recording.run
    pipeline = Pipeline(profile, bank, run, run.timing, vibrated=run.vibrated, in_sums=run.in_sums)
    impedance = ledger = recharge = None
    if run.hold is not None:
        if run.compliance_v is None:
            raise RecordingError(
                f"the settings in {recording.path} are incomplete: the setting 'hold' needs "
                "compliance_v, which is missing"
            )
        impedance = ImpedanceControl(profile, run.hold, run.compliance_v)
    if run.balance:
        ledger = ChargeBalance(len(profile.electrodes))
        if run.carried_pc:
            if len(run.carried_pc) != len(ledger.charge_pc):
                raise RecordingError(
                    f"the settings in {recording.path} contain the charge of {len(run.carried_pc)} "
                    f"electrodes, but the profile has {len(ledger.charge_pc)}: check with the "
                    "recorded profile"
                )
            ledger.charge_pc[:] = run.carried_pc
        if run.recharge:
            recharge = RechargeRules.of(profile, run.timing)
    pipeline.regulator = Regulator(impedance, ledger, recharge)
    return pipeline


def _again(recorded: RecordedStep, pipeline: Pipeline) -> ScanSequence:
    """Return the sequence that this version computes from a recorded step."""
    step = recorded.step
    if step.mode is not pipeline.mode:
        pipeline.change_mode(step.mode)
    if step.restarted:
        pipeline.restart_at_zero()
    again = pipeline.process(step.input, step.level, step.allowed, step.observed).sequence
    if recorded.sent.number is None:
        pipeline.regulator.take_back(again)
    return again


def _differences(recorded: RecordedStep, was: ScanSequence, now: ScanSequence) -> Iterator[str]:
    """Yield one sentence for each differing number."""
    seen = recorded.step.input
    for name in _COMPARED:
        old, new = (_values(sequence, name) for sequence in (was, now))
        if old.shape != new.shape:
            # The numbers of slots differ. All later values then differ, too: do not list them.
            return
        for index in np.argwhere(old != new).tolist():
            one, other = (values[tuple(index)].item() for values in (old, new))
            yield (
                f"frame {seen.number} at {seen.time_ns / 1e9:.3f} s: {name}{index or ''} "
                f"{one!r} recorded, {other!r} now"
            )


def _values(sequence: ScanSequence, name: str) -> NDArray[Any]:
    value = getattr(sequence, name)
    return np.zeros(sequence.electrodes) if value is None else np.asarray(value)
