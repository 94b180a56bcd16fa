"""Potential and its second derivatives for one electrode on homogeneous skin, in closed form.

The activating function is the second derivative of the potential along an axon (Eq. 2). Cable
models need the potential itself. Fields are for a unit **cathodic** current, so the potential is
negative. Under the electrode the second derivative is positive along horizontal axons, which are
depolarized, and negative along vertical axons, which are hyperpolarized.

Lengths are in mm. Fields are relative to ρI/2π, for an electrode on the insulated surface of a half
space; in an infinite medium they are half as large.
"""

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from smarttouch.base.afferent import Afferent
from smarttouch.base.errors import DesignError
from smarttouch.profile import Profile, Skin
from smarttouch.profile.electrodes import ElectrodeArray

Array = NDArray[np.float64]


class Field(NamedTuple):
    """Potential (1/mm) and second derivatives (1/mm³); x and y point along the skin, z into it."""

    potential: Array
    xx: Array
    yy: Array
    zz: Array
    xy: Array
    xz: Array
    yz: Array

    def along(self, direction: Array) -> Array:
        """Return the second derivative along a unit vector, (3,) (Eq. 2)."""
        a, b, c = (float(part) for part in direction)
        terms = (
            (a * a, self.xx), (b * b, self.yy), (c * c, self.zz),
            (2 * a * b, self.xy), (2 * a * c, self.xz), (2 * b * c, self.yz),
        )  # fmt: skip
        total = np.zeros_like(self.potential)
        for factor, values in terms:
            if abs(factor) > 1e-15:
                total += factor * values
        return total


def around_axis(
    x: Array, y: Array, potential: Array, zz: Array, around: Array, slanted: Array
) -> Field:
    """Return the field of a cathode that is symmetric about the z axis. The last four arguments
    are the field of the same electrode as an anode: Φ, ∂²Φ/∂z², (∂Φ/∂r)/r and (∂²Φ/∂r∂z)/r. They
    must be finite on the axis."""
    r2 = x * x + y * y
    # ∂²Φ/∂r² follows from Laplace's equation; on the axis it equals (∂Φ/∂r)/r.
    stretch = np.divide(-zz - 2 * around, r2, out=np.zeros_like(r2), where=r2 > 1e-12)
    return Field(
        -potential, -(around + x * x * stretch), -(around + y * y * stretch), -zz,
        -(x * y * stretch), -(x * slanted), -(y * slanted),
    )  # fmt: skip


def line_in_plane(x: Array, depth: float | Array) -> Field:
    """Return the field of a line source in the paper's two-dimensional medium, relative to ρI/2πL.

    L is the length of the line. Eq. 3 to 5: Φ = −log R, ∂²Φ/∂x² ∝ (y² − x²) / (x² + y²)² at depth
    y. Φ has no unit and an arbitrary constant; derivatives are in 1/mm².
    """
    r2 = x * x + depth * depth
    xx = (depth * depth - x * x) / r2**2
    zero = np.zeros_like(x)
    return Field(np.log(r2) / 2, xx, zero, -xx, zero, -2 * x * depth / r2**2, zero)


def point(x: Array, y: Array, depth: float | Array) -> Field:
    """Return the field of a point electrode, Φ = 1/R."""
    r2 = x * x + y * y + depth * depth
    cube = r2**-1.5
    fifth = cube / r2
    return around_axis(
        x, y, r2**-0.5, (3 * depth * depth - r2) * fifth, -cube, 3 * depth * fifth
    )  # fmt: skip


