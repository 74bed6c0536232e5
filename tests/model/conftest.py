from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drake_hand.model.hand import Hand
from drake_hand.model.object import Object
from drake_hand.model.scene import Scene

WILD = {
    "allegro": "hands/allegro/allegro_hand_right.urdf",
    "allegro_drake": "hands/allegro_drake/allegro_hand_description/urdf/allegro_hand_description_right.urdf",
    "trifinger_pro": "hands/trifinger_pro/trifingerpro.urdf",
    "orca_v1": "hands/orca_v1/v1/models/urdf/orcahand_right.urdf",
}

LINK = """<link name="{name}"><inertial><mass value="0.01"/>
<inertia ixx="1e-6" iyy="1e-6" izz="1e-6" ixy="0" ixz="0" iyz="0"/></inertial>{shape}</link>"""
BALL = '<collision><geometry><sphere radius="0.01"/></geometry></collision>'
JOINT = """<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/>
<origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="0 1 0"/>
<limit lower="-1" upper="1.5" velocity="2" effort="0.5"/>{more}</joint>"""


def link(name: str, shape: str = BALL) -> str:
    return LINK.format(name=name, shape=shape)


def joint(name: str, parent: str, child: str, xyz="0 0 0.03", rpy="0 0 0", more="") -> str:
    return JOINT.format(name=name, parent=parent, child=child, xyz=xyz, rpy=rpy, more=more)


def small_hand() -> list[str]:
    """A base, a wrist joint, a palm off the root's axes, two fingers; one has a link without shape."""
    return [
        link("base"),
        joint("wrist", "base", "palm", xyz="0.01 0.02 0.03", rpy="0.1 0.2 0.3"),
        link("palm"),
        joint("a1", "palm", "a_knuckle", xyz="0 0.05 0.015"),
        link("a_knuckle", ""),
        joint("a2", "a_knuckle", "a_bone", xyz="0 0 0"),
        link("a_bone"),
        joint("a3", "a_bone", "a_tip", more='<mimic joint="a2" multiplier="0.5" offset="0.1"/>'),
        link("a_tip"),
        joint("b1", "palm", "b_bone", xyz="0 -0.05 0.03"),
        link("b_bone"),
        joint("b2", "b_bone", "b_tip"),
        link("b_tip"),
    ]


def four_fingers(R_WP: np.ndarray, tip: str = "") -> str:
    """A hand whose palm faces x of P, three fingers along z in a row along y, one from below that faces them.

    Args:
        R_WP: (3, 3) how P is turned in the palm's frame.
        tip: shape of the last links.
    """
    turn = Rotation.from_matrix(R_WP)

    def at(xyz: tuple[float, float, float], more: Rotation) -> str:
        with warnings.catch_warnings(action="ignore"):  # of gimbal lock: any of its angles will do
            rpy = (turn * more).as_euler("xyz")
        return f'<origin xyz="{" ".join(map(str, turn.apply(xyz)))}" rpy="{" ".join(map(str, rpy))}"/>'

    parts = [link("palm", "")]
    bar = '<collision><origin xyz="0 0 0.02"/><geometry><capsule radius="0.008" length="0.03"/></geometry></collision>'
    bases = {"a": (0.0, -0.04, 0.05), "b": (0.0, 0.04, 0.05), "c": (0.0, 0.0, 0.05), "d": (0.02, 0.05, -0.03)}
    for name, xyz in bases.items():
        facing = Rotation.from_euler("y", 90, degrees=True) if name == "d" else Rotation.identity()
        for k in range(3):
            axis = "1 0 0" if k == 0 else ("0 -1 0" if name == "d" else "0 1 0")
            limits = (-0.5, 0.5) if k == 0 else (-0.2, 1.6)
            origin = at(xyz, facing) if k == 0 else '<origin xyz="0 0 0.045"/>'
            parent = "palm" if k == 0 else f"{name}_{k - 1}"
            parts += [
                f'<joint name="{name}{k}" type="revolute"><parent link="{parent}"/><child link="{name}_{k}"/>{origin}'
                f'<axis xyz="{axis}"/><limit lower="{limits[0]}" upper="{limits[1]}" velocity="2" effort="0.5"/>'
                "</joint>",
                link(f"{name}_{k}", (tip or bar) if k == 2 else bar if k else ""),
            ]
    return f'<robot name="four">{"".join(parts)}</robot>'


HAND_YAML = """
name: small
urdf: small.urdf
palm: palm
fingers:
  - {name: a, tip: {link: a_tip, radius_mm: 6, xyz_mm: [0, 0, 5]}}
  - {name: b, tip: {link: b_tip, radius_mm: 7}}
defaults: {acceleration_deg_s2: 1000, stiffness_nm_rad: 2, damping_nm_s_rad: 0.05}
"""


@pytest.fixture
def small(tmp_path: Path):
    """Writes the small hand, changed by plain replacement; returns the path of its hand file."""

    def write(urdf: dict[str, str] | None = None, yaml: dict[str, str] | None = None) -> Path:
        text = '<robot name="small">\n' + "\n".join(small_hand()) + "\n</robot>\n"
        hand = HAND_YAML
        for old, new in (urdf or {}).items():
            assert old in text
            text = text.replace(old, new, 1)
        for old, new in (yaml or {}).items():
            assert old in hand
            hand = hand.replace(old, new, 1)
        (tmp_path / "small.urdf").write_text(text)
        (tmp_path / "small.hand.yaml").write_text(hand)
        return tmp_path / "small.hand.yaml"

    return write


@pytest.fixture(scope="session")
def kanguera() -> Hand:
    return Hand.load("kanguera")


@pytest.fixture(scope="session")
def scene(kanguera: Hand) -> Scene:
    return Scene(kanguera, Object.load("sphere"))


@pytest.fixture(params=sorted(WILD))
def wild(request, models) -> tuple[str, Path]:
    return request.param, models / WILD[request.param]
