"""Editing of a profile: some keys changed, written in one atomic step."""

import os
import tomllib
from collections.abc import Mapping, MutableMapping, Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

import tomlkit

from smarttouch.base import __version__
from smarttouch.base.errors import CalibrationError, ProfileError
from smarttouch.base.files import (
    MOST_TOML_BYTES,
    read_text,
    read_toml,
    require_replaceable,
    write_bytes,
)
from smarttouch.profile import Profile, load_profile
from smarttouch.profile.toml_files import difference, in_rows, profile_of, profile_path

Value = str | float | Sequence[float]

_LIBRARIES = {"opencv": "opencv-contrib-python-headless", "numpy": "numpy", "scipy": "scipy"}


class ProfileFile:
    """Edit of ``profile``, a shipped one or a file, to a ``.toml`` file.

    Everything but the keys that are set stays as it is, comments included. The output may be there
    already with ``overwrite``; with ``update`` it is what it begins as, and is replaced unless it
    changes meanwhile. Raises ProfileError if the start is no profile, and CalibrationError if the
    output may not be written, before anything is measured.
    """

    def __init__(
        self, start: str, output: Path, overwrite: bool = False, *, update: bool = False
    ) -> None:
        source = profile_path(start)
        self._text, self._document, profile = _begin(source)
        self.profile: Profile = profile
        self.output: Path = output
        self._update, self._overwrite = update, overwrite
        if output.suffix != ".toml":
            raise CalibrationError(
                f"the new profile {output} must end in .toml: give another --output"
            )
        if not output.absolute().parent.is_dir():
            raise CalibrationError(f"cannot write {output}: its folder does not exist: make it")
        self._require_free(output)
        if (named := self._table("optics").get("flat_field")) is not None:
            found = (source.parent / str(named)).resolve()
            self.set("optics.flat_field", os.path.relpath(found, output.absolute().parent))

    def beside(self, ending: str) -> Path:
        """Return the path of a file that belongs to the output."""
        return self.output.with_name(f"{self.output.stem}.{ending}")

    def set(self, key: str, value: Value) -> None:
        """Change one key, such as ``force.curve``."""
        table, _, name = key.partition(".")
        self._table(table)[name] = value if isinstance(value, str | int | float) else in_rows(value)

    def note(self, what: str, found: str) -> None:
        """Record time, versions and result of a calibration."""
        used = [("smarttouch", __version__)]
        used += [(name, version(package)) for name, package in _LIBRARIES.items()]
        entry = tomlkit.table()
        entry["when"] = datetime.now(UTC).replace(microsecond=0)
        entry["versions"] = ", ".join(f"{name} {number}" for name, number in used)
        entry["found"] = found
        if "calibrated" not in self._document:
            self._document["calibrated"] = tomlkit.table(is_super_table=True)
        self._table("calibrated")[what] = entry

    def write(self, others: Mapping[Path, bytes] | None = None) -> Profile:
        """Write the profile and the files that go with it; return it as it loads."""
        for path in (self.output, *(others or {})):
            self._require_free(path)
        text = tomlkit.dumps(self._document)
        try:
            profile_of(tomllib.loads(text), self.output)
        except ProfileError as error:
            said = str(error).removeprefix(f"{self.output}: ")
            raise CalibrationError(
                f"what was measured is no valid profile, so nothing was written: {said}",
                electrode=error.electrode,
            ) from None
        # The profile comes last: the files it names are there before it is.
        for path, data in {**(others or {}), self.output: text.encode()}.items():
            write_bytes(path, data, CalibrationError)
        return load_profile(self.output)

    def _require_free(self, path: Path) -> None:
        require_replaceable(path, CalibrationError)
        if self._update and path == self.output:
            if read_text(path, CalibrationError, MOST_TOML_BYTES) != self._text:
                raise CalibrationError(
                    f"{path} was changed meanwhile, nothing was written: repeat the command"
                )
        elif path.exists() and not self._overwrite:
            raise CalibrationError(f"{path} exists already: give another file, or add --overwrite")

    def _table(self, name: str) -> MutableMapping[str, Any]:
        table = self._document[name]
        # A table, or the proxy of one whose parts are scattered over the file.
        assert isinstance(table, MutableMapping)
        return table


def file_to_calibrate(
    part: str,  # calibration
    # profile that was asked for; where the output is there, one that differs from it in
    # calibrations only
    start: str | None,
    usual: str,  # what a new output begins as where no profile was asked for
    output: Path,
    overwrite: bool = False,  # whether the part may be there already
    *,
    # whether nothing real is measured: added to what was, only with ``overwrite``
    simulated: bool = False,
) -> ProfileFile:
    """Return the profile that a calibration adds its part to, on its way to the output.

    An output that exists is continued: all in it is kept but this part.
    """
    if not output.exists():
        return ProfileFile(start or usual, output, overwrite)
    require_replaceable(output, CalibrationError)
    file = ProfileFile(str(output), output, overwrite, update=True)
    key = None if start is None else difference(file.profile, _begin(profile_path(start))[-1])
    if key is not None:
        raise CalibrationError(
            f"{output} is there, and differs from {start} in {key}: continue from what is there, "
            "or give another file to --output"
        )
    if part in file.profile.calibrated and not overwrite:
        raise CalibrationError(
            f"{output} has its {part} already: --overwrite replaces that and keeps the rest, "
            "--output writes another file"
        )
    notes = file.profile.calibrated
    measured = [name for name in notes if not notes[name].found.startswith("simulated")]
    if simulated and measured and not overwrite:
        raise CalibrationError(
            f"{output} has its {measured[0]} from a real finger or sensor: write a "
            "simulation to another file, or overwrite it"
        )
    return file


def _begin(path: Path) -> tuple[str, tomlkit.TOMLDocument, Profile]:
    """Return a profile as text, as document and as it loads."""
    table, text = read_toml(path, ProfileError), read_text(path, ProfileError, MOST_TOML_BYTES)
    try:
        document = tomlkit.parse(text)
    except (tomlkit.exceptions.TOMLKitError, ValueError, RecursionError) as error:
        raise ProfileError(f"{path} cannot be changed: {error}", key="file") from None
    return text, document, profile_of(table, path)
