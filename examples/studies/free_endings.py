"""How far free endings are from firing, by where they lie, how thick they are, and what fires them.

``python examples/studies/free_endings.py 20`` prints, for 20 fingers of the paper's anatomy, the
factor on full comfort at which the first of a sample of each class fires under a T: medians, with
the middle 90 % of the fingers. Where free endings lie and how thick they are nobody has measured.
"""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parents[1]))
from studies.finger_effects import spread

from smarttouch.base.afferent import Mode
from smarttouch.base.terminal import print_table
from smarttouch.kernels.bank import load_bank
from smarttouch.physiology.anatomy import Anatomy, Bystander, load_anatomy
from smarttouch.physiology.spikes import NOCICEPTORS, Bystanders, margins
from smarttouch.profile import load_profile
from smarttouch.reading.legibility import letter_sequences

MODES = (Mode.RA, Mode.SAI, Mode.PC)
CHANGES: dict[str, dict[str, tuple[float, float]]] = {
    "as shipped": {},
    "0.35 mm deep": {"depth_mm": (0.35, 0.35)},
    "0.6 mm deep": {"depth_mm": (0.6, 0.6)},
    "half as thick": {"diameter_um": (0.5, 0.25)},
    "firing at 40 mV": {"threshold_mv": (40.0, 40.0)},
}
"""Values of Aδ and of C."""


def changed(anatomy: Anatomy, values: dict[str, tuple[float, float]]) -> Anatomy:
    """Return an anatomy whose Aδ and C have other values."""
    free = {each.name.lower(): anatomy.bystanders[each] for each in NOCICEPTORS}
    update = {
        name: one.model_copy(update={key: pair[index] for key, pair in values.items()})
        for index, (name, one) in enumerate(free.items())
    }
    return anatomy.model_copy(update=update)


def main(fingers: int) -> None:
    """Print a row for each change."""
    profile, anatomy = load_profile("electric-mouse"), load_anatomy("paper")
    bank, lines = load_bank(profile), []
    sent = {
        mode: [slots for slots, _ in letter_sequences("T", profile, bank, mode).values()]
        for mode in MODES
    }
    for name, values in CHANGES.items():
        those = changed(anatomy, values)
        every = [Bystanders(profile, seed, those) for seed in range(1, fingers + 1)]
        for mode, slots in sent.items():
            found = [margins(one, slots) for one in every]
            figures = [spread((one[each].margin for one in found), 2) for each in Bystander]
            lines.append([name, mode.value, *figures])
    print_table(lines, ["endings", "mode", *(each.name for each in Bystander)], left=2)


if __name__ == "__main__":
    main(int(sys.argv[1]))
