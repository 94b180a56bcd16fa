"""Mechanical vibrators as a board, alone or beside electrodes.

Electric current cannot reach the Pacinian corpuscles alone, as they lie deepest; vibration
at their own frequency can, and a sparse matrix of vibrators is enough (paper, Section V).

Beside electrodes it is the paper's hybrid method (Section V): current for RA and SAI,
vibration for PC.
"""

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.electrodes import ElectrodeArray
from smarttouch.base.errors import BoardError, BoardRestartedError, require_within
from smarttouch.base.url_options import read_options
from smarttouch.boards.board import Board, BoardReport, Capabilities
from smarttouch.boards.reports import Impedance
from smarttouch.boards.vibrators.vibrator_output import (
    PC_HZ,
    SoundOutput,
    Waveform,
    WavOutput,
    vibrator_of,
)
from smarttouch.profile.device import Output
from smarttouch.stimulation.pulse_rates import ScanTiming
from smarttouch.stimulation.safety_gate import NanosecondClock, SafetyLimits
from smarttouch.stimulation.scan_sequence import ScanSequence

WAV_HZ, AUDIO_HZ = 8000, 48_000  # default sample rates
FEWEST_SAMPLES = 4  # fewest samples in a cycle of the carrier
CARRIERS_HZ = (60.0, 800.0)  # range of carriers that PC responds to (paper, Section III-C)
MOST_VIBRATORS = 64
RATES_HZ = (1000, 192_000)
_EXAMPLE = "as in vibrators:out.wav?grid=2x2&hz=250&rate=8000"


@dataclass(frozen=True)
class _Options:
    """Options after a question mark."""

    grid: tuple[int, int] = (2, 2)
    hz: float = PC_HZ
    rate: int | None = None


class VibratorBoard(Board):
    """Board of vibrators, driven by the activations in sequences, without current.

    ``vibrators:FILE.wav`` writes what the vibrators are driven with, ``vibrators:audio`` and
    ``vibrators:audio:DEVICE`` play it. Options come after a question mark: ``grid=ROWSxCOLUMNS`` of
    the vibrators under the array (2x2), ``hz`` of the carrier (250), ``rate`` of the samples (8000,
    on a sound device 48000). A vibrator shakes as strongly as the strongest of the sites that are
    nearest to it; without ``electrodes`` all vibrators move alike. Amplitude 1 is full scale.
    """

    shares_budget = False

    def __init__(
        self,
        rest: str,
        limits: SafetyLimits,
        output: Output | None = None,
        electrodes: ElectrodeArray | None = None,
        **_: Any,
    ) -> None:
        super().__init__(limits)
        target, given = read_options(_Options, rest, BoardError)
        options = _Options(**given)
        rows, columns = options.grid
        require_within(BoardError, "grid", rows * columns, 1, MOST_VIBRATORS, "vibrators: the grid")
        require_within(BoardError, "hz", options.hz, *CARRIERS_HZ, f"vibrators: hz={options.hz:g}")
        # The name of a sound device, empty for the default one; None if it is a file.
        name, _colon, played = target.partition(":")
        device = played if name == "audio" else None
        self._sample_hz = options.rate or (WAV_HZ if device is None else AUDIO_HZ)
        words = f"vibrators: rate={self._sample_hz}"
        require_within(BoardError, "rate", self._sample_hz, *RATES_HZ, words)
        self._carrier_hz = options.hz
        if not self._sample_hz >= FEWEST_SAMPLES * self._carrier_hz:
            raise BoardError(
                f"vibrators: {self._sample_hz} samples a second are too few for "
                f"{self._carrier_hz:g} Hz: give rate={FEWEST_SAMPLES * self._carrier_hz:g} or more"
            )
        if device is None and not target.endswith(".wav"):
            raise BoardError(
                f"vibrators: needs a file that ends in .wav, or audio, not {target!r}: {_EXAMPLE}"
            )
        self._vibrators = rows * columns
        self._vibrator_of = None if electrodes is None else vibrator_of(electrodes, rows, columns)
        self._shaking: WavOutput | SoundOutput
        self._shaking = WavOutput(target) if device is None else SoundOutput(device)
        self._shaking.notes = self.notes
        self._number = 0
        self.capabilities: Capabilities = Capabilities(
            electrodes=limits.electrodes,
            output="vibration",
            max_current_ma=0.0,
            max_slots=0xFFFF,
            time_to_zero_ms=self._shaking.time_to_zero_ms,
            firmware=f"{self._vibrators} vibrators at {self._carrier_hz:g} Hz",
            clock="host",
            vibrates=True,
        )

    def silence(self) -> None:
        """Vibrate no more until the next sequence."""
        self._shaking.silence()

    def share_notes(self, notes: list[str]) -> None:
        """Add warnings to another list from now on."""
        self.notes = self._shaking.notes = notes

    def _time(self) -> None:
        """Return None: time is what sequences state, as vibrators carry no current."""

    def _open(self) -> None:
        self._number = 0
        waveform = Waveform(self._vibrators, self._carrier_hz, self._sample_hz)
        self._shaking.open(waveform, self._sample_hz)

    def _send(self, sequence: ScanSequence, times: int) -> int:
        amplitude = self._amplitude(sequence.vibration)
        self._shaking.shake(amplitude, sequence.time_ns, 1000 * sequence.period_us, times)
        self._number += 1
        self.acknowledged += 1
        return self._number

    def _amplitude(self, vibration: NDArray[np.float32] | None) -> NDArray[np.float32]:
        """Return the amplitude of each vibrator, (C,)."""
        amplitude = np.zeros(self._vibrators, np.float32)
        if vibration is None:
            return amplitude
        if self._vibrator_of is None:
            amplitude[:] = vibration.max()
        else:
            np.maximum.at(amplitude, self._vibrator_of, vibration)
        return amplitude

    def drain(self, timeout_s: float = 1.0) -> None:
        self._shaking.drain(timeout_s)

    def report(self) -> BoardReport:
        return BoardReport(self._number, 0, 0, 0, 0.0, 0.0, 0.0, by="host")

    def _stop(self) -> None:
        self._shaking.silence()

    def _close(self) -> None:
        self._shaking.close()


