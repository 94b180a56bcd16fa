"""Profiles that differ from a shipped one in a few words."""

import pytest

from smarttouch.base.files import data_folder


@pytest.fixture
def edited(tmp_path):
    def edit(*changes):
        text = (data_folder("calibration") / "electric-mouse.toml").read_text(encoding="utf-8")
        for old, new in changes:
            assert old in text
            text = text.replace(old, new, 1)
        path = tmp_path / "mine.toml"
        path.write_text(text, encoding="utf-8")
        return path

    return edit
