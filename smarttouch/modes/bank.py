"""Kernels of every site and mode of a profile, designed once and kept."""

import hashlib
import json
import os
import tempfile
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from smarttouch.errors import DesignError
from smarttouch.primary import Primary
from smarttouch.profile import Profile
from smarttouch.resources import data_folder

DESIGN_VERSION = 1
"""Raised when the same problem would get other kernels."""

_WANTED = (Primary.RA, Primary.SAI)
_FIELDS = ("weights", "worst_other", "own_spill", "receptor")

Progress = Callable[[int, int], None]


@dataclass(frozen=True, eq=False)
class KernelBank:
    """What the scan looks up.

    Attributes
    ----------
    weights : dict of Primary to ndarray, (E, E) float32
        Row s is the kernel of site s: positive cathodic, peak magnitude 1,
        sum zero.
    worst_other, own_spill : dict of Primary to ndarray, (E,) float32
        Selectivity of each kernel, of its target's activation.
    receptor : dict of Primary to ndarray, (E, E) float32, V/mm² per mA
        Activating function at the target under electrode r for unit cathodic
        current at electrode e.
    """

    weights: dict[Primary, NDArray[np.float32]]
    worst_other: dict[Primary, NDArray[np.float32]]
    own_spill: dict[Primary, NDArray[np.float32]]
    receptor: dict[Primary, NDArray[np.float32]]

    def kernels(self, primary: Primary) -> NDArray[np.float32]:
        """Return the kernels of a mode.

        Raises
        ------
        DesignError
            If the board cannot make that mode.
        """
        if primary not in self.weights:
            offered = ", ".join(each.name for each in sorted(self.weights))
            raise DesignError(
                f"mode {primary.name} is not possible with this profile's board: "
                f"it offers {offered}"
            )
        return self.weights[primary]


def problem_hash(profile: Profile) -> str:
    """Return the hash of all that the kernels of a profile depend on."""
    problem = {
        "version": DESIGN_VERSION,
        "array": profile.array.model_dump(),
        "skin": profile.skin.model_dump(),
        "output": profile.output.model_dump(),
    }
    return hashlib.sha256(json.dumps(problem, sort_keys=True).encode()).hexdigest()


def load_bank(profile: Profile, progress: Progress | None = None) -> KernelBank:
    """Return the bank of a profile: shipped, from the user's cache, or designed now.

    Parameters
    ----------
    profile : Profile
        Whose bank.
    progress : callable, optional
        Told how many sites are designed, of how many, if any have to be.
    """
    import platformdirs

    key = problem_hash(profile)
    cached = platformdirs.user_cache_path("smarttouch") / f"{key}.npz"
    for path in (shipped_bank(profile.name), cached):
        bank = _read(path, key)
        if bank is not None:
            return bank
    bank = design_bank(profile, progress)
    try:
        cached.parent.mkdir(parents=True, exist_ok=True)
        write_bank(cached, profile, bank)
    except OSError:
        # Without a cache the next run designs again; that is slow, not wrong.
        pass
    return bank


def shipped_bank(name: str) -> Path:
    """Return where the bank of a shipped profile lies."""
    return data_folder("calibration") / "banks" / f"{name}.npz"


def design_bank(profile: Profile, progress: Progress | None = None) -> KernelBank:
    """Design RA and SAI for every site, as far as the board can make them."""
    from smarttouch.modes.design import Problem, design_all, design_kernel
    from smarttouch.modes.switching import design_one_against_all, design_three_state, polarity

    designs = {
        "weighted": design_kernel,
        "three-state": design_three_state,
        "one-against-all": design_one_against_all,
    }
    modes = [each for each in _WANTED if polarity(each) in profile.output.polarities]
    if profile.output.kind == "weighted":
        modes = list(_WANTED)
    columns: dict[str, dict[Primary, NDArray[np.float32]]] = {name: {} for name in _FIELDS}
    for index, primary in enumerate(modes):

        def advance(done: int, total: int, index: int = index) -> None:
            if progress is not None:
                progress(index * total + done, len(modes) * total)

        problem = Problem(profile, primary)
        kernels = design_all(problem, designs[profile.output.kind], advance)
        for name in ("weights", "worst_other", "own_spill"):
            values = [getattr(kernel, name) for kernel in kernels]
            columns[name][primary] = np.array(values, np.float32)
        columns["receptor"][primary] = problem.target.astype(np.float32)
    return KernelBank(**columns)


def write_bank(path: Path, profile: Profile, bank: KernelBank) -> None:
    """Write a bank whole or not at all."""
    columns = {
        f"{name}_{primary.name}": values
        for name in _FIELDS
        for primary, values in getattr(bank, name).items()
    }
    handle, temporary = tempfile.mkstemp(dir=path.parent, suffix=".npz")
    try:
        with os.fdopen(handle, "wb") as file:
            np.savez_compressed(file, key=np.array(problem_hash(profile)), **columns)
        Path(temporary).chmod(0o644)
        Path(temporary).replace(path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise


def _read(path: Path, key: str) -> KernelBank | None:
    """Return the bank in a file if it answers this very problem."""
    try:
        # Opened here: numpy leaves a file that is no archive open behind it.
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as file:
            if str(file["key"]) != key:
                return None
            columns: dict[str, dict[Primary, NDArray[np.float32]]] = {name: {} for name in _FIELDS}
            for name in file.files:
                field, _, primary = name.rpartition("_")
                if field in columns:
                    columns[field][Primary[primary]] = file[name]
            return KernelBank(**columns)
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        return None
