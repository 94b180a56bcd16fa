"""One-line representations of records: arrays by type and shape."""

import dataclasses
from enum import Enum
from typing import Any

import numpy as np


def one_line(record: Any) -> str:
    """Return a dataclass's repr in one line: arrays by type and shape, records by class."""
    shown = [
        f"{each.name}={_brief(getattr(record, each.name))}"
        for each in dataclasses.fields(record)
        if each.repr
    ]
    return f"{type(record).__name__}({', '.join(shown)})"


def _brief(value: Any) -> str:
    if isinstance(value, np.ndarray):
        return f"{value.dtype} {value.shape}"
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, Enum):
        return value.name
    if isinstance(value, list | tuple | dict) and len(value) > 3:
        return f"<{len(value)} values>"
    if isinstance(value, dict):
        return f"{{{', '.join(f'{_brief(key)}: {_brief(each)}' for key, each in value.items())}}}"
    text = repr(value)
    long = text.startswith("<") or len(text) > 60 or "\n" in text
    return f"<{type(value).__name__}>" if long else text
