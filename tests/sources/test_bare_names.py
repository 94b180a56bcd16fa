"""Sources named without their kind: files, folders and words."""

from pathlib import Path

import numpy as np
import pytest

from smarttouch.base.errors import SourceError
from smarttouch.profile import load_profile
from smarttouch.sources import open_source, source_url


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("scan.png", "clip.MP4", "run.mcap", "why?", "notes.txt"):
        Path(name).write_text("some words", encoding="utf-8")
    Path("frames").mkdir()


@pytest.mark.parametrize(("name", "url"), [
    ("scan.png", "page:scan.png"), ("scan.png?dpi=300", "page:scan.png?dpi=300"),
    ("./scan.png", "page:./scan.png"), ("clip.MP4", "video:clip.MP4"),
    ("run.mcap", "recording:run.mcap"), ("frames", "frames:frames"), ("why?", "page:why?"),
    ("Hello", "text:Hello"), ("Is it so?", "text:Is it so?"), ("Note: this", "text:Note: this"),
    ("3:30 p.m.", "text:3:30 p.m."), ("camera:0", "camera:0"), ("radio:5", "radio:5"),
    ("", "text:"),
])  # fmt: skip
def test_one_reading(name, url):
    assert source_url(name) == url


@pytest.mark.parametrize(("name", "named"), [
    ("camera", "camera:"), ("camra", "camera:"), ("gone.png", "gone.png"), ("./gone", "gone"),
    ("gone.png?dpi=300", "gone.png"),
])  # fmt: skip
def test_what_may_be_a_slip_is_not_shown_as_words(name, named):
    with pytest.raises(SourceError, match=named):
        source_url(name)


def test_a_text_file_is_printed():
    profile = load_profile("electric-mouse")
    with open_source("notes.txt", profile) as shown, open_source("some words", profile) as typed:
        assert np.abs(shown.read(0).image - typed.read(0).image.astype(int)).mean() < 3
        assert shown.url == "page:notes.txt"
