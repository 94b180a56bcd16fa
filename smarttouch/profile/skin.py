"""Skin of a profile: conductivities, courses of its afferents, and their uncertainty."""

from collections.abc import Iterator
from typing import Literal, Self

import numpy as np
from pydantic import Field, model_validator

from smarttouch.profile.table import Positive, Table, UnfitError, raise_all


class SkinLayer(Table):
    """One layer of skin; the last one is infinitely thick."""

    name: str = ""
    """Name of the layer, for people."""
    thickness_mm: float = Field(default=float("inf"), gt=0, allow_inf_nan=True)
    """Thickness of the layer; left out for the last."""
    conductivity_s_per_m: Positive
    """Conductivity of the layer."""


class Spread(Table):
    """Largest deviation of a true finger from the nominal one; robust kernels hold over it."""

    ra_depth_mm: float = Field(default=0.1, ge=0)
    """Largest error of the depth of RA, each way."""
    sai_depth_mm: float = Field(default=0.1, ge=0)
    """Largest error of the depth of SAI, each way."""
    pc_depth_mm: float = Field(default=0.3, ge=0)
    """Largest error of the depth of PC, each way."""
    angle_deg: float = Field(default=10.0, ge=0, le=45)
    """Largest turn of flat axons in the plane, and of rising ones from the vertical."""
    conductivity_factor: float = Field(default=1.5, ge=1, le=100)
    """Factor by which the conductivity of each layer may be off, up and down."""


class Skin(Table):
    """The conducting medium and the afferents in it (paper, Section II-D)."""

    medium: Literal["half-space", "infinite", "layered", "plane"]
    """Shape of the conductor; ``plane`` is the paper's homogeneous 2D medium, for line
    electrodes."""
    conductivity_s_per_m: Positive | None = None
    """Conductivity of homogeneous skin; not given for ``layered``."""
    layers: tuple[SkinLayer, ...] = ()
    """Layers from the surface down, for ``layered``."""
    ra_depth_mm: Positive
    """Depth of the endings of RA, whose axons rise to the surface."""
    sai_depth_mm: Positive
    """Depth of the axons of SAI, which run flat."""
    pc_depth_mm: Positive
    """Depth of the axons of PC."""
    sai_angles_deg: tuple[float, ...] = Field(min_length=1)
    """Directions of the horizontal afferents; the first is the target of SAI mode."""
    node_spacing_mm: Positive
    """Spacing of the points at which unwanted activation is bounded."""
    ra_ending: Literal["passive", "active"] = "passive"
    """Whether the ending of a rising axon can fire: it decides RA's polarity."""
    internode_mm: Positive = 0.079
    """Distance between the nodes of Ranvier of an axon near its ending; 79 µm by Nolano et al.
    2003."""
    spread: Spread = Spread()

    @property
    def conductivity(self) -> float:
        """Conductivity of homogeneous skin, S/m."""
        return self.conductivity_s_per_m or 1.0

    @model_validator(mode="after")
    def _conducting(self) -> Self:
        raise_all(self._misfits())
        return self

    def _misfits(self) -> Iterator[UnfitError]:
        layered = self.medium == "layered"
        if layered != bool(self.layers) or layered != (self.conductivity_s_per_m is None):
            yield UnfitError(
                "a layered medium takes its conductivities from skin.layers, any other one from "
                "skin.conductivity_s_per_m: give just that",
                about="skin.medium",
                remedy="skin.layers" if layered else "skin.conductivity_s_per_m",
            )
        if layered and self.layers and not np.isinf(self.layers[-1].thickness_mm):
            yield UnfitError(
                "the last of skin.layers goes on without end: leave out thickness_mm",
                about="skin.layers",
            )
        if any(np.isinf(layer.thickness_mm) for layer in self.layers[:-1]):
            yield UnfitError(
                "each of skin.layers but the last needs its thickness_mm", about="skin.layers"
            )
        for name in ("ra", "sai", "pc"):
            depth, spread = (getattr(each, f"{name}_depth_mm") for each in (self, self.spread))
            if depth - spread <= 0:
                yield UnfitError(
                    f"spread.{name}_depth_mm {spread:g} reaches the surface from {name}_depth_mm "
                    f"{depth:g}: no fiber lies outside the skin; lower it",
                    about=f"skin.spread.{name}_depth_mm",
                )
