"""Moving picture of a run: page, electrodes, afferents and their sum, as an animated GIF."""

from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageColor, ImageDraw, ImageFont

from smarttouch.base.afferent import CLASS_COLORS, Afferent
from smarttouch.base.array_picture import ElectrodePicture, current_colors, disc_radius_mm
from smarttouch.base.errors import SmartTouchError
from smarttouch.base.files import write_bytes
from smarttouch.physiology.finger import Finger
from smarttouch.physiology.response import in_color
from smarttouch.running.delivered import FIELD_MM, SpikeMap
from smarttouch.sources.source_contract import Pose
from smarttouch.views.delivered_drawing import PageDrawing, scale_bar

FRAME_S = 0.1  # time of a frame, and over which spikes are counted
MOST_FRAMES = 600
_SMOOTH = 2  # pixels drawn for each pixel of the picture, along each axis
_SKIN_PX = 304  # longer side of the panels of the skin
_PAGE_PX = (500, 130)  # room for the page, and again for the sum
_GAP, _TITLE, _FOOT = 18, 34, 42
_ABOVE = 1.45  # height of the page's panel, relative to what the finger passes over
_SKIN_MM = 1.5  # skin shown around the array
_INK, _QUIET, _LINE = "#16202a", "#5a6672", "#c3cbd2"
_SKIN, _SKIN_EDGE = (214, 158, 122, 70), (160, 104, 70, 255)
_OWN = ("#ffffff", _INK, _QUIET, _LINE)
_FELT_AS = {Afferent.RA: "flutter", Afferent.SAI: "pressure", Afferent.PC: "vibration"}
Box = tuple[int, int, int, int]


class MovingPicture(PageDrawing):
    """Draws a run as a moving picture in real time, all panels to scale.

    Four panels: the page with the part that the finger touches; the currents of the electrodes in
    one slot of the scan at that instant; the receptors whose afferents fired in the last `FRAME_S`,
    larger with spikes; and all spikes so far where the receptors were on the page, for each pass.
    """

    def save(self, path: Path) -> None:
        """Write the picture; raises where there is no finger, or nothing was delivered."""
        if self._finger is None or not self.spikes:
            raise SmartTouchError(
                f"there is nothing to draw in {path}: no pulse was delivered, or no finger can be "
                "simulated on this array; name a .png for what was delivered"
            )
        sheet = _Sheet(self, self._finger)
        times_s = list(self.time_s.values())
        count = int((times_s[-1] - times_s[0]) / FRAME_S) + 1
        if count > MOST_FRAMES:
            raise SmartTouchError(
                f"a moving picture of {count * FRAME_S:.0f} s is longer than "
                f"{MOST_FRAMES * FRAME_S:.0f}: draw fewer seconds, or name a .png"
            )
        frames = [sheet.frame(*moment) for moment in self._moments(times_s[0], count)]
        # One palette for all: what stands still is then the same in each, and is stored once.
        palette = sheet.palette(frames[-1])
        few = [each.quantize(palette=palette, dither=Image.Dither.NONE) for each in frames]
        content = BytesIO()
        few[0].save(
            content, format="GIF", save_all=True, append_images=few[1:],
            duration=round(1000 * FRAME_S), loop=0, optimize=True,
        )  # fmt: skip
        write_bytes(path, content.getvalue())

    def _moments(
        self, first_s: float, count: int
    ) -> Iterator[tuple[float, Pose, NDArray[np.int16], NDArray[np.intp], list[int]]]:
        """Yield time, pose, currents of a slot (E,) µA, spikes of each afferent (A,), and numbers
        of the sequences since the moment before."""
        numbers, current_ua = self.slots
        assert self._finger is not None
        for index in range(count):
            begin_s = first_s + index * FRAME_S
            passed = [
                number
                for number, time_s in self.time_s.items()
                if begin_s <= time_s < begin_s + FRAME_S
            ]
            spikes = np.zeros(len(self._finger.classes), np.intp)
            for number in passed:
                spikes += self.spikes.get(number, 0)
            slots = current_ua[numbers == passed[-1]] if passed else current_ua[:0]
            # Moments are whole periods apart: another slot each time, or all would be the first.
            slot = slots[index % len(slots)] if len(slots) else np.zeros_like(current_ua[0])
            pose = self.poses[passed[-1]] if passed else Pose(-1e6, -1e6)
            yield begin_s - first_s, pose, slot, spikes, passed


