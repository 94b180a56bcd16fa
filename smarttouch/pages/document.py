"""Documents, loaded page by page: PDF with its text, multi-page TIFF, or other images."""

import contextlib
import ctypes
import itertools
import math
import re
import statistics
import unicodedata
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from smarttouch.base.errors import PageError, require_within
from smarttouch.base.files import MOST_DOCUMENT_BYTES, open_file
from smarttouch.base.stopping import Closing
from smarttouch.imaging.grey_image import GreyConverter, open_image, page_frames, read_pixels
from smarttouch.pages.page_and_lines import (
    INCH_MM,
    LARGEST_MM,
    Page,
    TextLine,
    require_pixels,
    require_size_mm,
)
from smarttouch.pages.prepared_page import find_lines
from smarttouch.pages.reading_order import DOUBTFUL, Line, Segment, reading_order, split

if TYPE_CHECKING:
    import pypdfium2

PDF_DPI = 300.0
MOST_RENDERED_PIXELS = 36_000_000
"""Largest number of pixels of a PDF page: A2 at 300 dpi. By default, larger pages get fewer dpi."""
GUESSED_WIDTH_MM = 210.0  # width of an A4 page, for images without a stated size
_LEAST_BELIEVED_DPI = 50.0
"""If an image file states a resolution below this, ignore it. Ignore 72 dpi, too, because many
programs write 72 if they do not know the resolution."""


class LockedError(PageError):
    """Error for a PDF whose password is missing or wrong."""


class Document(Closing):
    """Pages of a PDF, TIFF or other image, loaded on request.

    The format is detected from the file's content. A PDF page includes its text and filled-in
    forms. Only one thread at a time may load pages.

    ``notes`` lists assumptions. ``dpi`` is the resolution; the default is the resolution that an
    image states, or 300 dpi for a PDF. ``page_width_mm`` replaces the width that the file states.
    """

    def __init__(
        self,
        path: Path,
        *,
        dpi: float | None = None,
        page_width_mm: float | None = None,
        password: str | None = None,
    ) -> None:
        if dpi is not None and page_width_mm is not None:
            raise PageError("dpi and a width are both set: give only one of them")
        for name, value in (("dpi", dpi), ("width", page_width_mm)):
            if value is not None:
                require_within(PageError, name, value, 0, math.inf, above=True)
        self.path: Path = path
        self.notes: list[str] = []
        self._dpi, self._page_width_mm = dpi, page_width_mm
        self._pdf = _open_pdf(path, password)
        self._frames: list[int] = []
        if self._pdf is None:
            with open_image(path) as image:
                self._frames = page_frames(image)

    def __len__(self) -> int:
        """Return the number of pages."""
        return len(self._frames if self._pdf is None else self._pdf)

    def close(self) -> None:
        """Close the file."""
        if self._pdf is not None:
            self._pdf.close()

    def page(self, index: int) -> Page:
        """Return a page by its index from 0."""
        if not 0 <= index < len(self):
            raise PageError(f"{self.path} has pages 1 to {len(self)}, not page {index + 1}")
        if self._pdf is None:
            return self._image_page(index)
        import pypdfium2

        name = f"page {index + 1} of {self.path}"
        try:
            with contextlib.closing(self._pdf[index]) as sheet:
                with contextlib.closing(sheet.get_textpage()) as text:
                    printed: int = text.count_chars()
                # Make filled-in form fields a part of the page and of its text.
                pypdfium2.raw.FPDFPage_Flatten(sheet, pypdfium2.raw.FLAT_NORMALDISPLAY)
            with contextlib.closing(self._pdf[index]) as sheet:
                return self._pdf_page(sheet, name, printed)
        # pypdfium2 raises KeyError for the rotation of a damaged page.
        except (pypdfium2.PdfiumError, KeyError):
            raise PageError(f"{name} is damaged: save the file again") from None

    def _image_page(self, index: int) -> Page:
        with open_image(self.path) as image:
            image.seek(self._frames[index])
            require_pixels(str(self.path), *image.size)
            grey = GreyConverter().convert(read_pixels(image))
            across, down = map(float, image.info.get("dpi") or (0, 0))
        height, width = grey.shape
        is_believed = round(across) == round(down) and 72 != across >= _LEAST_BELIEVED_DPI
        dpi = self._dpi or (across if is_believed else 0)
        width_mm = self._page_width_mm or (width / dpi * INCH_MM if dpi else 0)
        if not width_mm:
            width_mm = min(GUESSED_WIDTH_MM, LARGEST_MM * width / height)
            self.notes = [
                f"{self.path} does not state its size: assumed to be {width_mm:.0f} mm wide"
            ]
        require_size_mm(str(self.path), width_mm, width_mm * height / width)
        return Page(grey, width_mm / width)

    def _pdf_page(self, sheet: "pypdfium2.PdfPage", name: str, printed: int) -> Page:
        signs = list(_signs(sheet, printed))
        [(turn_deg, count)] = Counter(sign.turn_deg for sign in signs).most_common(1) or [(0, 0)]
        if turn_deg and count > _STAMP:
            sheet.set_rotation((sheet.get_rotation() + turn_deg) % 360)
            signs = list(_signs(sheet, printed))
        width, height = sheet.get_size()
        if not min(width, height) > 0:
            raise PageError(f"{name} has no area: save the file again")
        point_mm = self._page_width_mm / width if self._page_width_mm else INCH_MM / 72
        require_size_mm(name, width * point_mm, height * point_mm, "width")
        finest_dpi = INCH_MM * math.sqrt(MOST_RENDERED_PIXELS / (width * height)) / point_mm
        mm_per_pixel = INCH_MM / (self._dpi or min(PDF_DPI, finest_dpi))
        scale = point_mm / mm_per_pixel
        require_pixels(name, math.ceil(width * scale), math.ceil(height * scale))
        with contextlib.closing(sheet.render(scale=scale, grayscale=True)) as bitmap:
            # Copy, because closing the bitmap frees its memory.
            grey = np.array(bitmap.to_numpy(), np.uint8).reshape(bitmap.height, bitmap.width)
        page = Page(grey, mm_per_pixel)
        return _with_text(page, signs, point_mm) if signs else page


