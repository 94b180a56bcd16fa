"""Pages of PDF, TIFF and image files, their scale, and messages about bad files."""

import base64
import io
import math
import struct
import sys
import zlib

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from PIL import Image, ImageDraw, TiffImagePlugin

from smarttouch.base.errors import PageError
from smarttouch.pages.document import GUESSED_WIDTH_MM, Document
from smarttouch.profile import load_profile
from smarttouch.sources import open_source, virtual_finger
from smarttouch.sources.virtual_finger import password_of

from ..support.checks import assert_says, numbers_in, raises


def sheets(count, size=(300, 400), kind="L"):
    """Return page images; page n has n black squares."""
    made = []
    for number in range(1, count + 1):
        sheet = Image.new(kind, size, 255 if kind in "L1" else (255, 255, 255))
        for square in range(number):
            left = 10 + 40 * square
            ImageDraw.Draw(sheet).rectangle((left, 20, left + 19, 39), fill=0)
        made.append(sheet)
    return made


def squares(page):
    """Return the number of black squares on a page."""
    rows = int(page.grey.shape[0] * 30 / 400)
    return np.count_nonzero(np.diff((page.grey[rows] < 128).astype(int)) == 1)


def save(path, made, **options):
    made[0].save(path, save_all=True, append_images=made[1:], **options)
    return path


def pdf_file(objects, trailer=b""):
    """Return the bytes of a PDF with these objects; the first object is the catalog."""
    out, places = bytearray(b"%PDF-1.4\n"), []
    for number, body in enumerate(objects, 1):
        places.append(len(out))
        out += b"%d 0 obj\n%b\nendobj\n" % (number, body)
    table = len(out)
    out += b"xref\n0 %d\n0000000000 65535 f \n" % (len(places) + 1)
    out += b"".join(b"%010d 00000 n \n" % place for place in places)
    out += b"trailer\n<</Size %d/Root 1 0 R%b>>\n" % (len(places) + 1, trailer)
    return bytes(out + b"startxref\n%d\n%%%%EOF" % table)


def stream(content, entries=b""):
    return b"<</Length %d%b>>stream\n%b\nendstream" % (len(content), entries, content)


def one_page(content=b"", size=(144, 288), page=b"", catalog=b"", more=(), trailer=b""):
    return pdf_file(
        [
            b"<</Type/Catalog/Pages 2 0 R%b>>" % catalog,
            b"<</Type/Pages/Kids[3 0 R]/Count 1>>",
            b"<</Type/Page/Parent 2 0 R/MediaBox[0 0 %d %d]/Contents 4 0 R%b>>" % (*size, page),
            stream(content),
            *more,
        ],
        trailer,
    )


@pytest.fixture
def put(tmp_path):
    """Return a function that writes content to a file and returns the path."""

    def write(content, name="page.pdf"):
        (tmp_path / name).write_bytes(content)
        return tmp_path / name

    return write


def first_page(path, **options):
    with Document(path, **options) as document:
        return document.page(0)


LOCKED = (
    "c-n=L&u-"
    "K(5XKMOa^S!d_`n{E$M)E<r6>p5u7m(}wJk{1st3n^mY^l65+iMS0v>?ZKuA0fFTs@yBx%*CED}Cgns0vd*)y|Poh*"
    ";oGt3wP(pK-YqM#Qy*MT0}WOwbBuIx7Sgb&$uS!SW}BgFrLCy2hReZLVSc}0)gk4++ME)oAI8Llo2*yK)M2VdLg?S2"
    "D8$PfwFdNgX%!1M$kegS8{SE1RacZBJ(>{A!)hwS3X&oAopkFUS>mruX_{{HCkdMvw3-"
    "WkZ*U|H`{=;(Q}jklerZwaGo!s&_}Aw4UM3;{q!WRdww<q~rP=p0nicm@o?qpO1C(P9i0<l2GN+*y!@iCmZTO~JTRU"
    "O9_K3a29)h?R#BjWCKiEh`?B1HlzYL>;(MN^t9$idMNCc{z8!??TLgs0{88QBn#?BAGQqZZplSNj%UP$U{vZYFxssr"
    "Owv7(2bKjuRjH%=(=r(Wlvi?ZCrPAors*G7blxydWM4l1PKaq&|ttq1rCM@KrH`HTn*j#$#!Y#9fiymi_^2^AEgev="
    "l"
)
"""A PDF page with a black lower half: 40-bit RC4, password tulip; zlib-compressed, in base 85."""


@pytest.mark.parametrize(("suffix", "kind"), [("pdf", "L"), ("tif", "L"), ("tif", "1")])
def test_a_file_of_three_pages(tmp_path, suffix, kind):
    options = {"resolution": 100} if suffix == "pdf" else {"dpi": (100, 100)}
    path = save(tmp_path / f"three.{suffix}", sheets(3, kind=kind), **options)
    # The kind of a file is detected by its content, not by its name.
    with Document(path.rename(tmp_path / "three.jpg")) as document:
        assert len(document) == 3
        # Pages can be opened in any order, and more than once.
        assert [squares(document.page(index)) for index in (2, 0, 1, 2)] == [3, 1, 2, 3]
        assert document.page(0).size_mm == pytest.approx((76.2, 101.6))
        assert document.notes == []


