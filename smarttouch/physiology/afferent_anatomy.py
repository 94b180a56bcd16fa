"""Anatomies of a finger as TOML files: densities, paths and thresholds of afferents."""

from dataclasses import replace
from pathlib import Path
from typing import Literal

from pydantic import Field

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import ProfileError
from smarttouch.physiology.membrane import DrivingFunction, load_driving
from smarttouch.profile.toml_tables import Positive, Table, load_model

_SHIPPED = Path(__file__).with_name("anatomies")


class ClassAnatomy(Table):
    """Anatomy of the afferents of one class."""

    density_per_cm2: float = Field(ge=0, le=1000)
    """Number of axons per cm² of the fingertip."""
    fiber: Literal["fingertip", "trunk", "mrg"] = "fingertip"
    """Fiber model whose driving function is used: a name in `membrane.FIBERS`."""
    diameter_factor: Positive = 1.0
    """Fiber diameter relative to that of the model; internodes are longer by the same factor."""
    ending: Literal["through", "active", "passive"] = "passive"
    """Kind of the endings, as in `Fiber`; "through" if the axon cannot fire at the receptor."""
    depth_mm: Positive | None = None
    """Depth of the endings or of a horizontal axon; by default from the profile."""
    depth_spread_mm: float = Field(default=0.05, ge=0, le=1)
    """Standard deviation of the depth of axons (our assumption)."""
    on_ridges: bool = False
    """Whether endings lie under papillary ridges."""
    endings: int = Field(default=1, ge=1, le=50)
    """Number of endings of an axon."""
    branch_spread_mm: float = Field(default=0.0, ge=0, le=10)
    """Standard deviation of the places of an axon's endings, along x and along y."""
    plexus_mm: Positive | None = None
    """Depth at which branches join and the axon turns horizontal; by default the depth of the
    endings."""
    receptor_above_mm: float = Field(default=0.0, ge=0, le=1)
    """Height of the endings above the horizontal part of the axon."""
    flat_mm: float = Field(default=0.0, ge=0, le=30)
    """Length of the horizontal part of an axon."""
    flat_deg: float = Field(default=90.0, ge=-360, le=360)
    """Direction of the horizontal part, measured from x toward y; 90 points to the palm."""
    flat_spread_deg: float = Field(default=30.0, ge=0, le=180)
    """Standard deviation of `flat_deg` between axons (our assumption)."""
    descent_mm: float = Field(default=0.0, ge=0, le=20)
    """Length of the part that descends after the horizontal part."""
    bend_mm: float = Field(default=0.5, ge=0, le=5)
    """Length over which bends are rounded (our assumption). Otherwise bends would fire first."""
    lean_deg: float = Field(default=0.0, ge=0, le=60)
    """Standard deviation of the angle between the vertical and the upright part of an axon."""
    threshold_spread: float = Field(default=0.2, ge=0, le=2)
    """Standard deviation, from axon to axon, of the logarithm of the threshold (our assumption, as
    diameters at the fingertip vary by 15 %: 3.3 ± 0.5 µm, Nolano et al. 2003)."""
    threshold_factor: Positive = 1.0
    """Factor by which thresholds of the cable model are multiplied."""
    noise: float = Field(default=0.01, ge=0, le=1)
    """Relative standard deviation of an axon's threshold from pulse to pulse (Verveen)."""
    chronaxie_us: Positive = 151.0
    """Chronaxie of Weiss's law, measured in macaque RA afferents (Kaczmarek 2000); SAI and PC use
    the same value."""
    refractory_us: float = Field(default=2000.0, ge=0, le=100_000)
    """Refractory period (our assumption: Aβ fibers follow up to about 500 Hz)."""

    def driving(self, width_us: float) -> DrivingFunction:
        """Return the driving function for a pulse width."""
        driving = load_driving(self.fiber, self.ending, width_us)
        return replace(driving, internode_mm=self.diameter_factor * driving.internode_mm)


class Anatomy(Table):
    """Densities, paths and thresholds of a finger's afferents."""

    name: str = ""
    """Name of the file."""
    title: str = Field(min_length=1)
    """Description for people."""
    ridge_mm: Positive = 0.45
    """Distance between papillary ridges, 0.4 to 0.5 mm."""
    tip_mm: Positive = 20.0
    """Distance from the end of the finger up to which the density is that of the fingertip."""
    beyond_tip: float = Field(default=1.6 / 4.2, ge=0, le=1)
    """Density beyond `tip_mm`, relative to the tip (1.6 : 4.2, Johansson and Vallbo 1979)."""
    margin_mm: float = Field(default=3.0, ge=0, le=20)
    """Margin of skin around the electrodes."""
    ra: ClassAnatomy
    sai: ClassAnatomy
    pc: ClassAnatomy

    def of(self, afferent: Afferent) -> ClassAnatomy:
        return (self.ra, self.sai, self.pc)[afferent]


def load_anatomy(name: str | Path) -> Anatomy:
    """Load a shipped anatomy by name, or an anatomy from a TOML file. Raises ProfileError if it is
    invalid or missing."""
    known = sorted(path.stem for path in _SHIPPED.glob("*.toml"))
    if str(name) in known:
        return load_model(_SHIPPED / f"{name}.toml", Anatomy, name=str(name))
    path = Path(name)
    if not path.exists():
        raise ProfileError(
            f"no anatomy {str(name)!r}: give a TOML file or one of {', '.join(known)}",
            key="anatomy",
        )
    return load_model(path, Anatomy, name=path.stem)
