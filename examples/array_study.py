"""
Arrays and scans compared
=========================

A *study* puts letters on many simulated fingers in every combination of what is asked for, and
reads them from the spikes. ``smarttouch simulate study`` runs one from a file, on all cores or on
a Dask cluster; here a small one is run in this process.
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
# One row for each finger and letter. Run again with the same folder, only what is missing is felt.
with TemporaryDirectory() as folder, parallel_config("threading", n_jobs=1):
    rows = run_study(study, Path(), Path(folder))
print(rows[0])

# %%
# Medians over fingers: how many letters are misread, how many points are silent, how many spikes
# are of another class, and how many are felt beyond a pitch of every electrode of the letter.
found = study_sums(rows)
heading, lines = study_table(found)
for line in [heading, *lines]:
    print("".join(cell.ljust(24 if column == 1 else 11) for column, cell in enumerate(line)))
