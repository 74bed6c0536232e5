"""A hand-made plan: reach for a resting pencil, hold it, lift the index finger. Good to look at; proves nothing."""

import signal
from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import settings
from stalls import WATCH

from drake_hand.contact.chain import FingerKinematics
from drake_hand.model.hand import Hand
from drake_hand.model.object import Object
from drake_hand.plans.plan import Contact, Part, Plan
from drake_hand.plans.task import Task

FINGERS = ("middle", "index", "thumb")
RADIUS = 0.008
P_WO = np.array([0.055, 0.015, 0.115])


def _part(mode: str, events: list[str], t0: float, q0: np.ndarray, q1: np.ndarray, hand: Hand, points: dict) -> Part:
    """One second from q0 to q1 and rest at both ends; the object rests."""
    s = np.linspace(0, 1, 11)
    blend, rate = 3 * s**2 - 2 * s**3, 6 * s - 6 * s**2
    pose = [[0.5**0.5, 0.5**0.5, 0.0, 0.0, *P_WO.tolist()]] * len(s)
    touching = [f.name for f, c in zip(hand.fingers, mode, strict=True) if c != "0"]
    return Part(
        mode=mode,
        events=events,
        t=(t0 + s).tolist(),
        q=(q0 + blend[:, None] * (q1 - q0)).tolist(),
        v=(rate[:, None] * (q1 - q0)).tolist(),
        X_WO=pose,
        V_WO=[[0.0] * 7] * len(s),
        contacts={
            f: Contact(p_OP=[points[f][0].tolist()] * len(s), f_W=[points[f][1].tolist()] * len(s)) for f in touching
        },
        q_offset=np.zeros((len(s), hand.nq)).tolist(),
    )


settings.register_profile("timeless", deadline=None)  # how long a test takes says how busy the machine is
settings.load_profile("timeless")
signal.signal(signal.SIGINT, signal.default_int_handler)  # what runs in the background ignores it, and its children do


def pytest_collection_modifyitems(items):
    """What keeps time is run again where it failed while the machine stood still, and only there."""
    for item in items:
        if item.get_closest_marker("clocked"):
            item.add_marker(pytest.mark.flaky(reruns=3, condition=WATCH.stood_still))


@pytest.fixture(autouse=True)
def _watched(request):
    if request.node.get_closest_marker("clocked"):
        with WATCH:
            yield
    else:
        yield


@pytest.fixture(scope="session")
def models() -> Path:
    """The folder of hands and objects nobody here wrote; a clone without it skips what needs it."""
    folder = Path(__file__).parents[2] / "shared/models"
    if not folder.is_dir():
        pytest.skip("the folder of real models, ../shared/models, is not beside the checkout")
    return folder.resolve()


@pytest.fixture(scope="session")
def hand() -> Hand:
    return Hand.load("kanguera")


@pytest.fixture(scope="session")
def sample_plan(hand: Hand) -> Plan:
    R_WO = np.array([[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]])  # rpy 90, 0, 0: pencil along y
    grip, points = hand.q_home.copy(), {}
    for name, angle in (("middle", 80), ("index", 60), ("thumb", 245)):
        finger = hand.finger(name)
        n_O = np.array([np.cos(np.radians(angle)), np.sin(np.radians(angle)), 0.0])
        p_OP = RADIUS * n_O + np.array([[0, 0, 1.0]]) * np.linspace(-0.03, 0.03, 61)[:, None]
        q, residual = FingerKinematics.of(hand, finger).ik(P_WO + (p_OP + finger.radius * n_O) @ R_WO.T)
        best = int(np.median(np.flatnonzero(residual < 1e-6)))
        grip[finger.columns] = q[best]
        points[name] = (p_OP[best], -0.4 * R_WO @ n_O)
    lifted = grip.copy()
    lifted[hand.finger("index").columns] = hand.q_home[hand.finger("index").columns]
    home = hand.q_home
    parts = [
        _part("00000", [], 0.0, home, grip, hand, points),
        _part("00111", [f"make {f}" for f in FINGERS], 1.0, grip, grip, hand, points),
        _part("00101", ["break index"], 2.0, grip, lifted, hand, points),
        _part("00101", [], 3.0, lifted, grip, hand, points),
        _part("00121", ["make index"], 4.0, grip, grip, hand, points),
    ]
    task = {
        "hand": "kanguera",
        "object": "pencil_r8",
        "start": {"xyz_mm": (1e3 * P_WO).tolist(), "rpy_deg": [90, 0, 0]},
        "motion": [{"grasp": {"fingers": list(FINGERS)}}],
        "physics": {"gravity": [-9.81, 0, 0]},
    }
    object_ = Object.load("pencil_r8")
    return Plan(
        task=msgspec.convert(task, Task),
        hand=hand.name,
        urdf_sha256=hand.urdf_sha256,
        fingers=[f.name for f in hand.fingers],
        joints=list(hand.joints),
        object_sha256=object_.sha256,
        object_mass_kg=object_.mass,
        parts=parts,
        seed=0,
        versions={},
    )
