"""Words of the library."""

import re
from pathlib import Path

import smarttouch

PACKAGE = Path(smarttouch.__file__).parent
COMMANDS = ("cli/", "emulator/commands.py", "emulator/__main__.py")
STARTERS = {"emulator/emulated_boards.py", "reading/ocr.py", "pages/pandoc_text.py"}
"""Files that give other programs their options: the emulator, Tesseract and pandoc."""


def test_only_commands_know_options():
    found = {
        str(path.relative_to(PACKAGE))
        for path in PACKAGE.rglob("*.py")
        if re.search(r"(?<![-\w])--[a-z]", path.read_text())
    }
    assert {each for each in found if not each.startswith(COMMANDS)} == STARTERS
