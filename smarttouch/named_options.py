"""Options of the command line behind the parameters that an error names."""

from collections.abc import Iterable
from typing import Any

from smarttouch.errors import SmartTouchError


def named_options(error: SmartTouchError, command: Any, arguments: Iterable[str]) -> str:
    """Return, in parentheses, options of the typed command that an error is about; or nothing.

    The library knows parameters, not options: an error names one in ``about``, and one at the
    start of each way out in ``remedy`` ("width_mm", "overwrite or output", "profile line-8").
    """
    for word in arguments:
        command = getattr(command, "commands", {}).get(word, command)
    options = {
        each.name: each.opts[0] for each in command.params if each.param_type_name == "option"
    }
    names = [error.about, *(way.partition(" ")[0] for way in error.remedy.split(" or "))]
    found = dict.fromkeys(options[name] for name in names if name in options)
    return f" ({', '.join(found)})" if found else ""
