"""The kind of a file is known by its content, and by few names."""

import pytest

from smarttouch.base.errors import BrailleError
from smarttouch.pages.file_kinds import FileKind, file_kind


@pytest.mark.parametrize(("name", "data", "kind"), [
    ("a.md", "é".encode() * 2048, FileKind.STRUCTURED),
    ("a", b"<!DOCTYPE html><p>", FileKind.STRUCTURED),
    ("a", b"x" + "é".encode() * 2048, FileKind.TEXT),
    ("a.brf", b"ABC", FileKind.BRF),
    ("a.txt", b"\x00", FileKind.TEXT),
    ("a", b"\x89PNG\r\n\x1a\n", FileKind.PAGES),
    ("a", b"%PDF-1.4\nplain", FileKind.PAGES),
    ("a", b"\xffabc", FileKind.PAGES),
    ("a", b"a\x00b", FileKind.PAGES),
    ("a", b"", FileKind.TEXT),
])  # fmt: skip
def test_kinds_of_files(tmp_path, name, data, kind):
    (tmp_path / name).write_bytes(data)
    assert file_kind(tmp_path / name) is kind


@pytest.mark.parametrize("name", ["a.pef", "a.dat"])
def test_pef_is_refused(tmp_path, name):
    (tmp_path / name).write_bytes(b'<?xml version="1.0"?>\n<pef version="2008-1">')
    with pytest.raises(BrailleError, match=rf"{name} is a PEF file.*\.brf"):
        file_kind(tmp_path / name)
