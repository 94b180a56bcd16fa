"""What is only looked at goes on until it is ended; what is kept or piped ends by itself."""

import os
import pty
import subprocess
import time

from ..forks import PROGRAM, Forked


def lasts(*options, seconds):
    """Run a short text with its output at a terminal; return whether it still runs after a time."""
    ours, terminal = pty.openpty()
    words = [PROGRAM, "live", "text:i?speed_mm_s=400", "--board", "simulated:", *options]
    with Forked(
        words, stdin=subprocess.DEVNULL, stdout=terminal, stderr=subprocess.PIPE, text=True
    ) as run:
        os.close(terminal)
        os.set_blocking(ours, False)
        until_s = time.monotonic() + seconds
        try:
            while run.poll() is None and time.monotonic() < until_s:
                time.sleep(0.05)
                try:
                    os.read(ours, 1 << 16)
                except OSError:
                    continue
            return run.poll() is None
        finally:
            run.terminate()
            run.wait(30)
            os.close(ours)


def test_on_a_screen_it_is_read_again(monkeypatch):
    monkeypatch.setenv("TERM", "xterm")
    begun_s = time.monotonic()
    assert not lasts("--plain", seconds=60), "this is read once"
    assert lasts(seconds=1 + 2 * (time.monotonic() - begun_s))


def test_what_is_kept_is_read_once(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert not lasts("--json", "f.json", seconds=60)