def disc(x: Array, y: Array, depth: float | Array, radius: float) -> Field:
    """Return the field of an equipotential disc of radius a (Weber's disc).

    Its potential equals that of point sources evenly distributed along an imaginary line: Φ =
    1/(2a) ∫ ds / √(r² + (z + is)²) for s from −a to a, which is arcsin(2a / (√((r−a)²+z²) +
    √((r+a)²+z²))) / a (Wiley and Webster 1982). With ζ = z + ia and S = √(r² + ζ²) its derivatives
    are ∂²Φ/∂z² = −Im(ζ/S³)/a, (∂Φ/∂r)/r = Im(1/(S(ζ + S)))/a and (∂²Φ/∂r∂z)/r = −Im(1/S³)/a.
    """
    r2 = x * x + y * y
    zeta = depth + 1j * radius
    s = np.sqrt(r2 + zeta * zeta)
    cube = 1 / s**3
    return around_axis(
        x, y, disc_potential(np.sqrt(r2), depth, radius), -(zeta * cube).imag / radius,
        (1 / (s * (zeta + s))).imag / radius, -cube.imag / radius,
    )  # fmt: skip


def disc_potential(r: Array, depth: float | Array, radius: float) -> Array:
    """Return the anodic potential of `disc` at distances r from its axis."""
    below = np.asarray(depth * depth)
    size = np.broadcast_shapes(np.shape(r), below.shape)
    # Compute in place: allocating large arrays takes longer than the arithmetic.
    span, outer = np.empty(size), np.empty(size)
    for integral, away in ((span, -radius), (outer, radius)):
        np.add(r, away, out=integral)
        np.square(integral, out=integral)
        integral += below
        np.sqrt(integral, out=integral)
    span += outer
    np.divide(2 * radius, span, out=span)
    np.arcsin(span, out=span)
    span /= radius
    return span


def annulus(x: Array, y: Array, depth: float | Array, outer: float, inner: float) -> Field:
    """Return the field of an annulus with uniform current density."""
    total = np.zeros((len(Field._fields), *np.broadcast_shapes(x.shape, np.shape(depth))))
    for share, radius in _discs_of_annulus(depth, outer, inner):
        total += share * np.array(disc(x, y, depth, radius))
    return Field(*total)


def annulus_potential(r: Array, depth: float | Array, outer: float, inner: float) -> Array:
    """Return the anodic potential of `annulus` at distances r from its axis."""
    total = np.zeros(np.broadcast_shapes(np.shape(r), np.shape(depth)))
    for share, radius in _discs_of_annulus(depth, outer, inner):
        total += share * disc_potential(r, depth, radius)
    return total


def _discs_of_annulus(
    depth: float | Array, outer: float, inner: float
) -> list[tuple[float, float]]:
    """Return shares and radii of equipotential discs that add up to an annulus of uniform density.

    An annulus is a disc with uniform density minus a smaller one. A disc with uniform density and
    radius b is a weighted mean of equipotential discs. Their radii are b sin φ, where φ goes from 0
    to π/2, and the weight is 2 sin²φ. Proof: the density at radius s is proportional to the
    integral of t dt / √((b² − t²)(t² − s²)) for t from s to b, which is π/2 for every s. The
    midpoint rule with n angles has an error of about exp(−4n arsinh(z/b)).
    """
    discs: list[tuple[float, float]] = []
    for radius, sign in ((outer, 1.0), (inner, -1.0)):
        count = math.ceil(6 / np.arcsinh(np.min(depth) / radius))
        sines = np.sin((np.arange(count) + 0.5) * np.pi / (2 * count))
        shares = sign * radius**2 / (outer**2 - inner**2) * 2 * sines**2 / count
        discs += zip(shares.tolist(), (radius * sines).tolist(), strict=True)
    return discs


