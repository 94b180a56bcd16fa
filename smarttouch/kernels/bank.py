"""Kernel bank: the kernels of all sites and classes of a profile, designed once and stored."""

import contextlib
import hashlib
import json
import os
import shutil
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import DesignError
from smarttouch.base.files import (
    MOST_BANK_BYTES,
    data_folder,
    make_folder,
    open_file,
)
from smarttouch.profile import Profile, list_profiles, load_profile

if TYPE_CHECKING:
    from smarttouch.kernels.batch_design import Timed
    from smarttouch.kernels.design_problem import Kernel, KernelKind, Problem

DESIGN_VERSION = 3  # increase it when a change of the code leads to other kernels
_IN_FILE = {  # attribute of KernelBank: its name in files
    "weights": "weights", "off_target": "worst_other", "worst_class": "worst_class",
    "spill": "own_spill", "gap": "gap", "seconds": "seconds", "receptor": "receptor",
}  # fmt: skip

Column = dict[Afferent, NDArray[Any]]
Progress = Callable[[int, int], None]


@dataclass(frozen=True, eq=False)
class KernelBank:
    """Kernels of all sites of a profile, by class."""

    def __repr__(self) -> str:
        kinds = ", ".join(
            f"{afferent.name} {weights.shape}" for afferent, weights in self.weights.items()
        )
        return f"KernelBank({kinds})"

    weights: Column  # (E, E) mA per V/mm²: row s is the kernel of site s, sum 0; zeros if masked
    off_target: Column  # (E,) largest activation of another class, relative to the target
    worst_class: Column  # (E,) int8, the other class that is activated most
    # (E,) largest activation of the same class at nodes over a pitch away, relative to the target
    spill: Column
    gap: Column  # (E,) largest possible relative distance from the optimum; 0 if proven optimal
    seconds: Column  # (E,) float32, design time
    receptor: Column  # (E, E) float32, V/mm² per mA: [r, e] is the AF at target r from electrode e
    # Classes whose kernels are one electrode against all others (`single_bank`)
    discs: tuple[Afferent, ...] = ()

    def kernels(self, afferent: Afferent) -> NDArray[np.float32]:
        """Return the kernels of a class, (E, E), each scaled to a peak of 1; masked sites are zero.

        Raises DesignError if the board cannot stimulate the class.
        """
        weights = self._weights_of(afferent)
        peak = np.abs(weights).max(axis=1, keepdims=True)
        return np.asarray(weights / np.where(peak > 0, peak, 1.0), np.float32)

    def kernel(self, afferent: Afferent, site: int, kind: "KernelKind") -> "Kernel":
        """Return one kernel. Raises DesignError for a masked site or a class without kernels."""
        from smarttouch.kernels.design_problem import Kernel, masked_site

        weights = self._weights_of(afferent)[site]
        if not weights.any():
            raise masked_site(site)
        return Kernel(
            weights=weights,
            off_target=float(self.off_target[afferent][site]),
            off_target_class=Afferent(int(self.worst_class[afferent][site])),
            spill=float(self.spill[afferent][site]),
            kind=kind,
            gap=float(self.gap[afferent][site]),
        )

    def responses(
        self,
        profile: Profile,
        afferents: Sequence[Afferent],
        numbers: NDArray[np.uint32],
        width_us: NDArray[np.float32],
        current_ua: NDArray[np.int16],
    ) -> dict[int, NDArray[np.float32]]:
        """Return a dictionary: for each sequence number, the responses of the receptors under the
        electrodes, (E,).

        A response is 0 at the detection threshold and 1 at the strongest comfortable pulse. The
        response to a sequence is the largest over its slots and classes. ``numbers``, (N,), has the
        sequence number of each slot. ``current_ua``, (N, E), is positive cathodic.
        """
        from smarttouch.physiology.finger import strength

        if not len(numbers):
            return {}
        chronaxie_us, full_ua = profile.pulse.chronaxie_us, profile.full_ma * 1000
        reach = strength(width_us, chronaxie_us) / strength(profile.pulse.width_us, chronaxie_us)
        current, activation = current_ua * reach[:, None], []
        for afferent in afferents:
            receptor = self.receptor[afferent]
            full = full_ua * (receptor * self.kernels(afferent)).sum(axis=1)
            # Masked sites have no kernel. Dividing by infinity sets their response to 0.
            activation.append(current @ receptor.T / np.where(full > 0, full, np.inf))
        least = profile.threshold_ma / profile.full_ma
        answers = np.clip((np.maximum.reduce(activation) - least) / (1 - least), 0, 1)
        starts = np.flatnonzero(np.diff(numbers.astype(np.int64), prepend=-1))
        strongest = np.maximum.reduceat(np.asarray(answers, np.float32), starts, axis=0)
        return dict(zip(numbers[starts].tolist(), strongest, strict=True))

    def _weights_of(self, afferent: Afferent) -> NDArray[np.float64]:
        if afferent not in self.weights:
            offered = ", ".join(
                f"{known.name} (off-target up to {self.off_target[known].max():.2g} and spill up "
                f"to {self.spill[known].max():.2g}, relative to the target)"
                for known in sorted(self.weights)
            )
            raise DesignError(
                f"mode {afferent.name} is not possible with this profile's board: "
                f"it offers {offered or 'none'}"
            )
        return self.weights[afferent]


