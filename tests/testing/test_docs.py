"""The packages of the how-tos, written by nothing but their code blocks, work."""

import pytest

from ..pages import ROOT, Reader


@pytest.mark.parametrize(("page", "commands"), [("own-board", 1), ("own-source", 2)])
def test_a_package_by_the_page_alone(page, commands, tmp_path):
    reader = Reader(tmp_path)
    reader.read(ROOT / "docs" / "how-to" / f"{page}.md")
    assert len(reader.done) == commands
    assert len([*(tmp_path / page).glob("*.py")]) == 2
