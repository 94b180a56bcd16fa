"""
Compare arrays and modes on simulated fingers
=============================================

A *study* shows letters to many simulated fingers, in all combinations of profiles, anatomies, modes
and scans, and recognizes each letter from the spikes. ``smarttouch simulate study`` runs the study
of a file on all cores or on a Dask cluster. This program runs a small study in its own process.
"""

from pathlib import Path
from tempfile import TemporaryDirectory

from joblib import parallel_config

from smarttouch.lab import Study, run_study, study_sums, study_table

study = Study(
    title="Two arrays, two modes",
    profiles=("smarttouch-4x4", "electric-mouse"),
    anatomies=("paper",),
    modes=("RA", "SAI"),
    fingers=4,
    letters="HILOT",
)

# %%
# Run the study. It returns a row for each combination, finger and letter, and stores the rows in a
# folder: a second run with the same folder only simulates fingers that are missing there.
with TemporaryDirectory() as folder, parallel_config("threading", n_jobs=1):
    rows = run_study(study, Path(), Path(folder))
print(rows[0])

# %%
# Print four shares, as medians over fingers: misread letters, points without a spike of the target
# class nearby, spikes of other classes, and spikes more than a pitch away from every electrode of
# the letter. The last column is the mean total current of a slot.
heading, lines = study_table(study_sums(rows))
for line in [heading, *lines]:
    print("".join(cell.ljust(22 if column == 1 else 18) for column, cell in enumerate(line)))
