"""Typeset pages of known text in eleven layouts, flat, scanned or photographed."""

import re
from functools import cache
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from smarttouch.pages.page_and_lines import Page
from tests.pages.printed import INCH_MM, INK, PAPER, Printed, _font, degrade

DPI, WIDTH, HEIGHT, MARGIN, GUTTER = 200, 1400, 1800, 110, 50
FULL = WIDTH - 2 * MARGIN
POINT = DPI / 72
FONTS = (
    ("DejaVuSerif", "DejaVuSerif-Bold"),
    ("STIXGeneral", "STIXGeneralBol"),
    ("DejaVuSans", "DejaVuSans-Bold"),
)
LATIN = [
    "lorem", "ipsum", "dolor", "sit", "amet", "consectetur", "elit", "integer", "odio", "libero",
    "cursus", "ante", "dapibus", "diam", "nisi", "nulla", "quis", "nibh", "elementum", "imperdiet",
    "sagittis", "fusce", "tellus", "augue", "semper", "porta", "mauris", "massa", "lacinia", "arcu",
]  # fmt: skip


@cache
def english():
    """Return English words from the protocol document, which seldom changes."""
    text = (Path(__file__).parents[1] / "firmware/PROTOCOL.md").read_text("utf-8")
    return sorted(set(re.findall(r"(?<![\w./`-])[a-z]{2,12}(?![\w./`(-])", text)))


