"""Board of electrodes and vibrators: current for RA and SAI, vibration for PC.

The paper's hybrid method (Section V).
"""

from dataclasses import replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from smarttouch.boards.board import Board, BoardReport, Capabilities
from smarttouch.boards.impedance import Impedance
from smarttouch.boards.vibrators import VibratorBoard
from smarttouch.errors import BoardRestartedError
from smarttouch.stimulation.safety import Now
from smarttouch.stimulation.sequence import ScanSequence
from smarttouch.stimulation.timing import ScanTiming


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
        self.electric, self.shaking = electric, shaking
        super().__init__(electric._gate.limits)
        # One list for all three: each note appears once.
        self.notes = electric.notes
        self.notes += shaking.notes
        shaking.share_notes(self.notes)

    def _time(self) -> Now | None:
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
        sequence,
        current_ua=sequence.current_ua[:0],
        width_us=sequence.width_us[:0],
        discharge_us=sequence.discharge_us[:0],
        site=sequence.site[:0],
        recharge_ua=None,
        recharge_us=0,
    )