def _array_problem(profile: Profile) -> dict[str, Any]:
    """Return everything that the kernels of a profile depend on, except masks and limits."""
    return {
        "version": DESIGN_VERSION,
        # Leave out unset keys, so that new keys do not change the hash.
        "array": profile.array.model_dump(exclude_none=True),
        # Version 1.0 had skin layers. Without this empty key, the hashes of all banks would change.
        "skin": profile.skin.model_dump() | {"layers": ()},
        "output": _by_sources(profile).output.model_dump(
            exclude={"masked", "wiring", "ua_per_count"}
        ),
        **profile.kernels.model_dump(include={"neighbors"}, exclude_none=True),
    }


def _by_sources(profile: Profile) -> Profile:
    """Return the profile, with impedances set to 1 kΩ if each electrode has its own source."""
    if profile.output.kind != "weighted":
        return profile
    output = profile.output.model_copy(update={"impedance_kohm": 1.0})
    return profile.model_copy(update={"output": output})


def problem_hash(profile: Profile) -> str:
    """Return a hash of everything that the kernels of a profile depend on."""
    limits, problem = profile.limits, _array_problem(profile)
    if profile.output.kind == "three-state":
        problem["poles"] = "one against its ring or all"  # other words would change the hash
    if profile.output.masked:
        problem["masked"] = sorted(profile.output.masked)
    if profile.design_total_ma is not None or limits.electrode_ma is not None:
        problem["limits"] = [profile.design_total_ma, limits.electrode_ma]
        problem["full_ma"] = profile.full_ma.tolist()
    return hashlib.sha256(json.dumps(problem, sort_keys=True).encode()).hexdigest()


def load_bank(profile: Profile, progress: Progress | None = None) -> KernelBank:
    """Return the bank of a profile: shipped, from the user's cache, or designed now. A design that
    was interrupted resumes."""
    if (bank := find_bank(profile)) is not None:
        return bank
    cached, known = _cached_bank(profile), _find_similar_bank(profile)
    if known is not None and problem_hash(known[0]) == problem_hash(profile):
        return known[1]
    # If the cache cannot be written, the next run designs the bank again.
    with contextlib.suppress(OSError):
        make_folder(cached.parent)
    bank = design_bank(profile, progress, _parts(cached, profile))
    with contextlib.suppress(OSError):
        write_bank(cached, profile, bank)
        shutil.rmtree(_parts(cached, profile), ignore_errors=True)
    return bank