def _open_pdf(path: Path, password: str | None) -> "pypdfium2.PdfDocument | None":
    """Return an open PDF; None for other files."""
    with open_file(path, PageError, MOST_DOCUMENT_BYTES) as file:
        # PDF programs accept a header within the first 1024 bytes (ISO 32000-1, Annex H.3.4.1).
        if b"%PDF-" not in file.read(1024):
            return None
    try:
        import pypdfium2

        pdf = pypdfium2.PdfDocument(path, password)
    except ImportError:
        message = f"{path}: a PDF needs the extra pdf: pip install 'smarttouch[pdf]'"
        raise PageError(message) from None
    except pypdfium2.PdfiumError as error:
        if "password" not in str(error).lower():
            raise PageError(f"{path} is damaged, or has no pages: save it again") from None
        wrong = "" if password is None else ", and the password is wrong"
        options = "--password-file FILE, or page:PDF?password_file=FILE"
        raise LockedError(f"{path} is locked{wrong}: give {options}") from None
    # Initialize forms before any page is opened, to render filled-in fields.
    if pdf.get_formtype() == pypdfium2.raw.FORMTYPE_ACRO_FORM:
        pdf.init_forms()
    return pdf


_STAMP = 100  # a page is turned only if more characters have its commonest rotation
_LEVEL = 10.0  # angle to the horizontal or vertical, degrees, above which text is slanted
_FINE = 1000.0  # PDFium returns integer coordinates: request them in 1/1000 point
_PLAIN = str.maketrans("\x02\xad\u2010\u2011\x00\ufffe", "----\ufffd\ufffd")
_SPACES = _NONE, _MOVED, _MADE, _TYPED = ("", "\n", "\t", " ")
"""Values of `Segment.space`: none, line break, space inserted by PDFium, space in the file."""


def _signs(sheet: "pypdfium2.PdfPage", printed: int) -> Iterator[Segment]:
    """Yield the characters within the page's visible area, in the order of the file."""
    import pypdfium2.raw as pdfium

    width, height = sheet.get_size()
    fine = round(_FINE * width), round(_FINE * height)
    across, down = ctypes.c_int(), ctypes.c_int()

    def view(x: float, y: float) -> tuple[float, float]:
        pdfium.FPDF_PageToDevice(sheet, 0, 0, *fine, 0, x, y, across, down)
        return across.value / _FINE, down.value / _FINE

    x, y, *sides = (ctypes.c_double() for _ in range(6))
    matrix = pdfium.FS_MATRIX()
    space = _TYPED
    with contextlib.closing(sheet.get_textpage()) as layer:
        for k in range(layer.count_chars()):
            text = chr(pdfium.FPDFText_GetUnicode(layer, k)).translate(_PLAIN)
            if text.isspace() or unicodedata.category(text) == "Cf":
                is_made = pdfium.FPDFText_IsGenerated(layer, k)
                mark = _MOVED if text in "\r\n" else _MADE if is_made else _TYPED
                space = max(space, mark, key=_SPACES.index)
                continue
            pdfium.FPDFText_GetCharOrigin(layer, k, x, y)
            pdfium.FPDFText_GetCharBox(layer, k, *sides)
            pdfium.FPDFText_GetMatrix(layer, k, matrix)
            left, right, bottom, top = (side.value for side in sides)
            corners = view(left, top), view(right, bottom)
            (left, right), (top, bottom) = map(sorted, zip(*corners, strict=True))
            size = abs(pdfium.FPDFText_GetFontSize(layer, k)) * math.hypot(matrix.c, matrix.d)
            if size > 0 and 0 < (left + right) / 2 < width and 0 < (top + bottom) / 2 < height:
                angle = math.degrees(math.atan2(matrix.b, matrix.a)) - sheet.get_rotation()
                turn = round(angle / 90) % 4 * 90 if abs((angle + 45) % 90 - 45) < _LEVEL else None
                baseline, place = view(x.value, y.value)[1], k if k < printed else -1
                yield Segment(text, left, right, baseline, size, place, space, turn)
                space = _NONE


