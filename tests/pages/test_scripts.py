"""Detection of complete text lines in scripts other than Latin."""

from pathlib import Path

import matplotlib
import numpy as np
import pytest
from PIL import Image, ImageDraw, ImageFont, features

from smarttouch.pages.page_and_lines import Page
from smarttouch.pages.prepared_page import prepare_page

DPI = 150
DEJAVU = Path(matplotlib.get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf"
FREE = Path("/usr/share/fonts/truetype/freefont/FreeSerif.ttf")
GOTHIC = Path("/usr/share/fonts/opentype/ipafont-gothic/ipag.ttf")
SCRIPTS = {
    "Arabic": (DEJAVU, "يضع الانسان يده على الورق فيعرف ان كان خشنا او ناعما"),
    "Hebrew": (DEJAVU, "האדם מניח את ידו על הנייר ויודע אם הוא חלק או גס"),
    "Greek": (DEJAVU, "ο άνθρωπος βάζει το χέρι του πάνω στο χαρτί"),
    "Cyrillic": (DEJAVU, "человек кладет руку на бумагу и знает гладкая ли она"),
    "Devanagari": (FREE, "मनुष्य कागज पर हाथ रखता है और जानता है कि वह चिकना है"),
    "Japanese": (GOTHIC, "指 で 紙 に 触 れ る と 滑 ら か か 粗 い か が す ぐ に 分 か る"),
}
"""Font and words of each script; the test shuffles the words for each line."""


@pytest.mark.parametrize("script", SCRIPTS)
def test_lines_of_a_script_are_found_and_whole(script):
    path, text = SCRIPTS[script]
    if not path.exists():
        pytest.skip(f"the font for {script} is not installed: {path}")
    if script in ("Arabic", "Devanagari") and not features.check("raqm"):
        pytest.skip(f"{script} needs Pillow with the library raqm, which joins letters")
    font = ImageFont.truetype(str(path), 12 * DPI / 72)
    random, words = np.random.default_rng(1), text.split()
    space = "" if script == "Japanese" else " "
    sheet = Image.new("L", (900, 340), 235)
    draw = ImageDraw.Draw(sheet)
    boxes = []
    for row in range(7):
        line = space.join(random.permutation(words))
        draw.text((60, 60 + 38 * row), line, font=font, fill=25, anchor="ls")
        boxes.append(draw.textbbox((60, 60 + 38 * row), line, font=font, anchor="ls"))
    prepared = prepare_page(Page(np.asarray(sheet), 25.4 / DPI))
    assert len(prepared.lines) == 7
    ends = np.array(boxes)[:, [0, 2]] / DPI * 25.4
    lines = np.array([(line.left_mm, line.right_mm) for line in prepared.lines])
    is_whole = (lines[:, 0] < ends[:, 0] + 3) & (lines[:, 1] > ends[:, 1] - 3)
    # One Japanese line may be incomplete: gaps within characters can split a line.
    assert is_whole.sum() >= (6 if script == "Japanese" else 7)
    for line, box in zip(prepared.lines, boxes, strict=True):
        _, top, _, bottom = (edge / DPI * 25.4 for edge in box)
        height = bottom - top
        assert line.top_mm < top + 0.2 * height
        assert line.bottom_mm > bottom - 0.3 * height