@pytest.mark.parametrize(("options", "shape", "width_mm"), [
    ({}, (1200, 600), 50.8), ({"dpi": 72}, (288, 144), 50.8),
    ({"page_width_mm": 25.4}, (600, 300), 25.4),
])  # fmt: skip
def test_the_scale_of_a_pdf(put, options, shape, width_mm):
    path = put(one_page(b"0 144 72 144 re f"))
    page = first_page(path, **options)
    assert page.grey.shape == shape
    assert page.size_mm[0] == pytest.approx(width_mm)
    upper_left = page.grey[: shape[0] // 2, : shape[1] // 2]
    assert upper_left.mean() < 3
    assert page.grey.mean() == pytest.approx(255 * 3 / 4, abs=2)


def test_a_poster_is_rendered_coarser(put):
    page = first_page(put(one_page(size=(3600, 3600)), "poster.pdf"))
    assert page.grey.shape == (6000, 6000)
    assert page.size_mm == pytest.approx((1270, 1270))


@pytest.mark.parametrize("content", [
    b"%PDF-1.7\n",
    b"%PDF-1.7\nnonsense\n%%EOF",
    pdf_file([b"<</Type/Catalog/Pages 2 0 R>>", b"<</Type/Pages/Kids[]/Count 0>>"]),
    b"",
    b"a plain text",
    None,
    "folder",
])  # fmt: skip
def test_bad_files(tmp_path, content):
    path = tmp_path / "page.pdf"
    if content == "folder":
        path.mkdir()
    elif content is not None:
        path.write_bytes(content)
    with raises(PageError, names="file", value=path):
        Document(path)


SIZES = {"allowed": (2, 2000)}


@pytest.mark.parametrize(("content", "dpi", "attributes"), [
    (one_page(size=(14400, 14400)), None, SIZES | {"value": pytest.approx((5080, 5080))}),
    (one_page(size=(144, 1)), None, SIZES | {"value": pytest.approx((50.8, 0.35278))}),
    (one_page().replace(b"Kids[3 0 R]", b"Kids[9 0 R]"), None, {"names": "page", "value": 1}),
    (one_page(page=b"/CropBox[200 300 400 500]"), None, {"names": "page", "value": 1}),
    (one_page(), 2, {"names": "pixels", "value": (4, 8), "allowed": (8, 8)}),
], ids=["large", "flat", "damaged", "empty", "coarse"])  # fmt: skip
def test_pages_that_cannot_be(put, content, dpi, attributes):
    path = put(content)
    with Document(path, dpi=dpi) as document, raises(PageError, **attributes) as caught:
        document.page(0)
    assert str(path) in str(caught.value)


def outcome(path, **options):
    """Return the number of pages of a file, or the error if a page cannot be opened."""
    try:
        with Document(path, **options) as document:
            return len([document.page(index) for index in range(len(document))])
    except PageError as error:
        return error


@pytest.mark.parametrize("suffix", ["pdf", "tif"])
@given(data=st.binary(min_size=1, max_size=20), at=st.floats(0, 1))
@example(data=bytes(20), at=0.1)  # a former failure: PDFium 6462 opens pages without a type
@example(data=bytes(13), at=0.34375)  # a former failure: a page with a damaged dictionary
def test_no_bytes_crash_the_opener(tmp_path_factory, suffix, data, at):
    folder = tmp_path_factory.mktemp("fuzz")
    made = sheets(2, (16, 12))
    whole = save(folder / f"whole.{suffix}", made, dpi=(99, 99), resolution=99).read_bytes()
    path = folder / f"page.{suffix}"
    place = int(at * len(whole))
    # If the length of the data is a multiple of 4, the file ends after the data.
    end = len(whole) if len(data) % 4 else place
    path.write_bytes(whole[:place] + data + whole[place + len(data) : end])
    result = outcome(path, page_width_mm=100)
    if result not in (0, 1, 2):
        assert_says(result)


@pytest.mark.parametrize(
    ("size", "width_mm"), [((800, 1000), GUESSED_WIDTH_MM), ((500, 10_000), 100.0)]
)
def test_an_image_without_a_scale_opens_all_the_same(tmp_path, size, width_mm):
    path = save(tmp_path / "screen.png", sheets(1, size))
    with Document(path) as document:
        page = document.page(0)
        document.page(0)
        assert page.size_mm[0] == pytest.approx(width_mm)
        (note,) = document.notes
        assert numbers_in(note.replace(str(path), "")) == [round(width_mm)]


@pytest.mark.parametrize("index", [-1, 2, 10**9])
@pytest.mark.parametrize("suffix", ["pdf", "tif"])
def test_pages_that_are_not_there(tmp_path, suffix, index):
    path = save(tmp_path / f"two.{suffix}", sheets(2))
    with (
        Document(path) as document,
        raises(PageError, names="page", value=index + 1, allowed=2),
    ):
        document.page(index)


class Terminal(io.StringIO):
    def isatty(self):
        return True


@pytest.fixture
def locked(put):
    put(b"tulip\nmore", "word")
    return put(zlib.decompress(base64.b85decode(LOCKED)), "locked.pdf")


def test_an_encrypted_pdf_opens_with_its_password_alone(locked):
    for password in (None, "rose"):
        with raises(PageError, names="password", value=locked) as caught:
            Document(locked, password=password)
        assert "rose" not in str(caught.value)
    assert first_page(locked, password="tulip").grey.mean() == pytest.approx(127, abs=2)


def test_a_password_comes_from_a_file_or_standard_input(locked, put, monkeypatch):
    word = locked.with_name("word")
    assert password_of(locked, str(word)) == "tulip"
    monkeypatch.setattr(sys, "stdin", io.StringIO("tulip\r\n"))
    assert password_of(locked, "-") == "tulip"
    for name in ("-", str(put(b"", "empty"))):
        with pytest.raises(PageError, match="no password in the first line"):
            password_of(locked, name)
    source = f"page:{locked}?password_file={word}"
    with open_source(source, load_profile("electric-mouse")) as finger:
        assert finger.page.grey.size


def test_a_password_is_asked_for_at_a_terminal_alone(locked, put, monkeypatch):
    assert password_of(put(one_page())) is None
    monkeypatch.setattr(virtual_finger.getpass, "getpass", lambda *_: "tulip")
    monkeypatch.setattr(sys, "stdin", io.StringIO())
    with pytest.raises(PageError, match="--password-file"):
        password_of(locked)
    monkeypatch.setattr(sys, "stdin", Terminal())
    assert password_of(locked) == "tulip"


@pytest.fixture
def picture():
    grey = np.full((60, 80), 255, np.uint8)
    grey[20:40, 30:50] = 0
    return Image.fromarray(grey)


@pytest.mark.parametrize("compression", [None, "tiff_lzw"])
def test_an_image_is_upright_and_has_its_scale(picture, tmp_path, compression):
    turned = TiffImagePlugin.ImageFileDirectory_v2()
    turned[0x0112] = 6
    path = tmp_path / "page.tif"
    picture.save(path, dpi=(200, 200), tiffinfo=turned, compression=compression)
    assert first_page(path).grey.shape == (80, 60)
    for options, mm in (({}, 0.127), ({"dpi": 127}, 0.2), ({"page_width_mm": 30}, 0.5)):
        assert first_page(path, **options).mm_per_pixel == pytest.approx(mm, rel=1e-3)


@pytest.mark.parametrize("stated", [(200, 100), (300, 20), (72, 72)])
def test_resolutions_that_are_not_believed(picture, tmp_path, stated):
    path = tmp_path / "page.tif"
    picture.save(path, dpi=stated)
    with Document(path) as document:
        document.page(0)
    assert len(document.notes) == 1


def png_header(side):
    body = struct.pack(">IIBBBBB", side, side, 8, 0, 0, 0, 0)
    chunk = struct.pack(">I", 13) + b"IHDR" + body + struct.pack(">I", zlib.crc32(b"IHDR" + body))
    return b"\x89PNG\r\n\x1a\n" + chunk + struct.pack(">I", 0) + b"IDAT" + b"\0\0\0\0"


@pytest.mark.parametrize(("side", "attributes"), [
    # For images of side 0 and images without data, the error depends on Pillow's version.
    (0, {}), (100, {}),
    # Pillow rejects this large image but does not report its size, so the message has no size.
    (60_000, {"names": "pixels", "allowed": 10**8}),
    (12_000, {"names": "pixels", "value": (12_000, 12_000), "allowed": 10**8}),
    (1, {"names": "pixels", "value": (1, 1), "allowed": (8, 8)}),
])  # fmt: skip
def test_images_that_are_no_pages(put, side, attributes):
    path = put(png_header(side), "page.png")
    with raises(PageError, **attributes) as caught:
        first_page(path, dpi=300)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize(("options", "value"), [
    ({"dpi": 300, "page_width_mm": 5}, ("dpi", "width")), ({"dpi": 0}, 0),
    ({"dpi": math.nan}, math.nan), ({"page_width_mm": -5}, -5),
    ({"dpi": 0.1}, pytest.approx((20_320, 15_240))),
    ({"dpi": 1e5}, pytest.approx((0.02032, 0.01524))),
])  # fmt: skip
def test_bad_scales(picture, tmp_path, options, value):
    picture.save(tmp_path / "page.png")
    with raises(PageError, value=value):
        first_page(tmp_path / "page.png", **options)


def test_without_the_extra(put, monkeypatch):
    path = put(one_page())
    monkeypatch.setitem(sys.modules, "pypdfium2", None)
    with raises(PageError, names="pip install 'smarttouch[pdf]'", value=path):
        Document(path)
