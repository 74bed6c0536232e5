"""What of an object's rotation can be seen: nothing of a turn about an axis around which it looks the same."""

from __future__ import annotations

from xml.etree import ElementTree as ET

import numpy as np
from scipy.spatial.transform import Rotation

from drake_hand.contact.surface import Surface
from drake_hand.model.object import Object


def unseen_turns(object_: Object) -> np.ndarray:
    """(k, 3) orthogonal axes of O about which a turn of the object cannot be seen.

    An axis of symmetry of its shape is one, unless something is drawn on it that turns with it: a box, or a round shape
    beside the axis (the stripes of the bundled pencils). Drawn meshes are taken for round.
    """
    surface = Surface.of(object_)
    axes = [
        e for e in np.eye(3) if surface.symmetric_about(e, surface.centre) and not _marked(object_, surface.centre, e)
    ]
    return np.array(axes).reshape(-1, 3)


def _marked(object_: Object, point_O: np.ndarray, axis_O: np.ndarray) -> bool:
    """Whether what is drawn shows a turn about a line."""
    for visual in ET.fromstring(object_.body_xml).iterfind("link/visual"):
        shape, origin = visual.find("geometry/*"), visual.find("origin")
        kind = "" if shape is None else shape.tag.rpartition("}")[2]
        xyz, rpy = (
            np.array([float(x) for x in (origin.get(key) or "0 0 0").split()]) if origin is not None else np.zeros(3)
            for key in ("xyz", "rpy")
        )
        if kind == "mesh":
            continue
        beside = np.linalg.norm(np.cross(xyz - point_O, axis_O)) > 1e-6
        along = abs(Rotation.from_euler("xyz", rpy).as_matrix()[:, 2] @ axis_O) > 1 - 1e-6
        if beside or (kind != "sphere" and not (kind in ("cylinder", "capsule") and along)):
            return True
    return False
