"""Progress of a session with a subject, saved after every electrode."""

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

from smarttouch.calibrate.limits import Thresholds
from smarttouch.closing import Closing
from smarttouch.errors import CalibrationError
from smarttouch.files import (
    open_alone,
    parse_json,
    read_bytes,
    sync_folder,
    unwritable,
    write_through,
)


class Progress(Closing):
    """Results of a threshold session until now, by electrode, in a file beside the profile to come.

    They count only where `settings` are the same. Until it is closed no other session can continue
    the same file.
    """

    def __init__(self, path: Path, settings: Mapping[str, Any]) -> None:
        self.path = path
        # As JSON gives it back: a tuple becomes a list.
        self._settings = json.loads(json.dumps(settings))
        self.found: dict[int, Thresholds] = {}
        # The file itself is another one after each electrode: one beside it keeps others out.
        self._lock_path = path.with_name(f".{path.name}-lock")
        self._lock = open_alone(self._lock_path, CalibrationError, path)
        try:
            if path.exists():
                self.found = self._read()
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Release the lock of the file."""
        if not self._lock.closed:
            self._lock_path.unlink(missing_ok=True)
            self._lock.close()

    def keep(self, site: int, found: Thresholds) -> None:
        """Add the result of an electrode, and write the file."""
        self.found[site] = found
        entries = {str(each): _plain(found) for each, found in sorted(self.found.items())}
        text = json.dumps({"settings": self._settings, "found": entries}, indent=1)
        draft = self.path.with_name(f".{self.path.name}-draft")
        try:
            write_through(draft, (text + "\n").encode())
            draft.replace(self.path)
            sync_folder(self.path.absolute().parent)
        except OSError as error:
            raise unwritable(CalibrationError, self.path, error) from None

    def forget(self) -> None:
        """Remove the file once the profile has the results."""
        self.path.unlink(missing_ok=True)

    def _read(self) -> dict[int, Thresholds]:
        try:
            stored = parse_json(read_bytes(self.path, CalibrationError))
            settings = stored["settings"]
            found = {int(site): _thresholds(entry) for site, entry in stored["found"].items()}
        except (ValueError, KeyError, TypeError, AttributeError, OverflowError):
            raise CalibrationError(
                f"{self.path} is not the beginning of a threshold session: remove it to start over",
                about="file",
            ) from None
        for key, value in self._settings.items():
            before = settings.get(key) if isinstance(settings, dict) else None
            if before != value:
                raise CalibrationError(
                    f"{self.path} was begun with {key} {before}, not {value}: go on with the same, "
                    "or remove it to start over",
                    about=key,
                )
        return found


def _plain(found: Thresholds) -> dict[str, Any]:
    """Return JSON values, which have no NaN."""
    return {
        name: None if isinstance(value, float) and math.isnan(value) else value
        for name, value in asdict(found).items()
    }


def _thresholds(entry: Mapping[str, Any]) -> Thresholds:
    values: dict[str, Any] = {}
    for each in fields(Thresholds):
        value = entry[each.name]
        if each.type is int:
            values[each.name] = int(value)
        else:
            values[each.name] = math.nan if value is None else float(value)
    found = Thresholds(**values)
    if found.felt and not 0 < found.threshold_ma <= found.comfort_ma:
        raise ValueError("a threshold above comfort")
    return found
