"""The README's Python runs as it stands."""

import re
from pathlib import Path

import pytest

README = Path(__file__).parent.parent / "README.md"
BLOCKS = re.findall(r"^```python\n(.*?)^```$", README.read_text(encoding="utf-8"), re.M | re.S)


def test_there_is_some():
    assert len(BLOCKS) >= 2


@pytest.mark.parametrize("code", BLOCKS, ids=lambda code: code.split("\n")[0])
def test_it_runs(code, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    found = {}
    exec(compile(code, "README.md", "exec"), found)
    if "statistics" in found:
        assert found["statistics"].figures["emulator_violations"] == 0
        assert (tmp_path / "run.mcap").stat().st_size > 10_000
        assert found["step"].sequence.current_ua.shape[1] == 64
