"""Studies: the same rows however they are made, and what a plan may not contain."""

from pathlib import Path

import joblib
import pytest

from smarttouch.base.errors import ProfileError, SmartTouchError
from smarttouch.experiments import study_run
from smarttouch.experiments.study_plan import Grid, Study, from_csv, load_study, rows_of_finger
from smarttouch.experiments.study_run import STUDY_NAMES, study_figure, study_sums, study_table
from smarttouch.experiments.uncertainty import study_report
from smarttouch.physiology.anatomy import load_anatomy
from smarttouch.profile import load_profile

from ..raising import raises
from ..whole import sample

PLANS = sorted(Path(__file__).parents[2].glob("examples/studies/[!_]*.toml"))
SMALL = Study(
    title="small", profiles=("smarttouch-4x4",), anatomies=("paper",), fingers=3, letters="LT",
    modes=("RA", "SAI"), intensities=(0.5, 1.0),
)  # fmt: skip


@pytest.fixture(scope="module", autouse=True)
def one_process():
    with joblib.parallel_config("threading", n_jobs=1):
        yield


@pytest.fixture(scope="module")
def rows(tmp_path_factory):
    return study_run.run_study(SMALL, Path(), tmp_path_factory.mktemp("whole"))


def test_each_finger_gets_each_letter_in_each_choice(rows):
    assert len(rows) == 3 * 2 * 2 * 2
    assert len({(row.finger, row.mode, row.intensity, row.pattern) for row in rows}) == len(rows)
    assert [row.finger for row in rows] == sorted(row.finger for row in rows)
    full, half = (
        [row for row in rows if row.intensity == each and row.mode == "RA"] for each in (1.0, 0.5)
    )
    assert sum(row.spikes for row in full) > sum(row.spikes for row in half)
    assert full[0].total_ma == pytest.approx(2 * half[0].total_ma, rel=0.01)


def test_a_study_goes_on_where_it_was_interrupted(rows, tmp_path, monkeypatch):
    def interrupt(done, _total):
        if done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        study_run.run_study(SMALL, Path(), tmp_path, progress=interrupt)
    assert not (tmp_path / study_run.ROWS_FILE).exists()
    made = []
    assert (
        study_run.run_study(SMALL, Path(), tmp_path, progress=lambda *done: made.append(done))
        == rows
    )
    assert made == [(3, 3)]
    assert from_csv((tmp_path / study_run.ROWS_FILE).read_text()) == rows


def test_more_fingers_are_added_to_those_that_are_there(rows, tmp_path):
    fewer = SMALL.model_copy(update={"fingers": 2})
    assert study_run.run_study(fewer, Path(), tmp_path) == [row for row in rows if row.finger <= 2]
    made = []
    assert (
        study_run.run_study(SMALL, Path(), tmp_path, progress=lambda *done: made.append(done))
        == rows
    )
    assert made == [(3, 3)]


@pytest.mark.parametrize("broken", ["finger,letter\n1,L\n", 'finger\n"' + 200_000 * "x"])
def test_a_broken_part_is_made_again(tmp_path, broken):
    one = SMALL.model_copy(update={"fingers": 1, "intensities": (1.0,), "modes": ("RA",)})
    found = study_run.run_study(one, Path(), tmp_path)
    (part,) = (tmp_path / "parts").iterdir()
    part.write_text(broken)
    assert study_run.run_study(one, Path(), tmp_path) == found


def test_the_summary_is_by_choice(rows):
    found = study_sums(rows)
    assert [each.label for each in found] == ["RA, 0.5", "RA, 1", "SAI, 0.5", "SAI, 1"]
    assert all(0 <= each.best <= 1 for each in found)
    heading, lines = study_table(found)
    assert {len(line) for line in lines} == {len(heading)}
    figure = study_figure(found, STUDY_NAMES, "small")
    assert len(figure.axes) == len(STUDY_NAMES)


@pytest.mark.parametrize("plan", sample(PLANS), ids=lambda each: each.stem)
def test_the_plans_of_the_documentation_s_tables_run(tmp_path, plan):
    study = load_study(plan)
    few = {"kernels": ("node",), "anatomies": study.anatomies[:2], "fingers": 1, "letters": "T"}
    short = study.model_copy(update=few | {"uncertain": min(study.uncertain, 2)})
    rows = study_run.run_study(short, plan.parent, tmp_path)
    assert {row.anatomy.partition("#")[0] for row in rows} == set(short.anatomies)
    assert study_report(short, plan.parent, rows).lines


def test_a_page_is_read_on_fingers(tmp_path):
    page = Study(
        title="page", anatomies=("paper",), fingers=1, letters="", pages=("text:it",),
    )  # fmt: skip
    try:
        (row,) = study_run.run_study(page, Path(), tmp_path)
    except SmartTouchError as error:
        if "Tesseract" in str(error):
            pytest.skip(str(error))
        raise
    assert (row.pattern, row.finger) == ("text:it", 1)
    assert row.error >= 0
    assert 0 <= row.silent_points <= 1


def test_at_its_own_level_a_finger_s_absolute_thresholds_do_not_matter(tmp_path):
    rows = []
    for factor in (0.8, 1.6):
        anatomy = load_anatomy("paper")
        hard = {
            each: getattr(anatomy, each).model_copy(
                update={"threshold_factor": factor * getattr(anatomy, each).threshold_factor}
            )
            for each in ("ra", "sai", "pc")
        }
        shown = Grid(SMALL.model_copy(update={"levels": ("own",)}), Path()).shown("smarttouch-4x4")
        profile = load_profile("smarttouch-4x4")
        rows.append(rows_of_finger(profile, anatomy.model_copy(update=hard), "paper", 1, shown[:1]))
    assert [row.ra for row in rows[0]] == [row.ra for row in rows[1]]
    assert rows[1][0].total_ma == pytest.approx(2 * rows[0][0].total_ma, rel=0.01)


def test_a_long_text_is_a_page_and_no_file(tmp_path):
    text = "text:" + 300 * "it "
    assert Grid(SMALL, tmp_path).file(text) == text


@pytest.mark.parametrize(("text", "about"), [
    ('title = "x"\nfinger = 3', "finger"),
    ('title = "x"\nletters = "ABC1"', "letters"),
    ('title = "x"\nletters = ""', "letters"),
    ('title = "x"\nkernels = ["best"]', "kernels"),
    ('title = "x"\nintensities = [2.0]', "intensities"),
    ("fingers = 2", "title"),
    ('title = "x"\nlevels = ["own"]\npages = ["text:it"]', "levels"),
])  # fmt: skip
def test_a_plan_that_makes_no_sense_is_refused(tmp_path, text, about):
    plan = tmp_path / "study.toml"
    plan.write_text(text)
    with raises(ProfileError, key=about):
        load_study(plan)


def test_kernels_on_fingers_need_a_board_that_makes_them(tmp_path):
    with raises(ProfileError, key="kernels.objective"):
        study_run.run_study(SMALL.model_copy(update={"kernels": ("finger",)}), Path(), tmp_path)
