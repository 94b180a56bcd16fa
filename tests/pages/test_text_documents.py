"""Text files: detection of their kind, messages about unsupported kinds, text of documents."""

import io
import shutil
import subprocess
import zipfile

import pytest
from PIL import Image

from smarttouch.base.errors import PageError
from smarttouch.pages import text_documents
from smarttouch.pages.text_documents import FileKind, file_kind, read_document_text, read_plain_text


def packed(*names, mimetype=""):
    """Return a ZIP file with members of these names; its bytes are identical in each call."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        if mimetype:
            archive.writestr(zipfile.ZipInfo("mimetype"), mimetype)
        for name in names:
            archive.writestr(zipfile.ZipInfo(name), "words")
    return file.getvalue()


EPUB = "application/epub+zip"
ODF = "application/vnd.oasis.opendocument."


@pytest.mark.parametrize(("name", "data", "kind"), [
    ("a.md", "é".encode() * 2048, FileKind.STRUCTURED),
    ("a", b"<!DOCTYPE html><p>", FileKind.STRUCTURED),
    ("a", b'<?xml version="1.0"?>\n<html>', FileKind.STRUCTURED),
    ("a", packed("word/document.xml"), FileKind.STRUCTURED),
    ("a", packed(mimetype=EPUB), FileKind.STRUCTURED),
    ("a", b"x" + "é".encode() * 2048, FileKind.TEXT),
    ("a.txt", b"\x00", FileKind.TEXT), ("a.txt", b"{\\rtf1", FileKind.TEXT),
    ("a", b"\xffabc", FileKind.TEXT), ("a", "words".encode("utf-16"), FileKind.TEXT),
    ("a", "words".encode("utf-16-be"), FileKind.TEXT), ("a", b"From: here on", FileKind.TEXT),
    ("a.brf", b"ABC", FileKind.BRF), ("a.BRL", b"ABC", FileKind.BRF),
    ("a.ueb", b"ABC", FileKind.BRF), ("a.bfm", b"ABC", FileKind.BRF),
    ("a", b"\x89PNG\r\n\x1a\n", FileKind.PAGES), ("a", b"%PDF-1.4\nplain", FileKind.PAGES),
    ("a", b"a\x00b", FileKind.PAGES), ("a.html", b"a\x00b", FileKind.PAGES),
])  # fmt: skip
def test_kinds_of_files(tmp_path, name, data, kind):
    (tmp_path / name).write_bytes(data)
    assert file_kind(tmp_path / name) is kind


@pytest.mark.parametrize(("data", "kind"), [
    (b"{\\rtf1 words}", "an RTF document"), (b"%!PS-Adobe", "a PostScript file"),
    (b"<svg xmlns=''><text>a</text></svg>", "an XML"), (b"<?xml?>\n<pef version=''>", "a PEF"),
    (b'<?xml version="1.0"?><!-- a --><svg/>', "an XML"), (b"<?xml?><a/>", "an XML document"),
    (b"Subject: a\r\nX-B: c\r\n d\r\nMIME-Version: 1.0\r\n\r\nwords", "an e-mail"),
    (b"From a@b Mon\nReceived: from c\n\nwords", "an e-mail"), (b"BEGIN:VCARD\n", "a contact"),
    (b"% a\n\\documentclass{b}", "a LaTeX source"), (b'{"cells": []}', "a notebook"),
    (b"\xd0\xcf\x11\xe0old", "an old or locked Office"),
    (packed("ppt/a.xml", "[Content_Types].xml"), "a presentation"), (packed("a"), "a packed file"),
    (packed("xl/a.xml"), "a spreadsheet"),
    (packed(mimetype=f"{ODF}presentation"), "a presentation"),
    (packed(mimetype=f"{ODF}spreadsheet"), "a spreadsheet"),
    (b"", "empty"),
])  # fmt: skip
def test_what_is_not_read_is_named_with_what_to_do(tmp_path, data, kind):
    path = tmp_path / "a"
    path.write_bytes(data)
    with pytest.raises(PageError) as caught:
        file_kind(path)
    words = str(caught.value)
    assert words.startswith(f"{path} is {kind}")
    assert ": " in words
    assert "\n" not in words


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le"])
def test_a_text_is_read_in_each_encoding(tmp_path, encoding):
    (tmp_path / "a").write_bytes("The old mill\r\n – by\rthe river".encode(encoding))
    assert read_plain_text(tmp_path / "a") == "The old mill\n – by\nthe river"


needs_pandoc = pytest.mark.skipif(shutil.which("pandoc") is None, reason="pandoc is not installed")

SOURCE = """---
title: Tea and people
author: [A. Writer, B. Other]
---

