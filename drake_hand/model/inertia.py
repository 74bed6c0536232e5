"""`Inertial`: mass and inertia of a link, read, judged and written."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from xml.etree import ElementTree as ET

import numpy as np

from drake_hand.model.geometry import Geometry
from drake_hand.model.xml import Source, read_origin

_TENSOR = {"ixx": (0, 0), "iyy": (1, 1), "izz": (2, 2), "ixy": (0, 1), "ixz": (0, 2), "iyz": (1, 2)}


@dataclass(frozen=True, kw_only=True)
class Inertial:
    """Mass, mass centre and inertia about it, in the axes of the link's frame L."""

    mass: float
    """kg."""
    p_LCom: np.ndarray
    """(3,) m."""
    I_LCom: np.ndarray
    """(3, 3) kg m^2."""

    @property
    def flaw(self) -> str:
        """What no real body can have, in words; empty if all is well."""
        if self.mass <= 0:
            return "no mass" if self.mass == 0 else "negative mass"
        moments = np.linalg.eigvalsh(self.I_LCom)
        if moments[0] <= 0:
            return "moments of inertia not all positive"
        if moments[0] + moments[1] < moments[2] * (1 - 1e-6):
            return "one moment of inertia exceeds the sum of the other two"
        return ""

    @classmethod
    def read(cls, link: ET.Element, source: Source) -> Inertial:
        """What a URDF link states; zeros where it states nothing.

        Raises:
            InputError: numbers missing or not finite.
        """
        element = link.find("inertial")
        if element is None:
            return cls(mass=0.0, p_LCom=np.zeros(3), I_LCom=np.zeros((3, 3)))
        X = read_origin(element.find("origin"), source)
        mass, inertia = element.find("mass"), element.find("inertia")
        tensor = np.zeros((3, 3))
        for tag, (i, j) in _TENSOR.items():
            tensor[i, j] = tensor[j, i] = source.numbers("0" if inertia is None else inertia.get(tag, "0"), 1)[0]
        return cls(
            mass=0.0 if mass is None else float(source.numbers(mass.get("value"), 1)[0]),
            p_LCom=X[:3, 3],
            I_LCom=X[:3, :3] @ tensor @ X[:3, :3].T,
        )

    @classmethod
    def solid(cls, geometries: Iterable[Geometry], *, mass: float | None = None, density: float = 1000.0) -> Inertial:
        """Of a solid of uniform density (kg/m^3, unless `mass` is given); where pieces overlap both count."""
        import trimesh

        solid: trimesh.Trimesh = trimesh.util.concatenate([g.to_trimesh() for g in geometries])  # type: ignore[assignment]
        solid.density = density if mass is None else mass / solid.volume
        return cls(mass=float(solid.mass), p_LCom=np.array(solid.center_mass), I_LCom=np.array(solid.moment_inertia))

    def seen_from(self, X_OL: np.ndarray) -> Inertial:
        """The same in the axes of another frame O, in which L is at X_OL (4, 4)."""
        R = X_OL[:3, :3]
        return Inertial(mass=self.mass, p_LCom=R @ self.p_LCom + X_OL[:3, 3], I_LCom=R @ self.I_LCom @ R.T)

    @classmethod
    def sum(cls, parts: Iterable[Inertial]) -> Inertial:
        """Of parts fixed to one another, all in one frame; at least one has a mass."""
        parts = list(parts)
        mass = sum(part.mass for part in parts)
        com = sum((part.mass * part.p_LCom for part in parts), np.zeros(3)) / mass
        moments = np.zeros((3, 3))
        for part in parts:
            d = part.p_LCom - com
            moments += part.I_LCom + part.mass * (d @ d * np.eye(3) - np.outer(d, d))
        return cls(mass=mass, p_LCom=com, I_LCom=moments)

    def write(self, link: ET.Element) -> None:
        """Makes this the ``<inertial>`` of a URDF link."""
        for old in link.findall("inertial"):
            link.remove(old)
        element = ET.SubElement(link, "inertial")
        ET.SubElement(element, "origin", xyz=" ".join(f"{v:.9g}" for v in self.p_LCom))
        ET.SubElement(element, "mass", value=f"{self.mass:.9g}")
        ET.SubElement(element, "inertia", {tag: f"{self.I_LCom[i, j]:.9g}" for tag, (i, j) in _TENSOR.items()})