class Sheet:
    """Sheet on which text is set; ``pieces`` are the texts of its lines in reading order."""

    def __init__(self, seed, height=HEIGHT, width=WIDTH):
        self.random = np.random.default_rng(seed)
        self.image = Image.new("L", (width, height), PAPER)
        self.draw = ImageDraw.Draw(self.image)
        self.regular, self.bold = FONTS[seed % len(FONTS)]
        self.size = (10 + seed % 2) * POINT if self.regular == "STIXGeneral" else 9 * POINT
        self.pieces = []

    def words(self, count, source=None):
        """Return random words, with the capitals and punctuation of prose."""
        words = [str(self.random.choice(source or english())) for _ in range(count)]
        words[0] = words[0].capitalize()
        for k in range(1, count):
            if self.random.random() < 0.1:
                words[k - 1] += "."
                words[k] = words[k].capitalize()
            elif self.random.random() < 0.08:
                words[k - 1] += ","
        return words

    def put(self, text, x, y, size=None, font=None, anchor="ls", silent=False):
        """Draw text and return its right end. Append the text to `pieces` unless ``silent``."""
        face = _font(font or self.regular, size or self.size)
        self.draw.text((round(x), round(y)), text, fill=INK, font=face, anchor=anchor)
        if not silent:
            self.pieces.append(text)
        return x + face.getlength(text)

    def row(self, texts, xs, y, anchors=None, **kwargs):
        """Draw separate parts of a line, and append them to `pieces` as one line."""
        for text, x, anchor in zip(texts, xs, anchors or ["ls"] * len(xs), strict=True):
            self.put(text, x, y, anchor=anchor, silent=True, **kwargs)
        self.pieces.append(" ".join(texts))

    def leaders(self, start, end, y, size=None):
        """Draw dot leaders from one position of a line to another."""
        face = _font(self.regular, size or self.size)
        step = face.getlength(" .")
        for x in np.arange(np.ceil((start + step) / step) * step, end - 1.5 * step, step):
            self.put(".", x, y, size, silent=True)

    def column(self, x, y, width, lines, size=None, indents=(0, 0), source=None, words=()):
        """Draw left-aligned lines of random words and return the next baseline; ``indents`` are
        the indents of the first line and of the other lines."""
        size = size or self.size
        face = _font(self.regular, size)
        words = [*words, *self.words(20 * lines, source)]
        for number in range(lines):
            indent = indents[number > 0]
            count = 1
            while face.getlength(" ".join(words[: count + 1])) < width - indent:
                count += 1
            if number == lines - 1 and lines > 2:
                count = max(1, count // 2)
            self.put(" ".join(words[:count]), x + indent, y, size)
            words = words[count:]
            y += 1.3 * size
        return y

    def rule(self, x, y, width, thick=2):
        """Draw a horizontal rule."""
        self.draw.rectangle((x, y, x + width, y + thick), fill=INK)


def three_columns(s):
    """Set three columns under a headline, with a large quote between rules in the middle one."""
    s.put(" ".join(s.words(4)).strip("."), MARGIN, 160, 2 * s.size, s.bold)
    width = (FULL - 2 * GUTTER) // 3
    for k in range(3):
        x, y = MARGIN + k * (width + GUTTER), 280
        if k != 1:
            s.column(x, y, width, 38, indents=(30, 0))
            continue
        y = s.column(x, y, width, 14)
        s.rule(x, y, width, 4)
        y = s.column(x, y + 70, width, 4, 1.5 * s.size)
        s.rule(x, y - 20, width, 4)
        s.column(x, y + 50, width, 13)


def form(s):
    """Set a form: labels with answers on ruled lines, one or two in a row."""
    s.put("Application for " + s.words(1)[0].lower(), WIDTH / 2, 160, 1.7 * s.size, s.bold, "ms")
    y = 300
    for row in range(13):
        pairs = 1 + int(row % 3 == 1)
        label = [f"{word}:" for word in s.words(pairs)]
        xs = [MARGIN + k * FULL / 2 for k in range(pairs)]
        parts, places = [], []
        for k in range(pairs):
            s.rule(xs[k] + 240, y + 8, FULL / pairs - 270)
            parts += [label[k].replace(".:", ":").replace(",:", ":"), " ".join(s.words(1 + k % 2))]
            places += [xs[k], xs[k] + 250]
        s.row(parts, places, y)
        y += 85
    s.column(MARGIN, y + 40, FULL, 5)


def index(s):
    """Set an index: three columns of entries with page numbers, and indented subentries."""
    s.put("Index", MARGIN, 160, 2 * s.size, s.bold)
    width, size = (FULL - 2 * GUTTER) // 3, 0.85 * s.size
    for k in range(3):
        y = 260
        for row in range(42):
            pages = ", ".join(map(str, sorted(s.random.integers(2, 400, s.random.integers(1, 4)))))
            word = str(s.random.choice(english()))
            s.put(f"{word}, {pages}", MARGIN + k * (width + GUTTER) + 30 * (row % 4 > 1), y, size)
            y += 1.3 * size


def dictionary(s):
    """Set a dictionary page: two columns with bold headwords, guide words and a page number."""
    words = sorted(s.words(26))
    s.row([words[0], words[-1]], [MARGIN, WIDTH - MARGIN], 120, ["ls", "rs"], font=s.bold)
    s.rule(MARGIN, 140, FULL)
    width = (FULL - GUTTER) // 2
    for k in range(2):
        x, y = MARGIN + k * (width + GUTTER), 200
        for word in words[13 * k : 13 * k + 13]:
            end = s.put(word, x, y, font=s.bold, silent=True) + 14
            before = len(s.pieces)
            y = s.column(x, y, width, 3, indents=(end - x, 25), words=["n."])
            s.pieces[before] = f"{word} {s.pieces[before]}"
    s.put(str(s.random.integers(10, 900)), WIDTH / 2, HEIGHT - 60, anchor="ms")


def receipt(s):
    """Set a narrow receipt: goods with prices, and sums."""
    s.regular, size = "DejaVuSansMono", 8.5 * POINT
    s.put(" ".join(s.words(2)).strip(".,").upper(), WIDTH / 2, 150, 1.4 * size, anchor="ms")
    s.put(f"{s.random.integers(1, 99)} Market Street", WIDTH / 2, 210, size, anchor="ms")
    left, right, y, total = 380, WIDTH - 380, 330, 0
    for _ in range(19):
        price = int(s.random.integers(50, 5000))
        total += price
        name = " ".join(s.words(int(s.random.integers(1, 3)))).strip(".,")
        s.row([name, f"{price / 100:.2f}"], [left, right], y, ["ls", "rs"], size=size)
        y += 1.6 * size
    s.rule(left, y - size / 2, right - left)
    for name, part in (("Subtotal", 1), ("Tax", 0.19), ("TOTAL", 1.19)):
        s.row([name, f"{total * part / 100:.2f}"], [left, right], y + size, ["ls", "rs"], size=size)
        y += 1.6 * size
    s.put("Thank you for your visit", WIDTH / 2, y + 2.5 * size, size, anchor="ms")


def playbill(s):
    """Set a playbill: centered lines of many sizes, and a cast list with dot leaders."""
    y = 100
    for factor in (1, 2.6, 1.2, 3.2, 1, 1.6):
        words = " ".join(s.words(2 if factor > 2 else 5)).strip(".,")
        y += 1.7 * factor * s.size
        font = s.bold if factor > 1.5 else None
        s.put(words.upper() if factor > 3 else words, WIDTH / 2, y, factor * s.size, font, "ms")
    y += 3 * s.size
    for _ in range(11):
        role, name = (" ".join(s.words(2)).replace(".", "").replace(",", "") for _ in range(2))
        s.row([role, name], [MARGIN + 150, WIDTH - MARGIN - 150], y, ["ls", "rs"])
        length = [_font(s.regular, s.size).getlength(text) for text in (role, name)]
        s.leaders(MARGIN + 150 + length[0], WIDTH - MARGIN - 150 - length[1], y)
        y += 1.7 * s.size
    s.put("Doors open at seven", WIDTH / 2, y + 3 * s.size, 1.3 * s.size, anchor="ms")


def bilingual(s):
    """Set paragraphs in two languages side by side."""
    width = (FULL - GUTTER) // 2
    lines = [int(each) for each in s.random.integers(4, 9, 5)]
    for k, source in enumerate((LATIN, None)):
        y = 170
        for count in lines:
            s.column(MARGIN + k * (width + GUTTER), y, width, count - k, source=source)
            y += 1.3 * s.size * (count + 1)


def sidebar(s):
    """Set a wide column of text beside a box of smaller print."""
    s.put(" ".join(s.words(4)).strip("."), MARGIN, 160, 1.8 * s.size, s.bold)
    wide = 760
    y = 270
    for lines in (9, 12, 10):
        y = s.column(MARGIN, y, wide, lines) + 25
    x, end = MARGIN + wide + GUTTER, WIDTH - MARGIN
    s.draw.rectangle((x, 240, end, 240 + 17 * 1.3 * s.size), outline=INK, width=3)
    s.put(s.words(1)[0].strip(".,") + " facts", x + 25, 300, font=s.bold)
    s.column(x + 25, 350, end - x - 50, 13, 0.88 * s.size)


def contents(s):
    """Set a table of contents: chapters and sections, with dot leaders to page numbers."""
    s.put("Contents", WIDTH / 2, 170, 2 * s.size, s.bold, "ms")
    y, page = 300, 1
    for row in range(30):
        page += int(s.random.integers(1, 14))
        text = " ".join(s.words(int(s.random.integers(2, 6)))).replace(".", "")
        x = MARGIN + 60 + 50 * (row % 4 > 0)
        s.row([text, str(page)], [x, WIDTH - MARGIN - 60], y, ["ls", "rs"])
        ends = [_font(s.regular, s.size).getlength(each) for each in (text, str(page))]
        s.leaders(x + ends[0], WIDTH - MARGIN - 60 - ends[1], y)
        y += 1.75 * s.size


def poem(s):
    """Set a poem: a title, and numbered stanzas with every second line indented."""
    s.put(" ".join(s.words(3)).strip("."), WIDTH / 2, 170, 1.6 * s.size, s.bold, "ms")
    y = 280
    for number in ("I", "II", "III", "IV"):
        s.put(number, WIDTH / 2, y, anchor="ms")
        y += 1.8 * s.size
        for row in range(6):
            text = " ".join(s.words(int(s.random.integers(4, 8))))
            s.put(text, MARGIN + 220 + 60 * (row % 2), y)
            y += 1.35 * s.size
        y += 0.9 * s.size


def footnotes(s):
    """Set a running head, two paragraphs, and footnotes in small print below a short rule."""
    s.row([" ".join(s.words(3)).strip("."), "117"], [MARGIN, WIDTH - MARGIN], 110, ["ls", "rs"],
          size=0.9 * s.size)  # fmt: skip
    y = 210
    for lines in (12, 14):
        y = s.column(MARGIN, y, FULL, lines, indents=(40, 0))
    s.rule(MARGIN, y + 30, 250)
    y += 80
    for number in (1, 2, 3):
        y = s.column(MARGIN, y, FULL, 3, 0.8 * s.size, (30, 0), words=[f"{number}."])


LAYOUTS = (three_columns, form, index, dictionary, receipt, playbill, bilingual, sidebar, contents,
           poem, footnotes)  # fmt: skip
MEDIA = ("flat", "scanned", "photographed")


def page_of(layout, medium, seed):
    """Return a typeset page and the texts of its lines in reading order."""
    sheet = Sheet(seed)
    layout(sheet)
    page = Page(np.asarray(sheet.image), INCH_MM / DPI)
    random = np.random.default_rng([seed, LAYOUTS.index(layout), MEDIA.index(medium)])
    if medium != "flat":
        blur, uneven = random.uniform(0.5, 0.9), random.uniform(0, 0.2)
        harm = {"skew_deg": random.uniform(-1.5, 1.5), "noise": random.uniform(3, 7)}
        if medium == "photographed":
            blur, uneven = random.uniform(0.6, 1.1), random.uniform(0.2, 0.6)
            harm = {
                "perspective": random.uniform(0.04, 0.12),
                "curvature": random.uniform(0, 4),
                "skew_deg": random.uniform(-2, 2),
                "noise": 3,
                "jpeg": int(random.integers(30, 70)),
            }
        page = degrade(Printed(page, ()), blur_px=blur, uneven=uneven, seed=seed, **harm).page
    return page, sheet.pieces
