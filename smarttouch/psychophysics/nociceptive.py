"""Margins of letters at full comfort to what must not fire: SAII, Aδ and C fibers."""

from collections.abc import Sequence
from statistics import median

from smarttouch.afferent import Mode
from smarttouch.kernels.bank import KernelBank
from smarttouch.physiology.anatomy import Anatomy
from smarttouch.physiology.bystanders import Bystanders, margins, nociceptive_margin
from smarttouch.profile import Profile
from smarttouch.psychophysics.letters import ALPHABET
from smarttouch.psychophysics.letters_felt import letter_sequences


def bystander_margins(
    profile: Profile,
    bank: KernelBank,
    mode: Mode,
    anatomy: str | Anatomy,
    seeds: Sequence[int],
    letters: str = ALPHABET,
) -> dict[str, float]:
    """Return the factor on all currents at which the first of each class fires, and the smaller of
    Aδ and C as "nociceptive".

    Medians over fingers, of the worst letter each; above 1 none fires at full comfort. Infinite
    where no legal currents fire it.
    """
    shown = [each for each, _ in letter_sequences(letters, profile, bank, mode).values()]
    rows: list[dict[str, float]] = []
    for seed in seeds:
        found = margins(Bystanders(profile, seed, anatomy), shown)
        row = {each.name: one.margin for each, one in found.items()}
        rows.append(row | {"nociceptive": nociceptive_margin(found)})
    return {name: median(row[name] for row in rows) for name in rows[0]}
