"""Documents: a PDF, a TIFF of many pages or one image, loaded page by page, and their passwords."""

import contextlib
import getpass
import math
import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from smarttouch.base.errors import PageError
from smarttouch.base.files import MOST_DOCUMENT_BYTES, open_file, read_text, unreadable
from smarttouch.base.stopping import Closing
from smarttouch.pages.grey_image import open_image, page_frames
from smarttouch.pages.page_image import (
    INCH_MM,
    LARGEST_MM,
    Page,
    check_scale_options,
    read_grey,
    require_pixels,
    require_size_mm,
)
from smarttouch.pages.pdf_text import turn_of_text, with_text

if TYPE_CHECKING:
    import pypdfium2

PDF_DPI = 300.0
MOST_RENDERED_PIXELS = 36_000_000
"""Most pixels of a PDF's page, A2 at 300 dots per inch. Larger ones are rendered coarser: most are
scans whose size in points is that in pixels, without finer detail."""
GUESSED_WIDTH_MM = 210.0  # width of an A4 page, for images without a stated size
_SIGNATURE, _SIGNATURE_WITHIN = b"%PDF-", 1024
"""Beginning of a PDF, and the bytes in which readers look for it (ISO 32000-1, Annex H.3.4.1)."""
_MOST_PASSWORD_BYTES = 4096


class LockedError(PageError):
    """A PDF needs a password, or another one."""


class Document(Closing):
    """Pages of a PDF, a TIFF or any other image, recognized by its content, loaded on request.

    A PDF is rendered, with filled-in forms, and brings its text; an image is open only while a page
    is loaded. One thread at a time may load pages; ``notes`` lists what was assumed. ``dpi``
    replaces an image's own resolution, or the 300 at which a PDF is rendered; ``page_width_mm``
    replaces the file's own scale.
    """

    def __init__(
        self,
        path: Path,
        *,
        dpi: float | None = None,
        page_width_mm: float | None = None,
        password: str | None = None,
    ) -> None:
        check_scale_options(dpi, page_width_mm)
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

    @property
    def has_scale(self) -> bool:
        """Whether it surely states the size of its pages, as a PDF does."""
        return self._pdf is not None

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
                printed = _flatten(sheet)
            with contextlib.closing(self._pdf[index]) as sheet:
                rotation = sheet.get_rotation()
                # The only text of a scan may be a turned stamp.
                for turn_deg in (turn_of_text(sheet), 0):
                    sheet.set_rotation((rotation + turn_deg) % 360)
                    page = self._pdf_page(sheet, name, printed)
                    if page.lines or turn_deg == 0:
                        break
                return page
        # PDFium has no rotation of a page whose description is damaged.
        except (pypdfium2.PdfiumError, KeyError):
            raise PageError(f"{name} cannot be read: the file is damaged") from None

    def _image_page(self, index: int) -> Page:
        with open_image(self.path) as image:
            image.seek(self._frames[index])
            grey, mm_per_pixel = read_grey(self.path, image, self._dpi, self._page_width_mm)
        height, width = grey.shape
        if mm_per_pixel is None:
            mm_per_pixel = min(GUESSED_WIDTH_MM / width, LARGEST_MM / height)
            self._note(
                f"{self.path} does not state its size: "
                f"assumed to be {width * mm_per_pixel:.0f} mm wide"
            )
        require_size_mm(str(self.path), width * mm_per_pixel, height * mm_per_pixel)
        return Page(grey, mm_per_pixel)

    def _pdf_page(self, sheet: "pypdfium2.PdfPage", name: str, printed: int) -> Page:
        width, height = sheet.get_size()
        if not min(width, height) > 0:
            raise PageError(f"{name} has no area: the file is damaged")
        mm = self._page_width_mm / width if self._page_width_mm else INCH_MM / 72
        require_size_mm(name, width * mm, height * mm, "page_width_mm")
        dpi = self._dpi or PDF_DPI
        finest_dpi = INCH_MM * math.sqrt(MOST_RENDERED_PIXELS / (width * height)) / mm
        if finest_dpi < dpi:
            dpi = finest_dpi
            self._note(
                f"{name} is {width * mm:.0f} x {height * mm:.0f} mm: "
                f"rendered at {dpi:.0f} dots per inch"
            )
        scale = mm / (INCH_MM / dpi)
        require_pixels(name, math.ceil(width * scale), math.ceil(height * scale))
        with contextlib.closing(sheet.render(scale=scale, grayscale=True)) as bitmap:
            # A copy, as the bitmap frees its memory.
            grey = np.array(bitmap.to_numpy(), np.uint8).reshape(bitmap.height, bitmap.width)
        return with_text(sheet, Page(grey, INCH_MM / dpi), mm, printed)

    def _note(self, sentence: str) -> None:
        if sentence not in self.notes:
            self.notes.append(sentence)


