"""Settings under a name: a TOML file in the user's configuration folder."""

import re
from collections.abc import Collection
from pathlib import Path
from typing import Any, TypeVar

import platformdirs
import tomlkit
from pydantic import BaseModel, ConfigDict, ValidationError

from smarttouch.errors import SavedRunError, SmartTouchError
from smarttouch.files import make_folder, read_toml, unwritable, write_bytes
from smarttouch.profile import list_profiles
from smarttouch.profile.complaints import table_error
from smarttouch.running.config import RunConfig

_OF_FILES = ("page", "video", "frames", "recording", "recorded", "path")
"""Kinds of source, force and motion whose URL names a file or folder."""
_NAME = "[A-Za-z0-9][A-Za-z0-9_.-]{0,63}"
Option = float | int | bool | str | tuple[int, ...]


class SavedRun(BaseModel):
    """Settings of a run that can be kept: where it comes from, where it goes, and how.

    Attributes
    ----------
    source : str or None
        URL of the source.
    source_options : dict
        Options of `open_source`.
    board, vibrators, force : str or None
        URLs.
    profile : str or None
        Name or file; the board's usual one if None.
    config : RunConfig
        All of it is kept but the intensity, which is given anew for each run.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    source: str | None = None
    board: str | None = None
    vibrators: str | None = None
    force: str | None = None
    profile: str | None = None
    source_options: dict[str, Option] = {}
    config: RunConfig = RunConfig()


class SavedOptions(BaseModel):
    """Options of one command that can be kept, by their names."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    command: str
    options: dict[str, Option] = {}


_S = TypeVar("_S", SavedRun, SavedOptions)


def saved_runs() -> list[str]:
    """Return the names under which settings are kept."""
    return sorted(path.stem for path in _folder().glob("*.toml"))


def saved_run_path(name: str) -> Path:
    """Return the file of the settings that are kept under a name, or may be.

    Raises
    ------
    SavedRunError
        If no settings can have such a name.
    """
    if re.fullmatch(_NAME, name) is None:
        raise SavedRunError(
            f"{name[:80]!r} is no name for settings: use letters, digits, and - _ . between them",
            about="name",
            problem="malformed",
            value=name,
        )
    return _folder() / f"{name}.toml"


def save_run(name: str, run: SavedRun, *, overwrite: bool = False) -> Path:
    """Keep settings under a name; return their file.

    Files that they name are found from any folder then.

    Raises
    ------
    SavedRunError
        If there are some of that name, or they cannot be written or kept.
    """
    if not isinstance(run.config.scan, str):
        raise SavedRunError(
            "classes that share slots cannot be kept: choose the scan points, frame or auto",
            about="scan",
            problem="impossible",
            value=run.config.scan,
        )
    table = _given(run.model_dump(mode="json", exclude={"config": {"intensity"}}))
    for key in ("source", "force"):
        table |= {key: from_anywhere(table[key])} if key in table else {}
    if "profile" in table and table["profile"] not in list_profiles():
        table["profile"] = str(Path(table["profile"]).absolute())
    if "path" in table["source_options"]:
        table["source_options"]["path"] = str(Path(table["source_options"]["path"]).absolute())
    return _write(name, table, overwrite)


def save_options(name: str, saved: SavedOptions, *, overwrite: bool = False) -> Path:
    """Keep options of a command under a name; return their file.

    Raises
    ------
    SavedRunError
        If there are some of that name, or they cannot be written.
    """
    return _write(name, saved.model_dump(), overwrite)


def load_run(name: str | Path) -> SavedRun:
    """Return the settings that are kept under a name, or in a file.

    Raises
    ------
    SavedRunError
        If there are none, or they say something unknown or impossible.
    """
    path, run = _read(name, SavedRun)
    if run.config.intensity is not None or not isinstance(run.config.scan, str):
        key = "scan" if run.config.intensity is None else "intensity"
        raise SavedRunError(
            f"{path}: config.{key} cannot be kept in a file: remove it, and give it with the run",
            about=f"config.{key}",
            problem="impossible",
            value=getattr(run.config, key),
        )
    return run


def load_options(name: str, command: str, known: Collection[str]) -> dict[str, Option]:
    """Return the options of a command that are kept under a name.

    Raises
    ------
    SavedRunError
        If there are none, or some that the command does not have.
    """
    path, saved = _read(name, SavedOptions, command)
    if wrong := [key for key in saved.options if key not in known]:
        raise SavedRunError(
            f"{path}: options.{wrong[0]} cannot be kept in a file for {command}: remove it",
            about=f"options.{wrong[0]}",
            problem="impossible",
            value=saved.options[wrong[0]],
        )
    return saved.options


def _write(name: str, table: dict[str, Any], overwrite: bool) -> Path:
    path = saved_run_path(name)
    if path.exists() and not overwrite:
        raise SavedRunError(
            f"there are settings named {name!r} already: choose another name, or remove {path}",
            about="name",
            problem="exists",
            value=name,
        )
    try:
        make_folder(path.parent)
    except OSError as error:
        raise unwritable(SavedRunError, path, error) from None
    write_bytes(path, tomlkit.dumps(table).encode(), SavedRunError)
    return path


def _read(name: str | Path, kind: type[_S], command: str | None = None) -> tuple[Path, _S]:
    path = name if isinstance(name, Path) else saved_run_path(name)
    if not isinstance(name, Path) and not path.exists():
        known = saved_runs()
        raise SavedRunError(
            f"no settings are kept as {name!r}: choose "
            + (" or ".join(known) if known else "some settings, and keep them"),
            about="name",
            problem="unknown",
            value=name,
            allowed=tuple(known),
        )
    table = read_toml(path, SavedRunError)
    try:
        if (found := table.get("command")) != command:
            raise SavedRunError(
                f"{path} holds settings of {found or 'live'}, not of {command or 'live'}: choose "
                "others",
                about="command",
                problem="conflict",
                value=found,
                allowed=command,
            )
        return path, kind.model_validate(table)
    except SavedRunError:
        raise
    except ValidationError as error:
        raise table_error(SavedRunError, path, error) from None
    except SmartTouchError as error:
        raise _in_file(path, error) from None


def _folder() -> Path:
    return platformdirs.user_config_path("smarttouch") / "runs"


def _given(table: dict[str, Any]) -> dict[str, Any]:
    return {
        key: _given(value) if isinstance(value, dict) else value
        for key, value in table.items()
        if value is not None
    }


def from_anywhere(url: str) -> str:
    """Return the URL of a source, force or motion with the whole path of the file it names."""
    kind, _, rest = url.partition(":")
    return f"{kind}:{Path(rest).absolute()}" if kind in _OF_FILES and rest else url


def _in_file(path: Path, error: SmartTouchError) -> SavedRunError:
    """Return an impossible value of the configuration as an error of its file."""
    return SavedRunError(
        f"{path}: {error}",
        about=f"config.{error.about}",
        problem=error.problem,
        value=error.value,
        allowed=error.allowed,
        remedy=error.remedy,
    )