def rectangle(x: Array, y: Array, depth: float | Array, width: float, height: float) -> Field:
    """Return the field of a rectangle with uniform current density and sides along x and y.

    The integral of 1/R over a rectangle is the sum of u ln(v + R) + v ln(u + R) − z arctan(uv/zR)
    over its corners. Its second derivatives are algebraic (Durand 1964).
    """
    total = [np.zeros(np.broadcast(x, y).shape) for _ in range(6)]
    z2 = depth * depth
    for sign_u in (1.0, -1.0):
        u = x + sign_u * width / 2
        for sign_v in (1.0, -1.0):
            v = y + sign_v * height / 2
            sign = sign_u * sign_v / (width * height)
            uz, vz = u * u + z2, v * v + z2
            r = np.sqrt(uz + v * v)
            # Use arsinh for ln(v + R): it is accurate for large negative v.
            total[0] += sign * (
                u * np.arcsinh(v / np.sqrt(uz))
                + v * np.arcsinh(u / np.sqrt(vz))
                - depth * np.arctan2(u * v, depth * r)
            )
            total[1] -= sign * u * v / (r * uz)
            total[2] -= sign * u * v / (r * vz)
            total[3] += sign / r
            total[4] -= sign * v * depth / (r * uz)
            total[5] -= sign * u * depth / (r * vz)
    potential, xx, yy, xy, xz, yz = total
    return Field(-potential, -xx, -yy, xx + yy, -xy, -xz, -yz)


_MARGIN_PITCHES = {"plane": 2.0}
"""Margin of modeled skin around the electrodes, in pitches. Keys are media. All other media have a
margin of 1 pitch. In the medium "plane", 2 pitches give the paper's range of −5 to 5 mm."""


@dataclass(frozen=True, eq=False)
class Afferents:
    """Nodes of Ranvier of one class at one depth: N places with D axon directions each."""

    afferent: Afferent
    position_mm: NDArray[np.float64]  # (N, 2) along the skin
    depth_mm: float  # below the surface
    direction: NDArray[np.float64]  # (D, 3) unit vectors along the axons; z points into the skin
    ending: str | None  # kind of ending; None if the axons continue
    grid: tuple[int, int]  # rows and columns if the places form a lattice, else (N, 1)

    def __post_init__(self) -> None:
        if not self.depth_mm > 0:
            raise DesignError(
                f"a {self.afferent.name} fiber at a depth of {self.depth_mm:g} mm lies outside "
                "the skin: give a depth above 0 mm, measured from the surface into the skin"
            )


def depth_mm(skin: Skin, afferent: Afferent) -> float:
    """Return the depth at which a class is stimulated, mm (Section II-D)."""
    return (skin.ra_depth_mm, skin.sai_depth_mm, skin.pc_depth_mm)[afferent]


def directions(skin: Skin, afferent: Afferent) -> NDArray[np.float64]:
    """Return the axon directions of a class, (D, 3): RA axons are upright, SAI and PC axons are
    horizontal (Fig. 7)."""
    if afferent is Afferent.RA:
        return np.array([[0.0, 0.0, 1.0]])
    return flat_directions(skin.sai_angles_deg)


def flat_directions(angles_deg: tuple[float, ...]) -> NDArray[np.float64]:
    """Return horizontal unit vectors, (D, 3); angles are measured from x toward y."""
    radians = np.radians(angles_deg)
    return np.column_stack([np.cos(radians), np.sin(radians), np.zeros(len(radians))])


def targets(profile: Profile, afferent: Afferent) -> Afferents:
    """Return the target node under each electrode."""
    position, skin = profile.electrodes.position_mm, profile.skin
    direction = directions(skin, afferent)[:1]
    depth = depth_mm(skin, afferent)
    return Afferents(
        afferent, position, depth, direction, _ending(skin, afferent), (len(position), 1)
    )


def everywhere(profile: Profile, afferent: Afferent) -> Afferents:
    """Return the nodes of a class under and around the array, with all axon directions."""
    spacing = profile.skin.node_spacing_mm
    if profile.skin.medium == "plane" and afferent is Afferent.RA:
        # As in the paper, RA axons are one pitch apart; node_spacing_mm is for SAI and PC.
        spacing = profile.electrodes.pitch_mm
    position, grid = _lattice(profile, spacing)
    skin = profile.skin
    return Afferents(
        afferent, position, depth_mm(skin, afferent), directions(skin, afferent),
        _ending(skin, afferent), grid,
    )  # fmt: skip


