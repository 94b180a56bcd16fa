"""A book goes on where it was interrupted, and each page is reported as it is done."""

import json
import shutil
import signal
import subprocess

import pytest
from PIL import Image

from smarttouch.base.errors import ReadingError
from smarttouch.braille.brf import format_brf
from smarttouch.braille.code_tables import open_table
from smarttouch.pages.prepared_page import print_text
from smarttouch.reading.document_cells import document_cells, forget_pages
from smarttouch.reading.material import ReadingMaterial
from smarttouch.reading.recognition import RecognitionOptions

from ..forks import PROGRAM, Forked

pytestmark = pytest.mark.skipif(
    shutil.which("tesseract") is None, reason="needs Tesseract: apt install tesseract-ocr"
)
WORDS = ("first", "second", "third")
LINE = "is a page of this book"


@pytest.fixture(scope="module")
def book(tmp_path_factory):
    """Return the path of a book of three pages, as pictures."""
    path = tmp_path_factory.mktemp("book") / "book.tif"
    pages = [Image.fromarray(print_text(f"The {word}\n{LINE}").grey) for word in WORDS]
    pages[0].save(path, save_all=True, append_images=pages[1:], dpi=(300, 300))
    return path


def cells(book, output=None, **options):
    said = []
    source = ReadingMaterial(str(book), RecognitionOptions(**options))
    return document_cells(source, open_table("en-1"), said.append, output), said


def test_pages_come_in_order_and_each_is_reported(book):
    loaded, said = cells(book)
    last = cells(book, pages="3")[0].paragraphs
    assert loaded.paragraphs[-len(last) :] == last
    assert len(set(loaded.paragraphs)) >= len(WORDS)
    assert "page 1" in said[0]
    assert sum("done" in words for words in said) == 3


def test_a_killed_run_goes_on(book, tmp_path):
    output = tmp_path / "book.brf"
    command = [PROGRAM, "braille", str(book), "--table", "en-1", "--output", str(output)]
    with Forked(command, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True) as run:
        for words in run.stderr:
            if "done" in words:
                run.send_signal(signal.SIGKILL)
                break
    (folder,) = tmp_path.iterdir()
    kept = {path.name for path in folder.glob("*.json")}
    assert not output.exists()
    assert 1 <= len(kept) <= 3
    with Forked(command, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True) as again:
        assert f"{len(kept)} of 3" in again.communicate()[1]
    assert list(tmp_path.iterdir()) == [output]
    whole, _ = cells(book)
    assert output.read_bytes() == format_brf(whole.laid_out(None, None))


def test_kept_pages_are_those_of_the_same_options(book, tmp_path):
    output = tmp_path / "book.brf"
    first, _ = cells(book, output)
    path = sorted((tmp_path / "book.brf.pages").iterdir())[0]
    kept = json.loads(path.read_text())
    path.write_text(json.dumps(kept | {"lines": [kept["lines"][0] | {"text": "A"}]}))
    again, said = cells(book, output)
    assert again.paragraphs[0] == "⠠⠁"
    assert "3 of 3" in said[0]
    assert cells(book, output, dpi=150)[0].paragraphs != again.paragraphs
    path.write_text('{"number": 1, "para')
    assert cells(book, output)[0].paragraphs == first.paragraphs
    forget_pages(output)
    assert not list(tmp_path.iterdir())


def test_a_document_without_text_is_refused(tmp_path):
    Image.new("L", (300, 200), 255).save(tmp_path / "blank.png")
    with pytest.raises(ReadingError):
        cells(tmp_path / "blank.png")
