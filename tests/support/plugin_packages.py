"""Plug-in packages written to a folder as if pip had installed them."""

import tomllib
from pathlib import Path


def install(place, name, groups, modules, version="1.0"):
    """Write modules (texts by name) and metadata (entry points by group) into folder ``place``."""
    for module, text in modules.items():
        (place / f"{module}.py").write_text(text, encoding="utf-8")
    notes = place / f"{name.replace('-', '_')}-{version}.dist-info"
    notes.mkdir(parents=True)
    metadata = f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n"
    (notes / "METADATA").write_text(metadata, encoding="utf-8")
    lines = []
    for group, points in groups.items():
        lines += [f"[{group}]", *(f"{key} = {value}" for key, value in points.items())]
    (notes / "entry_points.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")


def install_project(folder, place):
    """Install the package in ``folder`` (pyproject.toml and modules) into folder ``place``."""
    project = tomllib.loads((folder / "pyproject.toml").read_text("utf-8"))["project"]
    modules = {
        path.stem: path.read_text("utf-8")
        for path in Path(folder).glob("*.py")
        if not path.stem.startswith("test_")
    }
    install(place, project["name"], project["entry-points"], modules, project["version"])
