"""Share of time that a simulated reader stays on the line, with and without the line cue.

The page is level or rotated by 5°. The finger starts at half the height of a line and moves right
at 7 mm/s. Its vertical position drifts in a random walk of 0.5 mm per square root of a second. The
cue is current on all electrodes of either the first or the last row. The reader responds to it
after 0.25 s: the finger moves toward this row at 4 mm/s, for as long as the cue lasted.
"""

import math
from collections import deque

import numpy as np
import pytest

import smarttouch as st
from smarttouch.base.afferent import Mode
from smarttouch.imaging.reading_profile import profile_for_reading
from smarttouch.kernels.bank import load_bank
from smarttouch.pages.prepared_page import find_lines
from smarttouch.reading.legibility import LineDelivery, legibility_of_shapes
from smarttouch.reading.letter_shapes import Shapes
from smarttouch.reading.reading_material import ReadingMaterial
from smarttouch.sources.virtual_finger import FingerPath, PageSource
from tests.pages.printed import degrade, print_page, some_lines

SPEED_MM_S, WALK_MM, CORRECTION_MM_S, REACTION_S = 7.0, 0.5, 4.0, 0.25
NEAR_MM = 2.0
PAGES = {
    "10 points": (10, "DejaVuSerif", {}), "11 points, sans": (11, "DejaVuSans", {}),
    "12 points": (12, "DejaVuSerif", {}), "14 points": (14, "DejaVuSerif", {}),
    "12 points, uneven and noisy": (12, "DejaVuSerif", {"uneven": 0.5, "noise": 15}),
}  # fmt: skip


def page_of(name, tilt_deg=0.0):
    """Return a printed page and its text."""
    size_pt, font, damage = PAGES[name]
    text = some_lines(5, 55, seed=size_pt)
    printed = print_page(text, size_pt=size_pt, font=font)
    return degrade(printed, skew_deg=tilt_deg, **damage).page, "\n".join(text)


class Reader(PageSource):
    """Finger that drifts and follows the cue; ``away_mm`` records its distances from the line."""

    def __init__(self, page, profile, line, seed):
        super().__init__(page, profile, "reader", seed)
        self.line, self.random = line, np.random.default_rng(seed)
        self.x_mm, self.end_mm = line.left_mm + 3, line.right_mm - 3
        self.y_mm, self.before_ns = float(self.middle_mm), 0
        self.felt, self.away_mm = deque([(0, 0)]), []

    @property
    def middle_mm(self):
        line = self.line
        along = line.baseline_mm(np.array([self.x_mm]))[0]
        return along + (line.descent_mm - line.ascent_mm) / 2

    def read(self, time_ns):
        gone_s, self.before_ns = (time_ns - self.before_ns) / 1e9, time_ns
        self.x_mm += SPEED_MM_S * gone_s
        self.y_mm += WALK_MM * math.sqrt(gone_s) * self.random.standard_normal()
        while len(self.felt) > 1 and self.felt[1][0] <= time_ns - 1e9 * REACTION_S:
            self.felt.popleft()
        self.y_mm += CORRECTION_MM_S * gone_s * self.felt[0][1]
        self.away_mm.append(abs(self.y_mm - self.middle_mm))
        self.path = FingerPath(
            np.array([[0.0, 1e6], *([at] * 2 for at in (self.x_mm, self.y_mm, 0, 1))])
        )
        self._lasts_s, self.duration_s = 1e6, None
        return None if self.x_mm > self.end_mm else super().read(time_ns)

    def feel(self, result):
        """Record the cue of a step: -1 (first row, move up), 1 (last row, move down) or 0."""
        rows = result.delivered_ma.reshape(8, 8) > 0
        self.felt.append((result.input.time_ns, int(rows[-1].all()) - int(rows[0].all())))


@pytest.mark.parametrize("tilt_deg", [0, 5])
@pytest.mark.parametrize("name", PAGES)
def test_time_on_the_line(name, tilt_deg, row, quick):
    page, _ = page_of(name, tilt_deg)
    profile, shares = st.load_profile("electric-mouse"), {}
    lines = find_lines(page)
    for cue in (False, True):
        away_mm = []
        for seed, line in enumerate(lines[1:2] if quick else lines[:3]):
            reader = Reader(page, profile, line, seed)
            st.run(reader, "simulated:", line_cue=cue, listeners=[reader.feel])
            away_mm += reader.away_mm
        shares[cue] = np.mean(np.array(away_mm) < NEAR_MM)
    known = {"page": name, "rotation": f"{tilt_deg}°"}
    cells = {"without the cue": f"{shares[False]:.0%}", "with the cue": f"{shares[True]:.0%}"}
    row("Time within 2 mm of the line", known | cells)
    assert shares[True] >= max(0.9, shares[False] + (0.5 if tilt_deg else -0.05))


@pytest.mark.parametrize("name", PAGES)
def test_letters_are_as_legible(name, row, quick, tmp_path):
    from PIL import Image

    page, text = page_of(name)
    Image.fromarray(page.grey).save(path := tmp_path / "page.png", dpi=(300, 300))
    profile = profile_for_reading(st.load_profile("electric-mouse"))
    bank, shapes, rates = load_bank(profile), Shapes(), {}
    for cue in (False, True):
        reading = LineDelivery(
            profile, bank, shapes.tone, shapes.motion(profile), Mode.RA, line_cue=cue
        )
        read = legibility_of_shapes(ReadingMaterial(str(path)), reading, text)
        rates[cue] = read.character_error_rate
    cells = {"without the cue": f"{rates[False]:.3f}", "with the cue": f"{rates[True]:.3f}"}
    row("Character error rates of lines that fill the array", {"page": name} | cells)
