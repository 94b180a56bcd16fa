"""SmartTouch: touch what a sensor sees.

The package converts frames of print to tactile images, and tactile images to scan sequences of
currents. Each sequence is proved safe before it is sent to an electro-tactile display board::

    import smarttouch as st

    profile = st.load_profile("electric-mouse")
    with st.open_source("text:touch", profile) as source, \\
            st.open_display("simulated:", profile) as display:
        statistics = st.run(source, display, mode="RA")

To keep the import fast, the package loads its modules when a name is first used.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from smarttouch.base import __version__ as __version__

if TYPE_CHECKING:
    from smarttouch.top_names import *  # noqa: F403, this module has the same names
else:

    def __getattr__(name: str) -> Any:
        if name == "__all__":
            return [*__dir__(), "__version__"]
        if not name.startswith("_"):
            return getattr(import_module("smarttouch.top_names"), name)
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")

    def __dir__() -> list[str]:
        return [name for name in vars(import_module("smarttouch.top_names")) if name[0].isalpha()]
