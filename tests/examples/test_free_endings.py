"""Free endings nearer to the electrodes, or thicker, fire first: the study in short."""

import re

from studies.free_endings import CHANGES, changed, main

from smarttouch.base.afferent import Mode
from smarttouch.kernels.bank import load_bank
from smarttouch.physiology.anatomy import Bystander, load_anatomy
from smarttouch.physiology.spikes import Bystanders, margins
from smarttouch.reading.legibility import letter_sequences


def test_depth_thickness_and_threshold_move_the_margin(profile):
    ((slots, _),) = letter_sequences("T", profile, load_bank(profile), Mode.RA).values()

    def margin(change: str) -> float:
        anatomy = changed(load_anatomy("paper"), CHANGES[change])
        return margins(Bystanders(profile, 1, anatomy), [slots])[Bystander.A_DELTA].margin

    shipped = margin("as shipped")
    assert margin("0.35 mm deep") < shipped < margin("0.6 mm deep")
    assert shipped < margin("half as thick") < margin("firing at 40 mV")


def test_the_table_has_each_change_in_each_mode(capsys):
    main(1)
    _, *lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 3 * len(CHANGES)
    # SAII, Aδ and C under anodic kernels, and under cathodic ones, which lie far nearer.
    ((ra, sai),) = (
        [[float(one) for one in re.findall(r"(\d+\.\d\d) \(", line)] for line in lines[:2]],
    )
    assert ra[1] > 4 * sai[1]
    assert ra[2] > 4 * sai[2]
