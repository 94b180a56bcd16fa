"""Tactile cue on the border electrodes that guides a finger back to the line of print."""

import numpy as np

from smarttouch.base.afferent import Mode
from smarttouch.base.errors import ScheduleError
from smarttouch.base.tactile_image import TactileImage
from smarttouch.imaging.sensor_registration import on_frame
from smarttouch.imaging.tactile_mapper import TactileMapper
from smarttouch.sources.source_contract import Frame

_ANGLES_DEG = np.arange(-10, 10.1, 2.5)  # candidate angles of text lines
_SAMPLES = 32  # rows and columns of the rotated ink image


class LineCueMapper(TactileMapper):
    """Tactile mapper that also shows whether the line of print is above or below the finger.

    If the line is above, all electrodes of the first row are active. If the line is below, all of
    the last row are active. Nothing is added while the array's middle is between the baseline and
    the top of the lowercase letters. Raises ScheduleError for arrays of fewer than three rows.
    """

    line: tuple[float, float, float] | None = None
    """Line nearest to the array's middle in the latest frame, or None: baseline (mm below the
    middle), x-height (mm) and angle to the array's rows (degrees clockwise)."""

    def _prepare(self, shape: tuple[int, int]) -> None:
        super()._prepare(shape)
        profile = self._profile
        electrodes, optics, driven = profile.electrodes, profile.optics, profile.driven
        y_mm = electrodes.position_mm[driven, 1].round(3)
        if len(rows := np.unique(y_mm)) < 3:
            raise ScheduleError(f"line_cue needs three rows: {profile.name} has {len(rows)}")
        self._border = driven[y_mm == rows[0]], driven[y_mm == rows[-1]]
        width_mm, height_mm = (side / optics.magnification for side in electrodes.extent_mm)
        middles = (np.arange(_SAMPLES) + 0.5) / _SAMPLES - 0.5
        place = middles * width_mm + 1j * middles[:, None] * height_mm
        turned = place * np.exp(1j * np.radians(_ANGLES_DEG))[:, None, None]
        places = on_frame(turned.real, turned.imag, optics)
        height, width = self._registration.working_shape
        column, row = (np.nan_to_num(side).clip(0, 1 - 1e-9) for side in places)
        self._pixel = (row * height).astype(np.intp) * width + (column * width).astype(np.intp)
        self._step_mm = height_mm / _SAMPLES
        self._x_rows = 0.4 * _SAMPLES  # running mean of the x-height, in rows

    def map(self, frame: Frame, mode: Mode) -> TactileImage:
        tactile = super().map(frame, mode)
        self._find_line()
        if self.line is not None:
            baseline_mm, x_mm, _ = self.line
            # Lowercase letters reach from the baseline up to the x-height.
            if abs(off_mm := baseline_mm - x_mm / 2) > x_mm / 2:
                tactile.activation[mode.afferents[0], self._border[off_mm > 0]] = 1
        return tactile

    def _find_line(self) -> None:
        """Find the line nearest to the array's middle. Rotate the ink to the angle at which
        adjacent rows differ most, then search for dark rows."""
        turned = self._inked.reshape(-1).take(self._pixel).mean(axis=2, dtype=np.float32) / 255
        steepest = int(np.square(np.diff(turned)).sum(axis=1).argmax())
        angle_deg = float(_ANGLES_DEG[steepest])
        smooth = np.convolve(turned[steepest], (1 / 3, 1 / 3, 1 / 3), "same")
        dark = smooth > max(0.05, 0.5 * np.partition(smooth, -4)[-4])
        lines: list[tuple[float, float, float]] = []
        edges = np.flatnonzero(np.diff(dark, prepend=False, append=False)).tolist()
        for first, end in zip(edges[::2], edges[1::2], strict=True):
            if first > 0 and _SAMPLES > end > first + _SAMPLES / 5:
                self._x_rows += 0.1 * (end - first - self._x_rows)
            # If the lower edge cuts a line off, estimate its baseline by the x-height.
            base = end if end < _SAMPLES else first + max(self._x_rows, end - first)
            if 1 < end - first < _SAMPLES:
                baseline_mm = (base - _SAMPLES / 2) * self._step_mm
                lines.append((baseline_mm, self._x_rows * self._step_mm, angle_deg))
        self.line = min(lines, key=lambda line: abs(line[0] - line[1] / 2), default=None)
