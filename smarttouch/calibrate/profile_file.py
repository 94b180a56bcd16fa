"""A profile with some keys changed: written beside the one it began as, never half."""

import os
from collections.abc import Mapping, MutableMapping, Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

import tomlkit
from tomlkit.items import Array

from smarttouch.errors import CalibrationError, ProfileError
from smarttouch.files import MOST_TOML_BYTES, read_text, require_replaceable, unwritable
from smarttouch.profile import Profile, list_profiles, load_profile
from smarttouch.resources import data_folder

Value = str | float | Sequence[float]

_A_LINE = 8
"""Numbers of a long list on one line."""
_LIBRARIES = {"opencv": "opencv-contrib-python-headless", "numpy": "numpy", "scipy": "scipy"}


class ProfileFile:
    """A profile on its way from one file to another.

    Everything but the keys that are set stays as it is, comments included.

    Parameters
    ----------
    start : str
        Name of a shipped profile, or a file.
    output : Path
        What to write, a ``.toml`` file.
    overwrite : bool
        Whether it may be there already.

    Attributes
    ----------
    profile : Profile
        What it began as.

    Raises
    ------
    ProfileError
        If the start is no profile.
    CalibrationError
        If the output may not be written: said before anything is measured.
    """

    def __init__(self, start: str, output: Path, overwrite: bool = False) -> None:
        self.profile = load_profile(start)
        shipped = start in list_profiles()
        self._source = data_folder("calibration") / f"{start}.toml" if shipped else Path(start)
        text = read_text(self._source, ProfileError, MOST_TOML_BYTES)
        try:
            self._document = tomlkit.parse(text)
        except (tomlkit.exceptions.TOMLKitError, ValueError, RecursionError) as error:
            raise ProfileError(
                f"{self._source} cannot be changed: {error}",
                about="file",
                problem="malformed",
                value=self._source,
            ) from None
        self.output = output
        self._overwrite = overwrite
        if output.suffix != ".toml":
            raise CalibrationError(
                f"--output {output} must end in .toml",
                about="file",
                problem="ending",
                value=output,
                allowed=(".toml",),
                remedy="--output",
            )
        if not output.absolute().parent.is_dir():
            raise CalibrationError(
                f"cannot write {output}: its folder does not exist",
                about="file",
                problem="unwritable",
                value=output,
                remedy="--output",
            )
        self._require_free(output)
        self._keep_flat_field()

    def beside(self, ending: str) -> Path:
        """Return where a file that belongs to the output goes."""
        return self.output.with_name(f"{self.output.stem}.{ending}")

    def set(self, key: str, value: Value) -> None:
        """Change one key, such as ``force.curve``."""
        table, _, name = key.partition(".")
        self._table(table)[name] = value if isinstance(value, str | int | float) else _rows(value)

    def note(self, what: str, found: str) -> None:
        """Say when, with which versions and what a calibration has found."""
        used = [("smarttouch", version("smarttouch"))]
        used += [(name, version(package)) for name, package in _LIBRARIES.items()]
        entry = tomlkit.table()
        entry["when"] = datetime.now(UTC).replace(microsecond=0)
        entry["versions"] = ", ".join(f"{name} {number}" for name, number in used)
        entry["found"] = found
        if "calibrated" not in self._document:
            self._document["calibrated"] = tomlkit.table(is_super_table=True)
        self._table("calibrated")[what] = entry

    def write(self, others: Mapping[Path, bytes] | None = None) -> Profile:
        """Write the profile and the files that go with it; return it as it loads.

        Raises
        ------
        CalibrationError
            If it would not load, or cannot be written; nothing is replaced then.
        """
        files = dict(others or {})
        for path in (self.output, *files):
            self._require_free(path)
        # The profile comes last: the files it names are there before it is.
        files[self.output] = tomlkit.dumps(self._document).encode()
        drafts = {path: path.with_name(f".{path.stem}-draft{path.suffix}") for path in files}
        try:
            for path, content in files.items():
                _write_through(drafts[path], content)
            self._prove(drafts[self.output])
            for path, draft in drafts.items():
                draft.replace(path)
        except OSError as error:
            raise unwritable(CalibrationError, self.output, error) from None
        finally:
            for draft in drafts.values():
                draft.unlink(missing_ok=True)
        return load_profile(self.output)

    def _prove(self, draft: Path) -> None:
        try:
            load_profile(draft)
        except ProfileError as error:
            said = str(error).removeprefix(f"{draft}: ")
            raise CalibrationError(
                f"what was measured makes no profile, nothing was written: {said}",
                about=error.about,
                problem=error.problem,
                value=error.value,
                allowed=error.allowed,
                remedy=error.remedy,
                electrode=error.electrode,
            ) from None

    def _require_free(self, path: Path) -> None:
        require_replaceable(path, CalibrationError)
        if path.exists() and not self._overwrite:
            raise CalibrationError(
                f"{path} exists already: give another --output, or --overwrite",
                about="file",
                problem="exists",
                value=path,
                remedy="--overwrite",
            )

    def _table(self, name: str) -> MutableMapping[str, Any]:
        table = self._document[name]
        # A table, or the proxy of one whose parts are scattered over the file.
        assert isinstance(table, MutableMapping)
        return table

    def _keep_flat_field(self) -> None:
        """Let a flat field be found from where the output will lie."""
        named = self._table("optics").get("flat_field")
        if named is None:
            return
        found = (self._source.parent / str(named)).resolve()
        self.set("optics.flat_field", os.path.relpath(found, self.output.absolute().parent))


def _rows(values: Sequence[float]) -> Array:
    rows = tomlkit.array()
    if len(values) <= _A_LINE:
        rows.extend(values)
        return rows
    width = 3 if len(values) == 9 else _A_LINE
    for first in range(0, len(values), width):
        rows.add_line(*values[first : first + width])
    rows.add_line(indent="")
    return rows


def _write_through(path: Path, content: bytes) -> None:
    with path.open("wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())