def along_axon(profile: Profile, afferent: Afferent, site: int) -> tuple[Afferents, ...]:
    """Return the nodes of the axon under a site, one set for each depth. The first node lies below
    the electrode. An upright axon continues downward, a horizontal one to both sides."""
    center = profile.electrodes.position_mm[site]
    skin, first = profile.skin, targets(profile, afferent)
    direction = first.direction[0]
    spacing = skin.node_spacing_mm
    sets: list[tuple[NDArray[np.float64], float, str | None]]
    if direction[2] == 0:
        # Keep only nodes in the region of `everywhere`.
        reach_mm = _reach_mm(profile) + 1e-9
        steps = np.arange(1, int(2 * reach_mm.max() / spacing) + 1) * spacing
        away = np.concatenate([[0.0], steps, -steps])
        position = center + away[:, None] * direction[:2]
        inside = (np.abs(position) <= reach_mm).all(axis=1)
        sets = [(position[inside], first.depth_mm, None)]
    else:
        below = np.arange(1, max(1, int(2 * profile.electrodes.pitch_mm / spacing)) + 1) * spacing
        sets = [(center[None], first.depth_mm, first.ending)]
        sets += [(center[None], first.depth_mm + offset_mm, None) for offset_mm in below]
    return tuple(
        Afferents(afferent, position, depth, first.direction, ending, (len(position), 1))
        for position, depth, ending in sets
    )


def _ending(skin: Skin, afferent: Afferent) -> str | None:
    return skin.ra_ending if afferent is Afferent.RA else None


def _reach_mm(profile: Profile) -> NDArray[np.float64]:
    """Return half the width and half the height of the modeled skin, (2,) mm."""
    electrodes = profile.electrodes
    margin = _MARGIN_PITCHES.get(profile.skin.medium, 1.0) * electrodes.pitch_mm
    return np.asarray(np.abs(electrodes.position_mm).max(axis=0) + margin)


def _lattice(profile: Profile, spacing_mm: float) -> tuple[NDArray[np.float64], tuple[int, int]]:
    plane, reach = profile.skin.medium == "plane", _reach_mm(profile)
    axes = []
    for half in reach:
        steps = int(np.floor(2 * half / spacing_mm + 1e-9))
        axes.append((np.arange(steps + 1) - steps / 2) * spacing_mm)
    x, y = np.meshgrid(axes[0], [0.0] if plane else axes[1])
    return np.column_stack([x.ravel(), y.ravel()]), x.shape


def field_at(
    electrodes: ElectrodeArray,
    skin: Skin,
    position_mm: NDArray[np.float64],
    depth_mm: float | NDArray[np.float64],
) -> tuple[Field, float]:
    """Return the field of each electrode at N points, (N, E), and a factor. The factor converts
    potentials to V/mA, and second derivatives to V/mm² per mA.

    ``position_mm``, (N, 2), has x and y of each point along the skin. ``depth_mm`` is one depth for
    all points, or a depth for each, (N, 1).
    """
    if len(electrodes.kinds) > 1:
        return _field_of_kinds(electrodes, skin, position_mm, depth_mm)
    away = position_mm[:, None, :] - electrodes.position_mm[None, :, :]
    x, y = away[..., 0], away[..., 1]
    ((shape, (outer, inner)),) = electrodes.kinds
    if skin.medium == "plane":
        return line_in_plane(x, depth_mm), 1 / (
            2 * np.pi * skin.conductivity_s_per_m * electrodes.cell_mm[1]
        )
    if shape == "rectangle":
        fields = rectangle(x, y, depth_mm, outer, inner)
    elif shape == "annulus":
        fields = annulus(x, y, depth_mm, outer / 2, inner / 2)
    elif shape == "point":
        fields = point(x, y, depth_mm)
    else:
        fields = disc(x, y, depth_mm, outer / 2)
    return fields, _volts(skin)


