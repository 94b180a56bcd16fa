"""Names that 1.0.0rc1 had answer with what to use instead."""

import subprocess
import sys
from pathlib import Path

import pytest

from smarttouch.base.errors import ProfileError, SourceError
from smarttouch.base.removed import COMMANDS, OPTIONS, PROFILE_KEYS, URLS
from smarttouch.profile import load_profile
from smarttouch.profile.toml_files import profile_path
from smarttouch.sources import open_source

PAGE = Path(__file__).parents[2] / "docs" / "install.md"


def refusal(*words):
    """Return what the command line says; it exits with 2."""
    command = [sys.executable, "-m", "smarttouch", *words]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "Traceback" not in done.stderr
    return " ".join(done.stderr.split())


@pytest.mark.parametrize(
    ("words", "instead"),
    [
        (("report",), COMMANDS["report"]),
        (("recordings", "view", "run.mcap"), COMMANDS["recordings"]),
        (("live", "--stream", "lsl:"), OPTIONS["--stream"]),
        (("live", "--stream=lsl:"), OPTIONS["--stream"]),
    ],
)
def test_a_removed_command_or_option_names_its_replacement(words, instead):
    assert instead in refusal(*words)


@pytest.mark.parametrize("name", URLS)
def test_a_removed_url_names_its_replacement(profile, name):
    with pytest.raises(SourceError, match="removed") as caught:
        open_source(f"{name}:x", profile)
    assert URLS[name] in str(caught.value)


def test_each_removed_key_of_a_profile_is_one_sentence(tmp_path):
    text = profile_path("electric-mouse").read_text("utf-8")
    path = tmp_path / "mine.toml"
    more = "\n[kernels]\nobjective = 'node'\nfingers = 3\n\n[skin.spread]\nra_depth_mm = 0.1\n"
    path.write_text(text + more, "utf-8")
    with pytest.raises(ProfileError) as caught:
        load_profile(path)
    found = dict(caught.value.complaints)
    for key in ("kernels.objective", "kernels.fingers", "skin.spread"):
        assert PROFILE_KEYS[key] in found[key]


def test_limits_and_masks_of_an_older_profile_count(tmp_path):
    text = profile_path("electric-mouse").read_text("utf-8")
    assert "\n[output]\n" in text
    assert "\ncurrent_ma = " in text
    path = tmp_path / "mine.toml"
    path.write_text(text.replace("\n[output]\n", "\n[output]\nmasked = [3, 5]\n"), "utf-8")
    profile = load_profile(path)
    assert profile.output.masked == (3, 5)
    assert profile.limits == load_profile("electric-mouse").limits