def make_vibrators(url: str, limits: SafetyLimits, electrodes: ElectrodeArray) -> VibratorBoard:
    """Return the vibrators of a URL, with or without ``vibrators:`` before it."""
    return VibratorBoard(url.removeprefix("vibrators:"), limits, electrodes=electrodes)


def _electric(name: str) -> Any:
    """Return a property that forwards an attribute of the electrode board."""
    return property(
        lambda board: getattr(board.electric, name),
        lambda board, value: setattr(board.electric, name, value),
    )


def _vibrating() -> Any:
    return property(lambda board: replace(board.electric.capabilities, vibrates=True))


class HybridBoard(Board):
    """Board that sends slots to an electrode board and vibration to vibrators. The electrode board
    answers queries; a fault of either puts both at zero."""

    acknowledged: int = _electric("acknowledged")
    refused: int = _electric("refused")
    replaced: int = _electric("replaced")
    dropped_late: int = _electric("dropped_late")
    force_n: float | None = _electric("force_n")
    lifted: bool = _electric("lifted")
    ua_per_count: float | None = _electric("ua_per_count")
    timing: ScanTiming = _electric("timing")
    simulated_time: ClassVar[bool] = _electric("simulated_time")
    on_a_finger: ClassVar[bool] = _electric("on_a_finger")
    drives_in_send = False
    capabilities: Capabilities = _vibrating()
    device: str | None = _electric("device")
    shares_budget = False  # the electrode board has its own

    def __init__(self, electric: Board, shaking: VibratorBoard) -> None:
        self.electric: Board = electric
        self.shaking: VibratorBoard = shaking
        super().__init__(electric._gate.limits)
        # One list for all three: each note appears once.
        self.notes: list[str] = electric.notes
        self.notes += shaking.notes
        shaking.share_notes(self.notes)

    def _time(self) -> NanosecondClock | None:
        return self.electric._time()

    def _open(self) -> None:
        self.electric.open()
        try:
            self.shaking.open()
        except BaseException:
            self.electric.close()
            raise

    def _send(self, sequence: ScanSequence, times: int) -> int:
        try:
            number = self.electric.send(replace(sequence, vibration=None), times, self._due_ns)
            self.shaking.send(_only_vibration(sequence), times)
        except BoardRestartedError:
            self.shaking.silence()
            self._gate.restart()
            raise
        except BaseException:
            self._stop()
            raise
        return number

    @property
    def refused_packets(self) -> int:
        return self.electric.refused_packets

    def take_volts(self) -> list[tuple[ScanSequence, NDArray[np.float32]]]:
        return self.electric.take_volts()

    def _measure(self) -> Impedance:
        self.shaking.silence()
        return self.electric.measure()

    def drain(self, timeout_s: float = 1.0) -> None:
        self.electric.drain(timeout_s)

    def report(self) -> BoardReport:
        return self.electric.report()

    def _halt(self) -> None:
        try:
            self.electric.halt()
        finally:
            self.shaking.halt()

    def _stop(self) -> None:
        # Current first: writing a file of vibrations may block.
        try:
            self.electric.stop()
        finally:
            self.shaking.stop()

    def _close(self) -> None:
        try:
            self.electric.close()
        finally:
            self.shaking.close()


def _only_vibration(sequence: ScanSequence) -> ScanSequence:
    return replace(
        sequence, current_ua=sequence.current_ua[:0], width_us=sequence.width_us[:0],
        discharge_us=sequence.discharge_us[:0], site=sequence.site[:0], recharge_ua=None,
        recharge_us=0,
    )  # fmt: skip
