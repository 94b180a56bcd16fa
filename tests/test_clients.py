"""Tests of examples/clients: programs in other languages drive a run through its socket."""

import json
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

CLIENTS = Path(__file__).parent.parent / "examples" / "clients"
PROGRAM = Path(sys.executable).with_name("smarttouch")
COMMANDS = {
    "client.js": (["node", "client.js"], ["node"]),
    "Client.java": (["java", "Client.java"], ["java"]),
    "Client.cs": (["mono", "Client.exe"], ["mcs", "mono"]),
}


@pytest.mark.long
@pytest.mark.parametrize("name", COMMANDS)
def test_a_client_shows_puts_and_stops(name, tmp_path):
    command, programs = COMMANDS[name]
    if missing := [program for program in programs if shutil.which(program) is None]:
        pytest.skip(f"{missing[0]} is not installed")
    shutil.copy(CLIENTS / name, tmp_path)
    if "mcs" in programs:
        subprocess.run(["mcs", name], cwd=tmp_path, check=True, capture_output=True)
    options = ["--board", "simulated:", "--plain", "--json", "run.json"]
    with subprocess.Popen(
        [PROGRAM, "live", "socket:./touch", *options], cwd=tmp_path, stdout=subprocess.DEVNULL
    ) as run:
        try:
            until_s = time.monotonic() + 60
            while not (tmp_path / "touch").exists() and time.monotonic() < until_s:
                time.sleep(0.05)
            client = subprocess.run(
                [*command, "./touch"], cwd=tmp_path, capture_output=True, text=True, timeout=120
            )
            run.wait(60)
        finally:
            run.kill()
    assert client.returncode == 0, client.stderr
    assert "sequences" in client.stdout
    assert "dropped" in client.stdout
    statistics = json.loads((tmp_path / "run.json").read_text())
    assert run.returncode == 0
    assert statistics["slots"] > 0