_ABOVE, _AROUND = 0.95, 0.3  # extent of a letter above and below the baseline, in letter sizes
_FAINT = 12  # contrast, gray levels, below which print is invisible
_MOST_UNKNOWN = 0.05  # largest share of undefined characters in a text
_MOSTLY = 0.5  # largest total length of printed lines missing in the text, relative to its lines
_ORDINAL = re.compile(r"(\d)\^(?=(?:st|nd|rd|th|er|re|e|o|a)\b)")
_BULLET = re.compile(r"^[\ue000-\uf8ff](?=\s|$)")  # a bullet in a symbol font


def _with_text(page: Page, signs: list[Segment], point_mm: float) -> Page:
    """Return a rendered page, with its text if the text covers most of the print."""
    seen, rest = _erased(page, signs, point_mm)
    turned = [sign for sign in seen if sign.turn_deg != 0]
    letters = [unicodedata.bidirectional(sign.text[0]) for sign in seen]
    is_leftward = sum(letter in ("R", "AL") for letter in letters) > letters.count("L")
    segments = _segments([sign for sign in seen if sign.turn_deg == 0])
    ordered = reading_order(segments, len(page.grey) * page.mm_per_pixel / point_mm, is_leftward)
    lines = [_text_line(line, point_mm) for line in ordered]
    texts = [_BULLET.sub("•", _ORDINAL.sub(r"\1", line.text)) for line in ordered]
    unknown = sum(
        unicodedata.category(sign)[0] == "C" or sign == "\ufffd" for sign in "".join(texts)
    )
    others, hidden = _print_on(rest), len(signs) - len(seen)
    missing, read = (sum(line.right_mm - line.left_mm for line in some) for some in (others, lines))
    if (
        2 * len(turned) > len(seen) or unknown > _MOST_UNKNOWN * len(seen)
        or missing > _MOSTLY * read
    ):  # fmt: skip
        reason = "the file's text is mostly rotated or unreadable, or lacks many printed lines"
        return replace(page, notes=(f"{reason}: the picture of the page is recognized instead",))
    stamps = "".join((" " if sign.space else "") + sign.text for sign in turned).strip()
    notes = {
        DOUBTFUL: any(line.is_doubtful for line in ordered),
        f"rotated text is left out: {stamps!r}": turned,
        f"text that is not visible is left out (characters: {hidden})": hidden,
        f"printed lines are left out, because the file's text lacks them: {len(others)}": others,
    }
    said = tuple(note for note, is_so in notes.items() if is_so)
    return replace(page, lines=tuple(lines), words=tuple(texts), notes=said)


_SMALLER = 0.95  # largest size of a superscript or subscript, relative to the text
_SHIFTED = (0.1, 0.8)  # smallest and largest shift of a sub- or superscript, in letter sizes
_NEAR = 0.55  # largest gap between a sub- or superscript and the word, in letter sizes
_INITIAL = 1.8  # smallest size of a drop cap relative to the text
_TOUCHING = 0.3  # smallest gap, in letter sizes, that is a space at a line break of the file
_FARTHEST = 2.5  # largest space within a segment, in letter sizes
_SPACED = 0.8  # largest letter spacing, in letter sizes
_WIDER = 1.5  # smallest gap between letter-spaced words, relative to the letter spacing
_EVEN = 0.25  # largest difference between the spaces of a justified line, in letter sizes
_EACH = 0.4  # in a justified line of n words, each space is at most n times this, in letter sizes


def _segments(signs: list[Segment]) -> list[Segment]:
    """Join characters into segments. Put ``^`` before superscripts and ``_`` before subscripts."""
    segments: list[Segment] = []
    for line in split(
        signs, lambda last, sign: abs(sign.y - last.y) > _SHIFTED[1] * max(sign.size, last.size)
    ):
        tracking, widest = _spacing(line)
        for last, sign in itertools.pairwise([None, *line]):
            if sign and not (last and _join(segments[-1], last, sign, tracking, widest)):
                segments.append(replace(sign))
    return segments


