"""Settings of a run are kept under a name, and found again as they were."""

import pytest

from smarttouch.afferent import Afferent
from smarttouch.errors import SavedRunError
from smarttouch.imaging.mapping import Tone
from smarttouch.running.config import RunConfig
from smarttouch.running.saved import SavedRun, load_run, save_run, saved_run_path, saved_runs
from smarttouch.stimulation.sharing import SlotPolicy

from ..raising import assert_says, raises

FULL = SavedRun(
    source="text:touch",
    board="simulated:",
    vibrators="vibrators:",
    force="fixed:0.5",
    profile="line-7",
    source_options={"speed_mm_s": 20.0, "size": (640, 480), "unpaced": True, "seed": 3},
    config=RunConfig(
        mode="natural",
        scan="points",
        rate_hz=40.0,
        seconds=3.0,
        softness=0.5,
        light_on_dark=True,
        tone=Tone(0.1, 0.4, True),
        measure=True,
        hold="charge",
        balance=True,
        seed=3,
        subject="S1",
        note="“noted”\n",
    ),
)


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    return tmp_path / "config" / "smarttouch" / "runs"


@pytest.mark.parametrize("run", [SavedRun(), FULL])
def test_they_are_found_again_as_they_were(run, folder):
    path = save_run("desk", run)
    assert path == folder / "desk.toml" == saved_run_path("desk")
    assert load_run("desk") == load_run(path) == run
    assert saved_runs() == ["desk"]


def test_intensity_is_not_kept():
    save_run("desk", SavedRun(config=RunConfig(intensity=0.7)))
    assert load_run("desk").config.intensity is None


def test_files_are_found_from_anywhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    named = SavedRun(
        source="page:letter.png",
        force="recorded:force.csv",
        profile="mine.toml",
        source_options={"path": "path.csv"},
    )
    save_run("desk", named)
    monkeypatch.chdir("/")
    found = load_run("desk")
    assert found.source == f"page:{tmp_path / 'letter.png'}"
    assert found.force == f"recorded:{tmp_path / 'force.csv'}"
    assert found.profile == str(tmp_path / "mine.toml")
    assert found.source_options["path"] == str(tmp_path / "path.csv")


def test_a_name_that_is_taken(folder):
    save_run("desk", FULL)
    with raises(SavedRunError, about="name", problem="exists", value="desk"):
        save_run("desk", SavedRun())
    assert load_run("desk") == FULL
    save_run("desk", SavedRun(), overwrite=True)
    assert load_run("desk") == SavedRun()


@pytest.mark.parametrize("name", ["", ".", "..", "../desk", "a/b", "a b", "-x", "x" * 65, "a\n"])
def test_what_is_no_name(name):
    for use in (load_run, lambda each: save_run(each, FULL)):
        with raises(SavedRunError, about="name", problem="malformed", value=name):
            use(name)


def test_a_name_that_nothing_is_kept_under():
    with raises(SavedRunError, about="name", problem="unknown", value="desk", allowed=()):
        load_run("desk")
    save_run("bench", FULL)
    with raises(SavedRunError, about="name", problem="unknown", value="desk", allowed=("bench",)):
        load_run("desk")


@pytest.mark.parametrize(
    ("text", "attributes"),
    [
        ("[config", {"about": "file", "problem": "malformed"}),
        ("surprise = 1", {"about": "surprise", "problem": "unknown", "value": 1}),
        ("board = 3", {"about": "board", "problem": "malformed", "value": 3}),
        ("[config]\nsurprise = 1", {"about": "config.surprise", "problem": "unknown"}),
        ('[config]\nrate_hz = "fast"', {"about": "config.rate_hz", "problem": "malformed"}),
        ("[config]\nrate_hz = nan", {"about": "config.rate_hz", "problem": "malformed"}),
        ('[config]\nmode = "x"', {"about": "config.mode", "problem": "unknown", "value": "x"}),
        ("[config]\nsoftness = 2", {"about": "config.softness", "value": 2}),
        ("[config]\nintensity = 0.5", {"about": "config.intensity", "problem": "impossible"}),
        ("[config]\nintensity = 5", {"about": "config.intensity"}),
        ('[config.scan]\nprimaries = ["RA"]\nplanned = true', {"about": "config.scan"}),
        ("[config.tone]\nfaintest = 0.1\nnothing = 1", {"about": "config.tone.nothing"}),
        ("[source_options]\nspeed_mm_s = [[1]]", {"about": "source_options.speed_mm_s.0"}),
        ("[config]\nmode = 3", {"about": "config.mode", "problem": "malformed", "value": 3}),
        ("[config]\nscan = 4", {"about": "config.scan", "problem": "malformed", "value": 4}),
    ],
)
def test_bad_files_are_one_sentence(folder, text, attributes):
    folder.mkdir(parents=True)
    (folder / "desk.toml").write_text(text)
    with pytest.raises(SavedRunError) as caught:
        load_run("desk")
    assert_says(caught.value, **attributes)
    assert str(folder / "desk.toml") in str(caught.value)


def test_all_that_is_wrong_is_told(folder):
    folder.mkdir(parents=True)
    (folder / "desk.toml").write_text('old = 1\nboard = 3\n[config]\nseed = "x"\n')
    with pytest.raises(SavedRunError) as caught:
        load_run("desk")
    assert {each.key for each in caught.value.complaints} == {"old", "board", "config.seed"}


def test_classes_that_share_slots_have_no_name():
    sharing = SlotPolicy((Afferent.RA,), planned=False)
    with raises(SavedRunError, about="scan", problem="impossible", value=sharing):
        save_run("desk", SavedRun(config=RunConfig(scan=sharing)))


def test_a_folder_that_cannot_be(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "file"))
    with raises(SavedRunError, about="file", problem="unwritable"):
        save_run("desk", FULL)
