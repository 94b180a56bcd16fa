"""The oracle shares no code with what proves sequences safe."""

import ast
import sys
from pathlib import Path

import pytest

HERE = Path(__file__).parent
ORACLE = ("bounds", "rules", "quick", "oracle", "deliveries")
"""The modules that judge; the others ask them, and the gate."""
MAY = (
    "smarttouch.profile",
    "smarttouch.profile.electrodes",
    "smarttouch.emulator.firmware",
    "smarttouch.emulator.skin",
)
"""What they may know of the package: data, geometry, and what an emulator wrote down."""


def imports_of(path):
    """Return the absolute names of everything a module imports, relative ones from `tests`."""
    names = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names += [each.name for each in node.names]
        elif isinstance(node, ast.ImportFrom):
            names.append("." * node.level + (node.module or ""))
    return names


@pytest.mark.parametrize("name", ORACLE)
def test_the_oracle_imports_nothing_of_the_gate(name):
    for imported in imports_of(HERE / f"{name}.py"):
        if imported.startswith("smarttouch"):
            assert imported in MAY
        elif imported.startswith("."):
            assert imported.lstrip(".") in ORACLE
            assert not imported.startswith("..")
        else:
            assert imported.split(".")[0] in {*sys.stdlib_module_names, "numpy"}
            assert imported != "importlib"