def _spacing(line: list[Segment]) -> tuple[float, float]:
    """Return, in letter sizes, the letter spacing of a line and the widest gap within a segment.
    Both are 0 if the line is neither letter-spaced nor justified."""
    gaps = [sign.gap(last) for last, sign in itertools.pairwise(line)]
    spaces = [gap for gap, sign in zip(gaps, line[1:], strict=True) if sign.space == _MADE]
    tracking = statistics.median(gaps) if len(gaps) > 2 else 0.0
    if _TOUCHING / 2 < tracking < _SPACED and all(sign.text.isalpha() for sign in line):
        return tracking, 2 * _WIDER * tracking
    is_even = len(spaces) > 1 and max(spaces) - min(spaces) < _EVEN
    return 0.0, _EACH * (len(spaces) + 1) * is_even


def _join(segment: Segment, last: Segment, sign: Segment, tracking: float, widest: float) -> bool:
    """Append ``sign`` to ``segment`` if both belong together; return whether they do."""
    gap = sign.gap(last)
    raised = (segment.y - sign.y) / max(segment.size, sign.size)
    is_space = sign.space == _TYPED or (
        gap > _WIDER * tracking and (sign.space == _MADE or (gap > _TOUCHING and sign.space))
    )
    text = " " * bool(is_space) + sign.text
    is_script = gap < _NEAR and _SHIFTED[0] < abs(raised) < _SHIFTED[1]
    if len(segment.text) == 1 and segment.size > _INITIAL * sign.size and raised > 0 and gap < 1:
        segment.y, segment.size = sign.y, sign.size
    elif is_script and segment.size < _SMALLER * sign.size:
        segment.text = ("^" if raised < 0 else "_") + segment.text
        segment.y, segment.size = sign.y, sign.size
    elif is_script and sign.size < _SMALLER * segment.size:
        mark = "^" if raised > 0 else "_"
        text = text if last.y == sign.y else text.replace(sign.text, mark + sign.text)
    elif (
        gap > _FARTHEST if sign.space == _TYPED else gap > widest and segment.is_apart(sign)
    ):  # fmt: skip
        return False
    segment.add(text, sign)
    return True


_ASCENT, _X_HEIGHT, _DESCENT = 0.74, 0.48, 0.22  # typical values of fonts, in letter sizes


def _text_line(line: Line, point_mm: float) -> TextLine:
    words = line.segments
    size = statistics.median(word.size for word in words) * point_mm
    return TextLine(
        left_mm=min(word.left for word in words) * point_mm,
        right_mm=max(word.right for word in words) * point_mm,
        baseline=(statistics.median(word.y for word in words) * point_mm,),
        x_height_mm=_X_HEIGHT * size,
        ascent_mm=_ASCENT * size,
        descent_mm=_DESCENT * size,
        cell=int(line.is_cells),
    )


def _erased(page: Page, signs: list[Segment], point_mm: float) -> tuple[list[Segment], Page]:
    """Return the visible characters, and the page with all characters erased."""
    scale, seen, grey = point_mm / page.mm_per_pixel, [], page.grey.copy()
    for sign in signs:
        above, around = _ABOVE * sign.size, _AROUND * sign.size
        sides = sign.y - above, sign.y + around, sign.left - 2 * around, sign.right + 2 * around
        top, bottom, left, right = (max(0, round(side * scale)) for side in sides)
        box = slice(top, bottom), slice(left, right)
        if not page.grey[box].size or np.ptp(page.grey[box]) >= _FAINT:
            seen.append(sign)
        if page.grey[box].size:
            grey[box] = np.median(grey[box])
    return seen, replace(page, grey=grey)


_COARSE_MM = 0.25  # pixel size of the image in which `_print_on` searches
_LETTERS_MM = (0.8, 12.0)  # smallest and largest height of a letter in `_print_on`
_CONTRAST = 60  # smallest contrast of a letter in `_print_on`, gray levels
_FEWEST_SPOTS = 4  # with fewer letters on a page, `_print_on` finds no lines


def _print_on(page: Page) -> list[TextLine]:
    """Return the lines of print that a page image still has after `_erased` removed the text."""
    step = page.mm_per_pixel / _COARSE_MM
    coarse = cv2.resize(page.grey, None, fx=step, fy=step, interpolation=cv2.INTER_AREA)
    ink = np.abs(coarse - np.median(coarse)) > _CONTRAST
    heights = cv2.connectedComponentsWithStats(ink.astype(np.uint8))[2][1:, cv2.CC_STAT_HEIGHT]
    low, high = (height / _COARSE_MM for height in _LETTERS_MM)
    if np.count_nonzero((heights >= low) & (heights <= high)) < _FEWEST_SPOTS:
        return []
    # The print of a scan may be rotated by 90°.
    turned = Page(np.ascontiguousarray(np.rot90(page.grey)), page.mm_per_pixel)
    return find_lines(page, None) or find_lines(turned, None)