def load_kernels(profile: Profile) -> KernelBank:
    """Return the kernels of a profile's array: shipped, from the user's cache, or designed now.

    Examples
    --------
    >>> import smarttouch as st
    >>> kernels = st.load_kernels(st.load_profile("electric-mouse"))
    >>> kernels.weights[st.Afferent.RA].shape
    (64, 64)
    """
    return load_bank(profile)


def find_bank(profile: Profile) -> KernelBank | None:
    """Return the bank of a profile if it is shipped or in the user's cache."""
    shipped = [shipped_bank(profile.name)] if profile.name in list_profiles() else []
    banks = (_read(path, profile) for path in (*shipped, _cached_bank(profile)))
    return next((bank for bank in banks if bank is not None), None)


def _find_similar_bank(profile: Profile) -> tuple[Profile, KernelBank] | None:
    """Return a stored bank for the same array and skin, and the profile of that bank. This profile
    can differ in masks, limits and comfort levels. Return None if there is no such bank."""
    if profile.output.kind != "weighted":
        return None
    unmasked = profile.output.model_copy(update={"masked": ()})
    others = [load_profile(name) for name in list_profiles()]
    others.append(profile.model_copy(update={"output": unmasked}))
    wanted = _array_problem(profile)
    for other in others:
        if _array_problem(other) == wanted and (bank := find_bank(other)) is not None:
            return other, bank
    return None


def _parts(path: Path, profile: Profile) -> Path:
    """Return the folder for kernels of an unfinished design; several processes can share it."""
    return path.with_name(f"{path.stem}-{problem_hash(profile)[:12]}.parts")


def _cached_bank(profile: Profile) -> Path:
    import platformdirs

    return platformdirs.user_cache_path("smarttouch") / f"{problem_hash(profile)}.npz"


def shipped_bank(name: str) -> Path:
    """Return the path of the bank of a shipped profile."""
    return data_folder("calibration") / "banks" / f"{name}.npz"


def design_bank(
    profile: Profile, progress: Progress | None = None, keep: Path | None = None
) -> KernelBank:
    """Design the kernels of all modes that the board offers, for all sites."""
    if profile.kernels.neighbors is not None:
        return design_confined(profile, profile.driven.tolist(), progress, keep)
    from smarttouch.kernels.batch_design import design_sites, design_unless_known, part_of
    from smarttouch.kernels.design_problem import Array, Problem
    from smarttouch.kernels.switched_design import designer, possible_modes

    modes, profile, design = possible_modes(profile), _by_sources(profile), designer(profile)
    known = _find_similar_bank(profile)
    if known is not None and problem_hash(known[0]) != problem_hash(profile):
        design = design_unless_known(design, known[0], known[1].kernel)
    columns: dict[str, Any] = {name: {} for name in _IN_FILE}
    node_rows: dict[Afferent, Array] = {}
    for index, afferent in enumerate(modes):
        problem = Problem(profile, afferent, made=node_rows)
        timed = design_sites(problem, design, None, part_of(progress, index, len(modes)), keep)
        _store_columns(columns, problem, timed)
    return KernelBank(**columns)


def design_confined(
    profile: Profile, sites: Sequence[int], progress: Progress | None, keep: Path | None = None
) -> KernelBank:
    """Design kernels for some sites. A kernel drives only the electrodes nearest to its site; their
    number is `Kernels.neighbors`. All other weights and AFs in the bank are zero."""
    from smarttouch.kernels.batch_design import design_tiles
    from smarttouch.kernels.switched_design import designer, possible_modes

    profile, count = _by_sources(profile), len(profile.electrodes)
    modes, columns = possible_modes(profile), dict[str, Any]()
    kinds = {"worst_class": np.int8, "seconds": np.float32, "receptor": np.float32}
    for name in _IN_FILE:
        shape = (count,) * (2 if name in ("weights", "receptor") else 1)
        columns[name] = {mode: np.zeros(shape, kinds.get(name, np.float64)) for mode in modes}
    designed = design_tiles(profile, modes, designer(profile), sites, progress, keep)
    for mode, site, members, kernel, seconds, target in designed:
        columns["weights"][mode][site, members] = kernel.weights
        columns["receptor"][mode][site, members] = target
        for name in ("off_target", "spill", "gap"):
            columns[name][mode][site] = getattr(kernel, name)
        columns["worst_class"][mode][site] = kernel.off_target_class
        columns["seconds"][mode][site] = seconds
    return KernelBank(**columns)