# The *first* part

Words with **weight** and a
second line, 10^6^ of H~2~O[^1].

- one
- two
    1. small
    2. smaller

[^1]: Not more.

| Stop   | Sat  | Sun  |
|--------|------|------|
| Mill   | 8:05 |      |
| Bridge |      | 9:12 |
"""
TEXT = """The first part
Words with weight and a second line, 10^6 of H_2O (Not more.).
- one
- two
1. small
2. smaller
Stop; Sat; Sun
Mill; 8:05; -
Bridge; -; 9:12"""


def read(path):
    notes = []
    return read_document_text(path, notes.append), notes


def written(folder, kind, source=SOURCE):
    """Convert Markdown to a file of this kind with pandoc, and return its path."""
    path = folder / f"document.{kind}"
    if kind == "md":
        path.write_text(source)
    else:
        command = ["pandoc", "-f", "markdown", "-s", "--mathml", "-t", kind, "-o", path]
        subprocess.run(command, input=source, text=True, check=True)
    return path


@needs_pandoc
@pytest.mark.parametrize("kind", ["html", "epub", "docx", "odt", "md"])
def test_a_document_is_plain_paragraphs(tmp_path, kind):
    path = written(tmp_path, kind)
    text, notes = read(path)
    mark = {"html": "^1", "epub": ""}.get(kind, " (Not more.)")
    assert text.startswith("Tea and people\n")
    assert TEXT.replace(" (Not more.)", mark) in text
    assert "Not more." in text
    assert notes == []


MARKS = {
    "10<sup>6</sup>": "10^6",
    "10<sup>6</sup>5": "10^(6)5",
    "e<sup>-<b>12</b></sup>": "e^-12",
    "e<sup>a+b</sup>": "e^(a+b)",
    "H<sub>2</sub>O": "H_2O",
    "21<sup>st</sup>": "21st",
    "now <del>old</del>": "now (struck out: old)",
    "one<br>two": "one\ntwo",
}


@needs_pandoc
@pytest.mark.parametrize("markup", MARKS)
@pytest.mark.parametrize("suffix", ["html", "md"])
def test_raised_lowered_and_struck_out_text_is_marked(tmp_path, markup, suffix):
    if suffix == "md" and "<del>" in markup:
        markup, expected = "now ~~old~~", MARKS[markup]
    else:
        expected = MARKS[markup]
    path = tmp_path / f"a.{suffix}"
    path.write_text(markup)
    assert read(path) == (expected, [])


@needs_pandoc
@pytest.mark.parametrize("kind", ["html", "docx", "odt", "md"])
def test_formulas_and_pictures_are_named(tmp_path, kind):
    picture = tmp_path / "a.png"
    Image.new("L", (9, 9)).save(picture)
    source = (
        f"---\ntitle: T\n---\nArea $\\frac{{1}}{{2}}$ and $\\sqrt{{x}}$\n\n![a cat]({picture})\n"
    )
    text, notes = read(written(tmp_path, kind, source))
    place = "(embedded object)" if kind == "odt" else "(formula)"
    assert text.startswith(f"T\nArea {place} and {place}\n")
    formulas = (
        "text boxes, frames) are left out: 2"
        if kind == "odt"
        else (r"2 formulas are left out: \frac{1}{2}, \sqrt{x}")
    )
    assert "1 picture is left out" in notes
    assert any(note.endswith(formulas) for note in notes)


@needs_pandoc
@pytest.mark.parametrize(("suffix", "formulas", "text"), [
    ("html", r"\frac{1}{2}bh, \sqrt{x}",
     r"<p>Area \(\frac{1}{2}bh\) and \[\sqrt{x}\] for $5 and $6, x<sup>2</sup></p>"),
    ("html", r"\frac{a}{b}, \frac{1}{b}",
     r"<p>Area <img src='a.svg' alt='\frac{a}{b}'> and <span><math><mfrac><mn>1</mn>"
     r"<mi>b</mi></mfrac></math><span aria-hidden='true'>1 b</span></span> for $5 and $6,"
     r" $x^{2}$</p>"),
    ("md", r"\frac{1}{2}bh, \sqrt{x}",
     r"Area \(\frac{1}{2}bh\) and $\sqrt{x}$ for $5 and $6, \(x^2\)"),
])  # fmt: skip
def test_no_tex_stays_and_each_formula_is_named(tmp_path, suffix, formulas, text):
    path = tmp_path / f"a.{suffix}"
    path.write_text(text)
    found, notes = read(path)
    assert found.replace("²", "^2") == "Area (formula) and (formula) for $5 and $6, x^2"
    assert notes == ["2 formulas are left out: " + formulas]


@needs_pandoc
@pytest.mark.parametrize(("kind", "member", "text"), [
    ("docx", "word/header1.xml", "<w:hdr><w:t>Mill</w:t></w:hdr>"),
    ("docx", "word/footer2.xml", "<w:ftr><w:p/></w:ftr>"),
])  # fmt: skip
def test_headers_and_footers_are_named(tmp_path, kind, member, text):
    path = written(tmp_path, kind)
    with zipfile.ZipFile(path, "a") as packed:
        packed.writestr(member, text)
    notes = read(path)[1]
    assert notes == ["headers and footers of its pages are left out: 1"] * ("Mill" in text)


@needs_pandoc
def test_a_row_keeps_its_cells_below_a_tall_cell(tmp_path):
    path = tmp_path / "a.md"
    path.write_text("<table><tr><td rowspan=2>in<td>3<td></td></tr><tr><td><td>4</td></tr></table>")
    assert read(path) == ("in; 3; -\n-; -; 4", [])


@needs_pandoc
def test_html_names_what_it_hides_and_opens_nothing_else(tmp_path):
    (tmp_path / "secret.html").write_text("<p>secret</p>")
    path = tmp_path / "page.html"
    path.write_text(
        f"<html><body><p>wo<span role='doc-pagebreak'>7</span>rds</p><iframe src='{tmp_path}/"
        "secret.html'></iframe><script>document.write('script')</script></body></html>"
    )
    text, (page, embedded) = read(path)
    assert text == "words"
    assert page == "1 page number of print is left out"
    assert embedded.endswith(": 1")


@needs_pandoc
def test_damaged_large_and_foreign_documents_are_refused(tmp_path, monkeypatch):
    damaged = tmp_path / "damaged.odt"
    damaged.write_bytes(written(tmp_path, "odt").read_bytes()[:2000])
    latin = tmp_path / "latin.md"
    latin.write_bytes(b"caf\xe9")
    large = written(tmp_path, "docx")
    monkeypatch.setattr(text_documents, "MOST_UNPACKED_BYTES", 20_000)
    refusals = [(damaged, "damaged"), (latin, r"UTF-8 \(byte 4\)"), (large, "unpack")]
    for path, words in refusals:
        with pytest.raises(PageError, match=words):
            read(path)


def test_without_pandoc_it_is_named(tmp_path, monkeypatch):
    path = tmp_path / "a.md"
    path.write_text("# Words")
    monkeypatch.setattr(text_documents.shutil, "which", lambda _name: None)
    with pytest.raises(PageError, match="apt install pandoc"):
        read(path)
