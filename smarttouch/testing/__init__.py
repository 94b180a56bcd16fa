"""Contract tests for boards, sources and force sensors of plug-in packages."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from smarttouch.emulator.device_lines import PtyLine, TcpLine, replayed
    from smarttouch.testing.driver_contract import ZERO, DriverContract, SentPulse
    from smarttouch.testing.source_contracts import ForceContract, SourceContract, StimulusContract

__all__ = [
    "ZERO", "DriverContract", "ForceContract", "PtyLine", "SentPulse", "SourceContract",
    "StimulusContract", "TcpLine", "replayed",
]  # fmt: skip

_MODULES = "emulator.device_lines", "testing.source_contracts", "testing.driver_contract"

if not TYPE_CHECKING:  # lazy: pytest cannot rewrite asserts of modules loaded before its plug-in

    def __getattr__(name: str) -> Any:
        for module in _MODULES:
            names = vars(import_module(f"smarttouch.{module}")) if name in __all__ else {}
            if name in names:
                return names[name]
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