def _store_columns(columns: dict[str, Any], problem: "Problem", timed: "Sequence[Timed]") -> None:
    """Write the kernels of one class and their design times into ``columns``."""
    afferent, kernels = problem.afferent, [kernel for kernel, _ in timed]
    fields: dict[str, tuple[Any, Any]] = {
        "weights": ([kernel.weights for kernel in kernels], np.float64),
        "off_target": ([kernel.off_target for kernel in kernels], np.float64),
        "worst_class": ([kernel.off_target_class for kernel in kernels], np.int8),
        "spill": ([kernel.spill for kernel in kernels], np.float64),
        "gap": ([kernel.gap for kernel in kernels], np.float64),
        "seconds": ([seconds for _, seconds in timed], np.float32),
    }
    for name, (values, kind) in fields.items():
        array = np.array(values, kind)
        columns[name][afferent] = np.zeros((problem.electrodes, *array.shape[1:]), kind)
        columns[name][afferent][problem.driven] = array
    columns["receptor"][afferent] = np.asarray(problem.target, np.float32)


def write_bank(path: Path, profile: Profile, bank: KernelBank) -> None:
    """Write a bank atomically."""
    columns = {
        f"{in_file}_{afferent.name}": values
        for name, in_file in _IN_FILE.items()
        for afferent, values in getattr(bank, name).items()
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


def _read(path: Path, profile: Profile) -> KernelBank | None:
    """Return the bank in a file; None if it is incomplete or belongs to another design problem."""
    try:
        with open_file(path, DesignError, MOST_BANK_BYTES) as file:
            arrays = dict(np.load(file, allow_pickle=False))
        if str(arrays["key"]) != problem_hash(profile):
            return None
        columns: dict[str, Any] = {name: {} for name in _IN_FILE}
        named = {in_file: columns[name] for name, in_file in _IN_FILE.items()}
        for name, values in arrays.items():
            in_file, _, afferent = name.rpartition("_")
            if in_file in named:
                named[in_file][Afferent[afferent]] = values
        if any(column.keys() != columns["weights"].keys() for column in columns.values()):
            return None
        return KernelBank(**columns)
    except Exception:
        # A damaged archive can raise errors of many kinds; design the bank again.
        return None


def single_bank(profile: Profile) -> KernelBank:
    """Return a bank in which each kernel is one electrode against all others. All kernels are
    stored as `Afferent.RA`, whatever classes they stimulate. The single electrode is anodic if the
    board allows it; all others share the return current equally."""
    count = len(profile.electrodes)
    driven = profile.driven
    weights = np.zeros((count, count))
    weights[np.ix_(driven, driven)] = -1 / max(1, len(driven) - 1)
    weights[driven, driven] = 1
    if "anodic" in profile.output.polarities:
        weights = -weights
    nothing, nowhere = np.zeros(count), np.zeros((count, count), np.float32)
    zeros = {Afferent.RA: nothing}
    return KernelBank(
        weights={Afferent.RA: weights}, off_target=zeros,
        worst_class={Afferent.RA: nothing.astype(np.int8)}, spill=zeros, gap=zeros, seconds=zeros,
        receptor={Afferent.RA: nowhere}, discs=(Afferent.RA,),
    )  # fmt: skip