class _Sheet:
    """Sheet with the four panels of `MovingPicture`."""

    def __init__(self, run: MovingPicture, finger: Finger) -> None:
        self._run, self._finger = run, finger
        self._electrodes = finger.profile.electrodes
        self._full_ma = float(finger.profile.full_ma.max())
        self._font = ImageFont.load_default(13 * _SMOOTH)
        self._small = ImageFont.load_default(12 * _SMOOTH)
        self._page, self._corner_mm, size_mm = self._swept()
        scale = min(px / mm for px, mm in zip(_PAGE_PX, size_mm, strict=True))
        self._page_scale = scale
        wide, high = (round(each * scale) for each in size_mm)
        skin_mm = [each + 2 * _SKIN_MM for each in self._electrodes.extent_mm]
        self._skin_scale = _SKIN_PX / max(skin_mm)
        skin = [round(each * self._skin_scale) for each in skin_mm]
        self._wide = max(wide, 360)
        left, top = 2 * _GAP + self._wide, _TITLE
        self._boxes: list[Box] = [
            (_GAP, top, _GAP + wide, top + high),
            (left, top, left + skin[0], top + skin[1]),
            (left + skin[0] + _GAP, top, left + 2 * skin[0] + _GAP, top + skin[1]),
            (_GAP, top + high + _TITLE, _GAP + wide, top + 2 * high + _TITLE),
        ]
        self.size = (self._boxes[2][2] + _GAP, max(self._boxes[3][3], self._boxes[1][3]) + _FOOT)
        self._picture = ElectrodePicture(self._electrodes, self._skin_scale * _SMOOTH)
        magnification = finger.profile.optics.magnification
        self._magnification = magnification
        self._map, whole = (
            SpikeMap(
                finger,
                lambda places, pose: run.placed(places / magnification, pose) - self._corner_mm,
                (high, wide),
                1 / scale,
                FIELD_MM / magnification,
            )
            for _ in range(2)
        )
        for number, counts in run.spikes.items():
            whole.add(run.poses[number], counts)
        self._dark = whole.darkest()

    def _swept(self) -> tuple[NDArray[np.uint8], tuple[float, float], tuple[float, float]]:
        """Return the part of the page that was touched, its corner and its size in mm."""
        _, corner_mm, size_mm, draw = self._run.under()
        if draw is None:
            raise SmartTouchError(
                "a moving picture needs a page or images: this source has none; name a .png"
            )
        optics = self._finger.profile.optics
        reach = np.array([optics.field_width_mm, _ABOVE * optics.field_height_mm]) / 2
        poses = np.array([(each.x_mm, each.y_mm) for each in self._run.poses.values()])
        first = np.maximum(poses.min(axis=0) - reach, corner_mm)
        last = np.minimum(poses.max(axis=0) + reach, np.add(corner_mm, size_mm))
        first, last = np.minimum(first, last - 1), np.maximum(last, first + 1)
        grey = draw((1, 1), 1.0)
        scale = grey.shape[1] / size_mm[0]
        left, top = np.maximum(0, (first - corner_mm) * scale).astype(int)
        right, bottom = ((last - corner_mm) * scale).astype(int)
        size = last - first
        corner = (float(first[0]), float(first[1]))
        return grey[top:bottom, left:right], corner, (float(size[0]), float(size[1]))

    def frame(
        self,
        time_s: float,
        pose: Pose,
        slot_ua: NDArray[np.int16],
        spikes: NDArray[np.intp],
        passed: list[int],
    ) -> Image.Image:
        """Return the sheet at a moment."""
        for number in passed:
            if number in self._run.spikes:
                self._map.add(self._run.poses[number], self._run.spikes[number])
        sheet = Image.new("RGB", (self.size[0] * _SMOOTH, self.size[1] * _SMOOTH), "white")
        self._draw_page(sheet, pose)
        self._draw_current(sheet, slot_ua)
        self._draw_spikes(sheet, spikes)
        self._paste(sheet, 3, Image.fromarray(self._map.image(self._dark)))
        draw = ImageDraw.Draw(sheet)
        titles = (
            ("The page, and the finger on it", self._page_scale),
            ("Electrodes, at this instant", self._skin_scale),
            (f"Afferents that fired in {FRAME_S:g} s", self._skin_scale),
            ("Sum of all spikes, over the sweep", self._page_scale),
        )
        for box, (title, scale) in zip(self._boxes, titles, strict=True):
            left, top, right, bottom = (each * _SMOOTH for each in box)
            draw.text((left, top - 8), title, _INK, self._font, anchor="ls")
            draw.rectangle((left, top, right, bottom), outline=_LINE, width=_SMOOTH)
            scale_bar(draw, self._small, (right, top - 28), scale * _SMOOTH, _INK, right - left)
        self._draw_legends(draw, time_s)
        return sheet.resize(self.size, Image.Resampling.LANCZOS)

    def _paste(self, sheet: Image.Image, panel: int, picture: Image.Image) -> None:
        left, top, right, bottom = (each * _SMOOTH for each in self._boxes[panel])
        sheet.paste(picture.resize((right - left, bottom - top)), (left, top))

    def _draw_page(self, sheet: Image.Image, pose: Pose) -> None:
        """Draw the page, the sensor's field, and around it the finger that touches it."""
        left, top, right, bottom = (each * _SMOOTH for each in self._boxes[0])
        page = Image.fromarray(self._page).convert("RGB").resize((right - left, bottom - top))
        draw, scale = ImageDraw.Draw(page, "RGBA"), self._page_scale * _SMOOTH
        x, y = ((np.array([pose.x_mm, pose.y_mm]) - self._corner_mm) * scale).tolist()
        half = np.array(self._electrodes.extent_mm) / 2
        wide, high = ((half + _SKIN_MM) / self._magnification * scale).tolist()
        finger = (x - wide, y - 1.1 * high, x + wide, y + 9 * high)
        draw.rounded_rectangle(finger, wide, _SKIN, _SKIN_EDGE, 2 * _SMOOTH)
        seen = [(half[at] / self._magnification) * scale for at in (0, 1)]
        corners = _turned(seen, pose.angle_rad) + np.array([x, y])
        draw.polygon([tuple(each) for each in corners.tolist()], outline=_INK, width=2 * _SMOOTH)
        sheet.paste(page, (left, top))

    def _draw_current(self, sheet: Image.Image, slot_ua: NDArray[np.int16]) -> None:
        left, top, right, bottom = (each * _SMOOTH for each in self._boxes[1])
        picture = Image.fromarray(self._picture.raster(current_colors(slot_ua, self._full_ma)))
        place = (left + right - picture.width) // 2, (top + bottom - picture.height) // 2
        sheet.paste(picture, place)

    def _draw_spikes(self, sheet: Image.Image, spikes: NDArray[np.intp]) -> None:
        """Draw receptors, silent ones as points, among the outlines of the electrodes."""
        box, scale = self._boxes[2], self._skin_scale * _SMOOTH
        left, top, right, bottom = (each * _SMOOTH for each in box)
        panel = Image.new("RGB", (right - left, bottom - top), "white")
        draw = ImageDraw.Draw(panel)
        middle = np.array(panel.size) / 2

        def disc(place_mm: NDArray[np.float64], radius_mm: float, **style: Any) -> None:
            (x, y), radius = place_mm * scale + middle, radius_mm * scale
            draw.ellipse((x - radius, y - radius, x + radius, y + radius), **style)

        for place in self._electrodes.position_mm:
            disc(place, disc_radius_mm(self._electrodes), outline=_LINE, width=_SMOOTH)
        for at in np.argsort(spikes, kind="stable"):
            fired = int(spikes[at])
            color = CLASS_COLORS[Afferent(self._finger.classes[at])] if fired else _LINE
            radius_mm = 0.09 + 0.05 * min(4, fired) if fired else 0.04
            disc(self._finger.receptor_mm[at], radius_mm, fill=color)
        sheet.paste(panel, (left, top))

    def _draw_legends(self, draw: ImageDraw.ImageDraw, time_s: float) -> None:
        """Write what colors mean: a bar for currents, a name for each class; and the time."""
        left, _, right, bottom = (each * _SMOOTH for each in self._boxes[1])
        y, bar = bottom + 18 * _SMOOTH, 9 * _SMOOTH
        begin, wide = left + round(0.3 * (right - left)), round(0.4 * (right - left))
        for x, color in enumerate(self._ramp(wide)):
            draw.line((begin + x, y - bar // 2, begin + x, y + bar // 2), tuple(color.tolist()))
        gap, most = 6 * _SMOOTH, f"{self._full_ma:.1f} mA"
        draw.text((begin - gap, y), f"anodic -{most}", _QUIET, self._small, anchor="rm")
        draw.text((begin + wide + gap, y), f"+{most} cathodic", _QUIET, self._small, anchor="lm")
        x = self._boxes[2][0] * _SMOOTH + gap
        for afferent, color in CLASS_COLORS.items():
            draw.ellipse((x, y - bar // 2, x + bar, y + bar // 2), fill=color)
            words = f"{afferent.name} {_FELT_AS[afferent]}"
            draw.text((x + 13 * _SMOOTH, y), words, _QUIET, self._small, anchor="lm")
            x += round(draw.textlength(words, self._small)) + 30 * _SMOOTH
        optics = self._finger.profile.optics
        field_mm, larger = optics.field_width_mm, self._magnification
        for row, words in enumerate((
            f"{time_s:.1f} s    The sensor sees {field_mm:g} mm; "
            f"the skin gets it {larger:g} times larger.",
            "Simulated; the sum is drawn with the finger's exact path.",
        )):  # fmt: skip
            below = (self.size[1] - 33 + 17 * row) * _SMOOTH
            draw.text((_GAP * _SMOOTH, below), words, _QUIET, self._small)

    def _ramp(self, wide: int) -> NDArray[np.uint8]:
        """Return the colors of currents from the strongest anodic to cathodic, (N, 3)."""
        ua = np.linspace(-1000 * self._full_ma, 1000 * self._full_ma, wide)
        return current_colors(ua.astype(np.int16), self._full_ma)

    def palette(self, last: Image.Image) -> Image.Image:
        """Return a palette of a frame's colors, and of those that are rare in it."""
        few = [*self._ramp(33).tolist(), *(ImageColor.getrgb(each) for each in _OWN)]
        for spikes in np.eye(len(Afferent)):
            few += [(255 * in_color(spikes * part, 1.0)).tolist() for part in (0.25, 0.5, 0.75, 1)]
        common = last.quantize(256 - len(few), dither=Image.Dither.NONE).getpalette() or []
        palette = Image.new("P", (1, 1))
        palette.putpalette([round(each) for color in few for each in color] + common)
        return palette


def _turned(half: list[float], angle_rad: float) -> NDArray[np.float64]:
    """Return the corners of a turned rectangle around 0, (4, 2), from its half sides."""
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * half
    return np.asarray(corners @ [[cos, sin], [-sin, cos]])
