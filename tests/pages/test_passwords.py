"""Passwords come from a file, from standard input or a terminal, and never from arguments."""

import io
import sys

import pytest

from smarttouch.base.errors import PageError
from smarttouch.pages import document
from smarttouch.pages.document import password_of
from smarttouch.profile import load_profile
from smarttouch.sources import open_source

from .test_document import encrypted, one_page


class Terminal(io.StringIO):
    def isatty(self):
        return True


@pytest.fixture
def locked(tmp_path):
    path = tmp_path / "a.pdf"
    path.write_bytes(encrypted(b"0 144 144 144 re f", "tulip"))
    return path


def test_a_document_without_a_password_needs_none(tmp_path):
    path = tmp_path / "open.pdf"
    path.write_bytes(one_page())
    assert password_of(path) is None


def test_a_file_or_standard_input_has_it_in_its_first_line(locked, tmp_path, monkeypatch):
    (tmp_path / "word").write_text("tulip\nmore")
    assert password_of(locked, str(tmp_path / "word")) == "tulip"
    monkeypatch.setattr(sys, "stdin", io.StringIO("tulip\r\n"))
    assert password_of(locked, "-") == "tulip"
    for name in ("-", str(locked.with_name("empty"))):
        locked.with_name("empty").touch()
        with pytest.raises(PageError, match="no password in its first line"):
            password_of(locked, name)


def test_it_is_asked_for_at_a_terminal_alone(locked, monkeypatch):
    answers = ["rose", "tulip"]
    monkeypatch.setattr(document.getpass, "getpass", lambda *_: answers.pop(0))
    monkeypatch.setattr(sys, "stdin", io.StringIO())
    with pytest.raises(PageError, match="--password-file"):
        password_of(locked)
    monkeypatch.setattr(sys, "stdin", Terminal())
    assert password_of(locked) == "tulip"
    answers += ["rose"] * 9
    with pytest.raises(PageError, match="not its password"):
        password_of(locked)
    assert len(answers) == 6


def test_a_page_under_the_finger_opens_with_it(locked):
    locked.with_name("word").write_text("tulip")
    with open_source(
        f"page:{locked}?password_file={locked.with_name('word')}", load_profile("electric-mouse")
    ) as source:
        assert source.page.grey.size
