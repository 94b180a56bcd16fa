"""Profiles with any values: each is of use, or refused in one sentence."""

import os
import random

import numpy as np

from smarttouch.base.errors import ProfileError
from smarttouch.base.files import data_folder
from smarttouch.profile import load_profile

from ..raising import assert_says
from ..whole import WHOLE
from .shipped import SHIPPED

MUTANTS = int(os.environ.get("SMARTTOUCH_MUTANTS", "300" if WHOLE else "100"))

VALUES = (
    "nan", "inf", "-inf", "-1", "0", "1", "2", "65536", "1e30", "1e-30", "1e308", "9" * 30, '""',
    '"x"', "[]", "[0]", "[[0]]", "{}", "true", '"\\u001b[31m"', "[1, 2, 3]", "[nan, 0]",
    "[[nan, 0.0], [1.0, 1.0]]", "1979-05-27", "9" * 5000, "[" * 2000,
)  # fmt: skip


def test_no_mutant_is_more_than_one_sentence(tmp_path):
    refused = 0
    for seed in range(MUTANTS):
        chance = random.Random(seed)
        shipped = data_folder("calibration") / f"{chance.choice(sorted(SHIPPED))}.toml"
        lines = shipped.read_text(encoding="utf-8").split("\n")
        for _ in range(chance.choice((1, 1, 2, 4))):
            at = chance.randrange(len(lines))
            if "=" in lines[at] and chance.random() < 0.7:
                lines[at] = f"{lines[at].split('=')[0]}= {chance.choice(VALUES)}"
            elif chance.random() < 0.5:
                lines[at] = lines[chance.randrange(len(lines))]
            else:
                lines[at] += chr(chance.randrange(256))
        path = tmp_path / "mutant.toml"
        path.write_text("\n".join(lines), encoding="utf-8")
        try:
            profile = load_profile(path)
        except ProfileError as error:
            assert_says(error, about=bool)
            refused += 1
            continue
        # What is believed can be used, and kept in a recording.
        assert np.isfinite([*profile.full_ma, *profile.electrodes.position_mm.ravel()]).all()
        assert type(profile).model_validate_json(profile.model_dump_json()) == profile
    assert MUTANTS / 4 < refused < MUTANTS
