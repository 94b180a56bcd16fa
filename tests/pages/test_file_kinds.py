"""The kind of a file is known by its content, and by few names; what is not read is named."""

import io
import zipfile

import pytest

from smarttouch.base.errors import PageError
from smarttouch.pages.file_kinds import FileKind, file_kind, read_plain_text


def packed(*names, mimetype="", **contents):
    """Return a ZIP file with members of these names."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        if mimetype:
            archive.writestr("mimetype", mimetype)
        for name in names:
            archive.writestr(name, contents.get("content", "words"))
    return file.getvalue()


EPUB = "application/epub+zip"
ODF = "application/vnd.oasis.opendocument."
LOCKED = packed("META-INF/manifest.xml", mimetype=f"{ODF}text", content="<m:encryption-data/>")
FONTS = '<a Algorithm="http://www.idpf.org/2008/embedding"/>'


@pytest.mark.parametrize(("name", "data", "kind"), [
    ("a.md", "é".encode() * 2048, FileKind.STRUCTURED),
    ("a", b"<!DOCTYPE html><p>", FileKind.STRUCTURED),
    ("a", b'<?xml version="1.0"?>\n<html>', FileKind.STRUCTURED),
    ("a", packed("word/document.xml"), FileKind.STRUCTURED),
    ("a", packed("META-INF/encryption.xml", mimetype=EPUB, content=FONTS), FileKind.STRUCTURED),
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
    (b"<svg xmlns=''><text>a</text></svg>", "a drawing"), (b"<?xml?>\n<pef version=''>", "a PEF"),
    (b'<?xml version="1.0"?><!-- a --><svg/>', "a drawing"), (b"<?xml?><a/>", "an XML document"),
    (b"Subject: a\r\nX-B: c\r\n d\r\nMIME-Version: 1.0\r\n\r\nwords", "an e-mail"),
    (b"From a@b Mon\nReceived: from c\n\nwords", "an e-mail"), (b"BEGIN:VCARD\n", "a contact"),
    (b"% a\n\\documentclass{b}", "a LaTeX source"), (b'{"cells": []}', "a notebook"),
    (b"\xd0\xcf\x11\xe0old", "an old Office document"), (b"ID3\x03", "a sound"),
    (b"\xd0\xcf\x11\xe0" + "EncryptedPackage".encode("utf-16-le"), "locked by a password"),
    (packed("ppt/a.xml", "[Content_Types].xml"), "a presentation"), (packed("a"), "a packed file"),
    (packed("xl/a.xml"), "a spreadsheet"),
    (packed(mimetype=f"{ODF}presentation"), "a presentation"),
    (packed(mimetype=f"{ODF}spreadsheet"), "a spreadsheet"), (LOCKED, "locked by a password"),
    (packed("META-INF/rights.xml", mimetype=EPUB), "protected against copying"),
    (packed("word/document.xml")[:60], "damaged"), (b"\x1f\x8b\x08", "a packed file"),
    (b"\x00\x00\x00\x18ftypmp42", "a video"), (b"\x00\x00\x00\x18ftypheic", "a photograph"),
    (b"AT&TFORM\x00", "a DjVu document"), (b"\x7fELF", "a program"), (b"", "empty"),
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


@pytest.mark.parametrize("name", ["a.eml", "a.svg", "a.PEF"])
def test_a_few_names_tell_what_is_not_read(tmp_path, name):
    (tmp_path / name).write_bytes(b"words")
    with pytest.raises(PageError, match="which is not read"):
        file_kind(tmp_path / name)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le"])
def test_a_text_is_read_in_each_encoding(tmp_path, encoding):
    (tmp_path / "a").write_bytes("The old mill\r\n – by\rthe river".encode(encoding))
    assert read_plain_text(tmp_path / "a") == "The old mill\n – by\nthe river"
