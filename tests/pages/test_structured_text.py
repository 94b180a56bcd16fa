"""Documents of five kinds give the same headings, lists, tables and emphasis, and no more."""

import shutil
import subprocess
import zipfile

import pytest

from smarttouch.base.errors import PageError
from smarttouch.pages import structured_text
from smarttouch.pages.structured_text import Emphasis, format_of, read_structured_text

from ..raising import raises

needs_pandoc = pytest.mark.skipif(shutil.which("pandoc") is None, reason="pandoc is not installed")

MARKDOWN = """---
title: Tea and people
author: [A. Writer, B. Other]
lang: en
---

# The *first* part

Words with **weight** and a
second line.

- one
- two
    1. small
    2. smaller

| Name  | Price |
|-------|-------|
| Apple | 3     |
| Pear  | 12    |

## The rest

Last words.
"""
BLOCKS = [
    ("heading", 1, "The first part"), ("paragraph", 0, "Words with weight and a second line."),
    ("item", 0, "one"), ("item", 0, "two"), ("item", 1, "1. small"), ("item", 1, "2. smaller"),
    ("row", 0, "Name; Price"), ("row", 0, "Apple; 3"), ("row", 0, "Pear; 12"),
    ("heading", 2, "The rest"), ("paragraph", 0, "Last words."),
]  # fmt: skip


def written(folder, kind):
    """Return a file of a kind, made by pandoc from Markdown."""
    source = folder / "source.txt"
    source.write_text(MARKDOWN)
    path = folder / f"document.{kind}"
    command = ["pandoc", "-f", "markdown", source, "-s", "-t", kind, "-o", path]
    subprocess.run(command, check=True)
    return path


@needs_pandoc
@pytest.mark.parametrize("kind", ["html", "epub", "docx", "odt"])
def test_structure_is_kept(tmp_path, kind):
    path = written(tmp_path, kind)
    assert format_of(path) == kind
    document = read_structured_text(path)
    blocks = [(block.kind.value, block.level, block.text) for block in document.blocks]
    # Title pages and headers come before the first heading.
    assert blocks[-len(BLOCKS) :] == BLOCKS
    marked = {run.text: run.emphasis for block in document.blocks for run in block.runs}
    assert (marked["first"], marked["weight"]) == (Emphasis.ITALIC, Emphasis.BOLD)
    assert marked["Last"] == Emphasis.PLAIN
    # Of an ODT, pandoc reads no title.
    assert document.title == ("Tea and people" if kind != "odt" else "")


@needs_pandoc
def test_markdown_and_the_metadata_of_a_document(tmp_path):
    path = tmp_path / "a.md"
    path.write_text(MARKDOWN.partition("---\n\n")[2])
    blocks = read_structured_text(path).blocks
    assert [(block.kind.value, block.level, block.text) for block in blocks] == BLOCKS
    epub = read_structured_text(written(tmp_path, "epub"))
    assert sorted(epub.author.split(", ")) == ["A. Writer", "B. Other"]
    assert epub.language == "en"


@needs_pandoc
def test_nothing_else_is_opened_and_no_script_is_read(tmp_path):
    (tmp_path / "secret.html").write_text("<p>secret</p>")
    path = tmp_path / "page.html"
    path.write_text(
        f"<html><body><p>words</p><iframe src='{tmp_path}/secret.html'></iframe>"
        "<script>document.write('script')</script><style>p {}</style></body></html>"
    )
    assert read_structured_text(path).text == "words"


def test_without_pandoc(tmp_path, monkeypatch):
    path = tmp_path / "a.md"
    path.write_text("# Words")
    monkeypatch.setattr(structured_text.shutil, "which", lambda _name: None)
    with raises(PageError, names="pandoc") as refused:
        read_structured_text(path)
    assert "apt install pandoc" in refused.value.remedy


@needs_pandoc
def test_what_would_fill_the_memory_is_refused(tmp_path, monkeypatch):
    path = written(tmp_path, "docx")
    monkeypatch.setattr(structured_text, "MOST_UNPACKED_BYTES", 20_000)
    with raises(PageError):
        read_structured_text(path)


@needs_pandoc
def test_damaged_documents(tmp_path):
    path = written(tmp_path, "odt")
    path.write_bytes(path.read_bytes()[:2000])
    with raises(PageError):
        read_structured_text(path)


def test_what_has_no_structure(tmp_path):
    for name, data in (("a", b"# words"), ("a.txt", b"words"), ("a.html", b"\x00"), ("a.jpg", b"")):
        (tmp_path / name).write_bytes(data)
        assert format_of(tmp_path / name) is None
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as packed:
        packed.writestr("words.txt", "words")
    assert format_of(tmp_path / "a.zip") is None


PAGES = {
    "epub2": """<pageList><pageTarget type="normal"><navLabel><text>7</text></navLabel>
        <content src="text/ch001.xhtml#the-rest"/></pageTarget></pageList></ncx>""",
    "epub3": """<nav xmlns:epub="http://www.idpf.org/2007/ops" epub:type="page-list"><ol><li>
        <a href="text/ch001.xhtml#the-rest">7</a></li></ol></nav></body>""",
}


@needs_pandoc
@pytest.mark.parametrize("kind", PAGES)
def test_the_list_of_pages_of_an_epub(tmp_path, kind):
    made = written(tmp_path, kind)
    name, end = ("toc.ncx", "</ncx>") if kind == "epub2" else ("nav.xhtml", "</body>")
    path = tmp_path / "paged.epub"
    with zipfile.ZipFile(made) as before, zipfile.ZipFile(path, "w") as after:
        for each in before.infolist():
            content = before.read(each)
            if each.filename.endswith(name):
                assert end.encode() in content
                content = content.replace(end.encode(), PAGES[kind].encode())
            after.writestr(each, content)
    blocks = [(block.kind.value, block.text) for block in read_structured_text(path).blocks]
    assert blocks[blocks.index(("heading", "The rest")) - 1] == ("page", "7")
    assert read_structured_text(made).text == read_structured_text(path).text


@needs_pandoc
def test_rows_of_heads_are_known(tmp_path):
    heads = [block.text for block in read_structured_text(written(tmp_path, "html")).blocks
             if block.head]  # fmt: skip
    assert heads == ["Name; Price"]
