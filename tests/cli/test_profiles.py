"""``smarttouch profiles``: what is shipped is shown and copied."""

import json
import tomllib

import pytest

from smarttouch.cli.options import RunOptions
from smarttouch.profile import list_profiles, load_profile
from smarttouch.profile.toml_files import profile_path


def one_sentence(done):
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr.count("\n") == 1
    return done.stderr


def test_all_are_listed(program_here):
    done = program_here("profiles").fine()
    for name in list_profiles():
        assert name in done.stdout
    assert "electric-mouse (default)" in done.stdout


def test_a_copy_is_the_file_with_its_comments(program_here, tmp_path):
    assert program_here("profiles new mine.toml --like line-7").returncode == 0
    assert (tmp_path / "mine.toml").read_bytes() == profile_path("line-7").read_bytes()
    refused = one_sentence(program_here("profiles new mine.toml --like line-8"))
    assert "mine.toml" in refused
    assert "--overwrite" in refused
    assert (tmp_path / "mine.toml").read_bytes() == profile_path("line-7").read_bytes()
    assert program_here("profiles new mine.toml --like line-8 --overwrite").returncode == 0
    assert (tmp_path / "mine.toml").read_bytes() == profile_path("line-8").read_bytes()


@pytest.mark.parametrize("name", ["electric-mouse", "kajimoto-61"])
def test_what_is_shown_is_a_profile(program_here, tmp_path, name):
    done = program_here("profiles show", name).fine()
    (tmp_path / f"{name}.toml").write_text(done.stdout)
    assert load_profile(tmp_path / f"{name}.toml") == load_profile(name)


def test_what_was_calibrated_is_shown_with_its_day(program_here):
    for what in ("force", "registration"):
        program_here("calibrate", what, "--simulate", "--output", "mine.toml").fine()
    shown = program_here("profiles show mine.toml").stdout
    assert {"force", "registration"} == tomllib.loads(shown)["calibrated"].keys()
    (curve,) = [line for line in shown.splitlines() if line.startswith("curve = ")]
    assert "# calibrated: force, 20" in curve


def with_defaults(path, **keys):
    text = profile_path("smarttouch-4x4").read_text("utf-8")
    lines = [f"{key} = {json.dumps(value)}" for key, value in keys.items()]
    path.write_text("\n".join([text, "[defaults]", *lines]), encoding="utf-8")


def test_board_form_and_plain_lines_come_from_the_profile(program_here, tmp_path):
    with_defaults(tmp_path / "mine.toml", board="memory:", plain=True, read_as="braille")
    read = ("read", "text:a", "--profile", "mine.toml")
    other = ("--board", "simulated:", "--set", "paced=no", "--as", "shapes")
    kept, given = program_here(*read), program_here(*read, *other)
    assert (kept.returncode, given.returncode) == (0, 0), given.stderr
    assert kept.stdout.splitlines()[0].endswith(", memory:")
    assert given.stdout.splitlines()[0].endswith(", simulated:")
    for done in (kept, given):
        assert "line 1 of 1: a\n" in done.stdout
        assert "1 line read: a\n" in done.stdout


def test_no_intensity_is_kept_in_a_profile(program_here, tmp_path):
    with_defaults(tmp_path / "mine.toml", intensity=0.5)
    assert "defaults.intensity" in one_sentence(program_here("live --profile mine.toml"))


@pytest.mark.parametrize(("kept", "given", "drawn"), [
    (True, None, False), (True, False, True), (False, None, True), (False, True, False),
])  # fmt: skip
def test_what_is_drawn(profile, kept, given, drawn, monkeypatch):
    shown = []
    monkeypatch.setattr(
        "smarttouch.views.terminal_session.run_in_terminal",
        lambda *_, plain, **more: shown.append(not plain),
    )
    own = profile.model_copy(update={"defaults": {"plain": kept}})
    run = RunOptions(board="memory:", plain=given)
    run.start(None, own, run.config("RA"))
    assert shown == [drawn]


def test_all_that_is_wrong_stands_in_a_line_of_its_own(program_here, tmp_path):
    text = profile_path("line-7").read_text(encoding="utf-8")
    wrong = text.replace("count = 7", "count = 1").replace("duty = 0.8", "duty = 8")
    (tmp_path / "mine.toml").write_text(wrong)
    done = program_here("profiles show mine.toml")
    assert done.returncode == 2
    lines = done.stderr.splitlines()
    assert len(lines) == 2
    assert all("mine.toml" in line for line in lines)
    assert "array.count" in lines[0]
    assert "limits.duty" in lines[1]


@pytest.mark.parametrize("arguments", [
    ("show", "nobody"), ("new", "mine.toml", "--like", "nobody"), ("new", "mine.txt"),
    ("new", "none/mine.toml"), ("new", "table.csv", "mine.toml", "--grid", "2x2"),
])  # fmt: skip
def test_what_cannot_be_is_one_sentence(program_here, tmp_path, arguments):
    one_sentence(program_here("profiles", *arguments))
    assert list(tmp_path.iterdir()) == []