def _field_of_kinds(
    electrodes: ElectrodeArray,
    skin: Skin,
    position_mm: NDArray[np.float64],
    depth_mm: float | NDArray[np.float64],
) -> tuple[Field, float]:
    """Return `field_at` of an array with several electrode shapes."""
    field = Field(*np.zeros((len(Field._fields), len(position_mm), len(electrodes))))
    scale = 1.0
    for (shape, size_mm), which in electrodes.kinds.items():
        # An ElectrodeArray has at least two electrodes. If only one has this shape and size, add a
        # second electrode, and drop its column from the result.
        places = electrodes.position_mm[which]
        if len(which) == 1:
            places = np.vstack([places, places + electrodes.pitch_mm])
        alone = replace(electrodes, position_mm=places, shape=shape, size_mm=size_mm, own=None)
        part, scale = field_at(alone, skin, position_mm, depth_mm)
        for into, values in zip(field, part, strict=True):
            into[:, which] = values[:, : len(which)]
    return field, scale


def af_matrix(
    profile: Profile, afferents: Afferents, skin: Skin | None = None
) -> NDArray[np.float64]:
    """Return the AF at nodes, (D·N, E), V/mm² per mA of cathodic current; N rows per direction.

    Positive values depolarize (Eq. 8 and 9). The AF of an active ending is the potential difference
    to its neighbor, divided by the squared internode (McNeal's end node).
    """
    skin = skin or profile.skin
    here, scale = field_at(profile.electrodes, skin, afferents.position_mm, afferents.depth_mm)
    rows = []
    for direction in afferents.direction:
        if afferents.ending == "active":
            step = skin.internode_mm
            beside = replace(
                afferents,
                position_mm=afferents.position_mm + step * direction[:2],
                depth_mm=float(afferents.depth_mm + step * direction[2]),
            )
            next_one, _ = field_at(profile.electrodes, skin, beside.position_mm, beside.depth_mm)
            rows.append((next_one.potential - here.potential) / step**2)
        else:
            rows.append(here.along(direction))
    return np.asarray(scale * np.concatenate(rows))


def potential_mv(profile: Profile, points_mm: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the potential (..., E), mV per mA of cathodic current, at points (..., 3) mm.
    The potential is negative under a cathode."""
    electrodes, skin = profile.electrodes, profile.skin
    flat, depth = points_mm.reshape(-1, 3)[:, :2], points_mm.reshape(-1, 3)[:, 2:]
    closed = {shape for shape, _ in electrodes.kinds} <= {"disc", "annulus"}
    if skin.medium != "plane" and closed:
        r2, across = (flat[:, k, None] - electrodes.position_mm[:, k] for k in (0, 1))
        r2 *= r2
        across *= across
        r2 += across
        potential, scale = np.sqrt(r2, out=r2), _volts(skin)
        alone = len(electrodes.kinds) == 1
        for (shape, (outer, inner)), those in electrodes.kinds.items():
            # For all electrodes, use a slice: an index array would copy.
            which = slice(None) if alone else those
            if shape == "disc":
                potential[:, which] = disc_potential(potential[:, which], depth, outer / 2)
            else:
                potential[:, which] = annulus_potential(
                    potential[:, which], depth, outer / 2, inner / 2
                )
        potential *= -1000 * scale
    else:
        fields, scale = field_at(electrodes, skin, flat, depth)
        potential = 1000 * scale * fields.potential
    return np.asarray(potential.reshape(*points_mm.shape[:-1], len(electrodes)))


def _volts(skin: Skin) -> float:
    """Return the factor that converts fields to V/mA."""
    return 1 / (2 * np.pi * skin.conductivity_s_per_m * (2 if skin.medium == "infinite" else 1))
