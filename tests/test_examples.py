"""The scripts of examples/ run as they stand."""

import runpy
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parent.parent / "examples"


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.py")), ids=lambda path: path.stem)
def test_it_runs(path, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    found = runpy.run_path(str(path))
    assert found["statistics"].figures["emulator_violations"] == 0
    assert found["statistics"].frames == len(found["steps"]) > 40
    assert 0 < max(found["strongest_ma"]) <= found["profile"].limits.current_ma
    assert (tmp_path / f"{path.stem}.png").stat().st_size > 10_000
