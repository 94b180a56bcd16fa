"""Mechanical vibrators as a board: a WAV file or a sound device with one channel for each.

Electric current cannot reach the Pacinian corpuscles alone, as they lie deepest; vibration
at their own frequency can, and a sparse matrix of vibrators is enough (paper, Section V).
"""

from typing import Any
from urllib.parse import parse_qsl

import numpy as np
from numpy.typing import NDArray

from smarttouch.boards.board import Board, BoardReport, Capabilities
from smarttouch.boards.shaking import AudioShaking, Shaking, WavShaking
from smarttouch.boards.waveform import PC_HZ, Waveform, vibrator_of
from smarttouch.electrodes import ElectrodeArray
from smarttouch.errors import BoardError
from smarttouch.profile.device import Output
from smarttouch.stimulation.safety import SafetyLimits
from smarttouch.stimulation.sequence import ScanSequence

WAV_HZ, AUDIO_HZ = 8000, 48_000  # default sample rates
FEWEST_SAMPLES = 4  # fewest samples in a cycle of the carrier
CARRIERS_HZ = (60.0, 800.0)  # range of carriers that PC responds to (paper, Section III-C)
MOST_VIBRATORS = 64
_EXAMPLE = "as in vibrators:out.wav?grid=2x2&hz=250&rate=8000"


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
        target, _mark, query = rest.partition("?")
        options = _read_options(query)
        rows, columns = options["grid"]
        device = _audio_device(target)
        self._sample_hz = int(options.get("rate", WAV_HZ if device is None else AUDIO_HZ))
        self._carrier_hz = options.get("hz", PC_HZ)
        if not self._sample_hz >= FEWEST_SAMPLES * self._carrier_hz:
            raise BoardError(
                f"vibrators: {self._sample_hz} samples a second are too few for "
                f"{self._carrier_hz:g} Hz: give rate={FEWEST_SAMPLES * self._carrier_hz:g} or more",
                about="rate",
            )
        if device is None and not target.endswith(".wav"):
            raise BoardError(
                f"vibrators: needs a file that ends in .wav, or audio, not {target!r}: {_EXAMPLE}",
                about="board",
            )
        self._vibrators = rows * columns
        self._vibrator_of = None if electrodes is None else vibrator_of(electrodes, rows, columns)
        self._shaking: Shaking = WavShaking(target) if device is None else AudioShaking(device)
        self._shaking.notes = self.notes
        self._number = 0
        self.capabilities = Capabilities(
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


def _audio_device(target: str) -> str | None:
    """Return the name of a sound device, empty for the default one; None if it is a file."""
    name, _, device = target.partition(":")
    return device if name == "audio" else None


def _read_options(query: str) -> dict[str, Any]:
    """Return the options of a query, and always the grid."""
    read: dict[str, Any] = {"grid": (2, 2)}
    try:
        given = parse_qsl(query, strict_parsing=True) if query else []
    except ValueError:
        raise BoardError(
            f"vibrators: cannot read the options {query!r}: {_EXAMPLE}", about="option"
        ) from None
    for name, text in given:
        if name == "grid":
            read[name] = _grid(text)
        elif name == "hz":
            read[name] = _number(name, text, *CARRIERS_HZ)
        elif name == "rate":
            read[name] = _number(name, text, 1000, 192_000)
        else:
            raise BoardError(
                f"vibrators: knows the options grid, hz and rate, not {name}", about="option"
            )
    return read


def _grid(text: str) -> tuple[int, int]:
    rows, _, columns = text.partition("x")
    if not (rows.isdecimal() and columns.isdecimal() and int(rows) * int(columns) > 0):
        raise BoardError(
            f"vibrators: grid={text} is no grid: give rows x columns, {_EXAMPLE}", about="grid"
        )
    if int(rows) * int(columns) > MOST_VIBRATORS:
        raise BoardError(
            f"vibrators: grid={text} has {int(rows) * int(columns)} vibrators: at most "
            f"{MOST_VIBRATORS} are possible",
            about="grid",
        )
    return int(rows), int(columns)


def _number(name: str, text: str, least: float, most: float) -> float:
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not least <= value <= most:
        raise BoardError(f"vibrators: {name}={text} must be from {least:g} to {most:g}", about=name)
    return value
