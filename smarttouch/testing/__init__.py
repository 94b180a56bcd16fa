"""Contract tests for boards, sources and forces of other packages."""

from typing import TYPE_CHECKING

from smarttouch.base.lazy_names import lazy_names

if TYPE_CHECKING:
    from smarttouch.base.wire.device_lines import PtyLine, TcpLine
    from smarttouch.testing.driver_contract import ZERO, DriverContract, SentPulse
    from smarttouch.testing.source_contracts import ForceContract, SourceContract, StimulusContract

__all__ = [
    "ZERO", "DriverContract", "ForceContract", "PtyLine", "SentPulse", "SourceContract",
    "StimulusContract", "TcpLine",
]  # fmt: skip

if not TYPE_CHECKING:  # pytest loads a plug-in from here before it can rewrite what it asserts
    __getattr__ = lazy_names(__name__)
