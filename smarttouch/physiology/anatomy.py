"""Anatomies of a finger: densities, courses and thresholds of its afferents, as TOML files."""

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
    """Afferents of one class."""

    density_per_cm2: float = Field(ge=0, le=1000)
    """Axons per area at the fingertip."""
    fiber: Literal["fingertip", "trunk", "mrg"] = "fingertip"
    """Fiber whose driving function they have."""
    diameter_factor: Positive = 1.0
    """Diameter over that of the fiber; internodes grow with it, and of a fiber that keeps its
    proportions nothing else changes."""
    ending: Literal["through", "active", "passive"] = "passive"
    """Kind of their endings; "through" where the receptor's end of the axon cannot fire."""
    depth_mm: Positive | None = None
    """Depth of the endings, or of a flat axon; that of the profile's skin if none."""
    depth_spread_mm: float = Field(default=0.05, ge=0, le=1)
    """Standard deviation of depths between axons. Ours."""
    on_ridges: bool = False
    """Whether endings lie under papillary ridges."""
    endings: int = Field(default=1, ge=1, le=50)
    """Endings of an axon."""
    branch_spread_mm: float = Field(default=0.0, ge=0, le=10)
    """Standard deviation of the places of an axon's endings, along each axis."""
    plexus_mm: Positive | None = None
    """Depth at which branches join and the axon runs flat; that of its ending if none."""
    receptor_above_mm: float = Field(default=0.0, ge=0, le=1)
    """Height of the endings above the depth at which the axon runs."""
    flat_mm: float = Field(default=0.0, ge=0, le=30)
    """Length of the flat part of an axon."""
    flat_deg: float = Field(default=90.0, ge=-360, le=360)
    """Direction of the flat part, from x toward y; 90 is toward the palm."""
    flat_spread_deg: float = Field(default=30.0, ge=0, le=180)
    """Standard deviation of that direction. Ours."""
    descent_mm: float = Field(default=0.0, ge=0, le=20)
    """Length over which an axon is followed downward after its flat part."""
    bend_mm: float = Field(default=0.5, ge=0, le=5)
    """Length over which a bend of an axon is rounded. Ours; sharp bends would fire first."""
    lean_deg: float = Field(default=0.0, ge=0, le=60)
    """Standard deviation of an upright part's lean from the vertical."""
    threshold_spread: float = Field(default=0.2, ge=0, le=2)
    """Standard deviation of the logarithm of thresholds between axons. Ours: diameters at the
    fingertip vary by 15 % (3.3 ± 0.5 µm, Nolano et al. 2003)."""
    threshold_factor: Positive = 1.0
    """Factor on the thresholds of the cable model."""
    noise: float = Field(default=0.01, ge=0, le=1)
    """Relative spread of one axon's threshold from pulse to pulse (Verveen)."""
    chronaxie_us: Positive = 151.0
    """Strength–duration time constant by Weiss: macaque RA afferents (Kaczmarek 2000). SAI and PC
    have none of their own."""
    refractory_us: float = Field(default=2000.0, ge=0, le=100_000)
    """Time after a spike without another. Ours: Aβ fibers follow up to some 500 Hz."""

    def driving(self, width_us: float) -> DrivingFunction:
        """Return the driving function of the fibers for a pulse width."""
        driving = load_driving(self.fiber, self.ending, width_us)
        return replace(driving, internode_mm=self.diameter_factor * driving.internode_mm)


class Anatomy(Table):
    """Densities, courses and thresholds of a finger's afferents."""

    name: str = ""
    """Name of the file."""
    title: str = Field(min_length=1)
    """What it is, for people."""
    ridge_mm: Positive = 0.45
    """Distance between papillary ridges (0.4 to 0.5 mm)."""
    tip_mm: Positive = 20.0
    """Distance from the finger's end within which densities are those of the tip."""
    beyond_tip: float = Field(default=1.6 / 4.2, ge=0, le=1)
    """Density beyond it (Johansson and Vallbo 1979: finger to tip as 1.6 to 4.2, in a step)."""
    margin_mm: float = Field(default=3.0, ge=0, le=20)
    """Skin around the electrodes that belongs to the finger."""
    ra: ClassAnatomy
    sai: ClassAnatomy
    pc: ClassAnatomy

    def of(self, afferent: Afferent) -> ClassAnatomy:
        return (self.ra, self.sai, self.pc)[afferent]


def load_anatomy(name: str | Path) -> Anatomy:
    """Load a shipped anatomy by name, or any by its TOML file; ProfileError if it is not valid."""
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
