"""A pencil held by middle, index and thumb: the scene and posture that the tests of modes share."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drake_hand.contact.chain import FingerKinematics
from drake_hand.contact.surface import Surface
from drake_hand.model.hand import Hand
from drake_hand.model.object import Object
from drake_hand.model.scene import Scene
from drake_hand.modes.code import Mode
from drake_hand.modes.constraints import build_ik
from drake_hand.modes.solve import Infeasible, solve_ik


@dataclass(frozen=True, kw_only=True)
class Held:
    """An object in the hand, in a mode."""

    scene: Scene
    mode: Mode
    X_WO: np.ndarray
    q: np.ndarray
    p_OC: dict[str, np.ndarray]


def _reachable(scene: Scene, X_WO: np.ndarray, spacing: float) -> dict[str, np.ndarray]:
    """Tip centres on the expanded surface that each finger reaches by itself."""
    p_OS, nhat_O = Surface.of(scene.object).sample(spacing)
    reachable = {}
    for finger in scene.hand.fingers:
        p_OC = p_OS + finger.radius * nhat_O
        residual = FingerKinematics.of(scene.hand, finger).ik(p_OC @ X_WO[:3, :3].T + X_WO[:3, 3])[1]
        reachable[finger.name] = p_OC[residual < 1e-6]
    return reachable


def _find_hold(scene: Scene, code: str, X_WO: np.ndarray, *, spacing: float = 3e-3, seed: int = 0) -> Held:
    """The first of random contacts that the mode's constraints allow."""
    mode = Mode.parse(code, [f.name for f in scene.hand.fingers])
    reachable = _reachable(scene, X_WO, spacing)
    rng = np.random.default_rng(seed)
    for _ in range(60):
        names = [scene.hand.fingers[i].name for i in mode.touching]
        contacts = {name: reachable[name][rng.integers(len(reachable[name]))] for name in names}
        try:
            solution = solve_ik(build_ik(scene, mode, X_WO, contacts))
        except Infeasible:
            continue
        return Held(scene=scene, mode=mode, X_WO=X_WO, q=solution.q, p_OC=solution.p_OC)
    raise AssertionError(f"no hold in mode {code} found at {X_WO}")


@pytest.fixture(scope="session")
def held() -> Held:
    X_WO = np.eye(4)
    X_WO[:3, :3] = Rotation.from_euler("x", 90, degrees=True).as_matrix()
    X_WO[:3, 3] = [0.05, 0.0, 0.11]
    return _find_hold(Scene(Hand.load("kanguera"), Object.load("pencil_r8")), "00111", X_WO)


@pytest.fixture(scope="session")
def find_hold() -> Callable[..., Held]:
    """Looks for contacts: (scene, mode code, X_WO)."""
    return _find_hold


@pytest.fixture(scope="session")
def reachable_contacts() -> Callable[..., dict[str, np.ndarray]]:
    """Tip centres each finger reaches: (scene, X_WO, spacing)."""
    return _reachable