def password_of(path: Path, password_file: str | None = None) -> str | None:
    """Return the password of a document; None if it needs none.

    It is the first line of a file, or of standard input for ``-``; without one it is asked for
    where somebody sits at a terminal, until it is right or empty.
    """
    if password_file is not None:
        is_input = password_file == "-"
        text = (
            sys.stdin.readline()
            if is_input
            else read_text(Path(password_file), PageError, _MOST_PASSWORD_BYTES)
        )
        if password := text.split("\n")[0].rstrip("\r"):
            return password
        name = "standard input" if is_input else password_file
        raise PageError(f"{name} has no password in its first line: write it there")
    password = None
    while True:
        try:
            Document(path, password=password).close()
            return password
        except LockedError:
            if password == "" or not sys.stdin.isatty():
                raise
            password = getpass.getpass(f"Password of {path.name}: ")


def parse_pages(text: str, count: int) -> list[int]:
    """Return the indices, from 0, of pages in a list such as ``1,3-5`` or ``7-``, in its order."""
    indexes: list[int] = []
    for part in text.split(","):
        # Python refuses to convert very long numbers.
        match = re.fullmatch(r"\s*([0-9]{1,9})\s*(-\s*([0-9]{1,9})?\s*)?", part)
        first = int(match[1]) if match else 0
        last = int(match[3] or count) if match and match[2] else first
        if not 1 <= first <= last <= count:
            raise PageError(
                f"pages {text}: the document has pages 1 to {count}, not {part.strip()!r}: "
                "write 1,3-5 or 7-"
            )
        indexes += range(first - 1, last)
    return indexes


def _open_pdf(path: Path, password: str | None) -> "pypdfium2.PdfDocument | None":
    """Return an open PDF; None for other files."""
    try:
        with open_file(path, PageError, MOST_DOCUMENT_BYTES) as file:
            if _SIGNATURE not in file.read(_SIGNATURE_WITHIN):
                return None
    except OSError as error:
        raise unreadable(PageError, path, error) from None
    try:
        import pypdfium2
    except ImportError:
        message = f"{path}: a PDF needs the extra pdf: pip install 'smarttouch[pdf]'"
        raise PageError(message) from None
    try:
        pdf = pypdfium2.PdfDocument(path, password)
    except pypdfium2.PdfiumError as error:
        if "password" not in str(error).lower():
            raise PageError(f"{path} is damaged, or has no pages: save it again") from None
        remedy = (
            ": give --password-file FILE, or page:FILE?password_file=FILE" if password is None
            else ", and this is not its password: check it"
        )  # fmt: skip
        raise LockedError(f"{path} is locked{remedy}") from None
    # Needed to render filled-in fields, before any page is opened.
    if pdf.get_formtype() == pypdfium2.raw.FORMTYPE_ACRO_FORM:
        pdf.init_forms()
    return pdf


def _flatten(sheet: "pypdfium2.PdfPage") -> int:
    """Make filled-in fields a part of a page and its text; return its characters before that."""
    import pypdfium2.raw as pdfium

    with contextlib.closing(sheet.get_textpage()) as text:
        printed: int = text.count_chars()
    pdfium.FPDFPage_Flatten(sheet, pdfium.FLAT_NORMALDISPLAY)
    return printed
