"""Table ``kernels`` of a profile: the aim of their design."""

from typing import Literal

from pydantic import Field

from smarttouch.profile.table import Table


class Kernels(Table):
    """Objective of the design of kernels."""

    objective: Literal["node", "finger"] = "node"
    """``node``: one node under each electrode, against those of other classes everywhere (the
    paper); ``finger``: the afferents of simulated fingers whose receptors are near the electrode,
    against all others."""
    anatomy: str = "branched"
    """Anatomy of these fingers: a name or a file."""
    fingers: int = Field(default=20, ge=1, le=1000)
    """Number of fingers that kernels are designed on."""
