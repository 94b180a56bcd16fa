"""API for plug-ins that add boards, sources or force sensors. More names are in `smarttouch`."""

from smarttouch.base.errors import LineLostError as LineLostError
from smarttouch.base.errors import SourceLostError as SourceLostError
from smarttouch.base.wire.port import LINE_ERRORS as LINE_ERRORS
from smarttouch.base.wire.port import Port as Port
from smarttouch.base.wire.port import open_port as open_port
from smarttouch.base.wire.port import reason as reason
from smarttouch.boards.driver import Driver as Driver
from smarttouch.boards.driver import Line as Line
from smarttouch.boards.impedance import Impedance as Impedance
from smarttouch.boards.reports import BoardReport as BoardReport
from smarttouch.boards.reports import Capabilities as Capabilities
from smarttouch.profile.profile_tables import Output as Output
from smarttouch.sources.force import ForceSource as ForceSource
from smarttouch.sources.live_capture import ImageDevice as ImageDevice
from smarttouch.sources.live_capture import LiveSource as LiveSource
from smarttouch.sources.live_capture import Shot as Shot
from smarttouch.sources.source_contract import Device as Device
from smarttouch.sources.source_contract import DeviceWarnings as DeviceWarnings
from smarttouch.sources.source_contract import Pose as Pose
from smarttouch.stimulation.safety_gate import ProvedSequence as ProvedSequence
from smarttouch.stimulation.scan_sequence import ScanTiming as ScanTiming
