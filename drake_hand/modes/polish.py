"""Exact configurations of a mode near approximate ones, and poses at which one more finger can be set down."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from drake_hand.contact.chain import FingerKinematics
from drake_hand.contact.submodel import Submodel
from drake_hand.contact.surface import Surface
from drake_hand.errors import InputError
from drake_hand.model.scene import Scene
from drake_hand.modes.code import Mode
from drake_hand.modes.constraints import IkOptions, build_ik
from drake_hand.modes.corridor import PoseRegion
from drake_hand.modes.situation import object_of
from drake_hand.modes.solve import Infeasible, ModeSolution, solve_ik

_SPACING = 3e-3
"""m between the places where a finger is tried, if none are given."""
_APART = 6e-3
"""m between places tried one after the other: what is nearer to one is found from it."""
_REACHED = 1e-6
"""m; a place that is missed by less is reached."""
_LOOKED_AT = 24
"""Places nearest to reach whose postures are looked at for collisions before the best are tried."""


def polish(
    scene: Scene,
    mode: Mode,
    q: np.ndarray,
    X_WO: np.ndarray,
    p_OC: Mapping[str, np.ndarray],
    *,
    corridor: PoseRegion | None = None,
    on_surface: Mapping[str, float] | None = None,
    options: IkOptions | None = None,
) -> ModeSolution:
    """The configuration nearest to a given one that keeps all constraints of a mode.

    Distances cost most, and are seldom in the way: they are asked for only where the configuration found without them
    lacks them, and then the one nearest to that is taken.

    Args:
        scene: hand and object.
        mode: of the hand.
        q: (nq,) about where the joints are, rad.
        X_WO: (4, 4) about where the object is.
        p_OC: tip centre (3,) of every finger in contact, m.
        corridor: as for `build_ik`.
        on_surface: as for `build_ik`.
        options: as for `build_ik`.

    Raises:
        Infeasible: with the constraints that are missed, by name.
        InputError: as `build_ik`.
    """
    options = options or IkOptions()
    corridor = corridor or PoseRegion(X_WO=X_WO)
    bare = replace(options, distances=False)

    def program(q: np.ndarray, X_WO: np.ndarray, options: IkOptions):
        return build_ik(scene, mode, X_WO, p_OC, corridor=corridor, on_surface=on_surface, q_guess=q, options=options)

    found = solve_ik(program(q, X_WO, bare))
    if not options.distances or _clear(scene, found, options.clearance):
        return found
    return solve_ik(program(found.q, found.X_WO, options))


def set_down(
    scene: Scene,
    mode: Mode,
    finger: str,
    q: np.ndarray,
    X_WO: np.ndarray,
    p_OC: Mapping[str, np.ndarray],
    *,
    corridor: PoseRegion,
    places: np.ndarray | None = None,
    range_: float = 5e-3,
    tries: int = 6,
    options: IkOptions | None = None,
) -> ModeSolution:
    """A configuration near a given one in which one more finger touches, somewhere on the surface, while others hold.

    Args:
        scene: hand and object.
        mode: before: the finger is free.
        finger: to be set down.
        q: (nq,) where the joints are, rad.
        X_WO: (4, 4) where the object is.
        p_OC: tip centre (3,) of every finger in contact, m; they stay where they are on the object.
        corridor: where the object may go for it.
        places: (M, 3) tip centres in O to try, the most welcome first; all over the surface if not given.
        range_: how far along either tangent the finger may be from such a place, m.
        tries: places to solve for at most, those within the finger's reach, or nearest to it, first.
        options: of the constraint sets.

    Returns:
        The first that is found.

    Raises:
        Infeasible: none was; about the place for which least was missing.
        InputError: the finger is not free.
    """
    hand = scene.hand
    index = hand.finger(finger).index
    if mode.submodels[index].touches:
        raise InputError(f"finger '{finger}' already touches", found=mode.code, expected="a mode in which it is free")
    after, options = mode.replace(index, Submodel.ROLL), options or IkOptions()
    failures = []
    for place, posture in _places(scene, finger, q, X_WO, p_OC, places, tries, options):
        try:
            return polish(
                scene,
                after,
                posture,
                X_WO,
                {**p_OC, finger: place},
                corridor=corridor,
                on_surface={finger: range_},
                options=options,
            )
        except Infeasible as e:
            failures.append(e)
    raise min(failures, key=lambda e: e.evidence.amount or 0.0)


def _places(
    scene: Scene,
    finger: str,
    q: np.ndarray,
    X_WO: np.ndarray,
    p_OC: Mapping[str, np.ndarray],
    places: np.ndarray | None,
    tries: int,
    options: IkOptions,
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Where to try, the best first: tip centre (3,) and posture (nq,) with the finger as near to it as it gets."""
    f = scene.hand.finger(finger)
    if places is None:
        p_OS, nhat_O = Surface.of(object_of(scene)).sample(_SPACING)
        places = p_OS + f.radius * nhat_O
    found, missing = FingerKinematics.of(scene.hand, f).ik(places @ X_WO[:3, :3].T + X_WO[:3, 3])
    missing[missing < _REACHED] = 0.0
    scored: list[tuple[float, np.ndarray, np.ndarray]] = []
    for i in np.argsort(missing, kind="stable"):
        if any(np.linalg.norm(places[i] - place) < _APART for _, place, _ in scored):
            continue
        posture = q.copy()
        posture[f.columns] = found[i]
        scene.set(posture, X_WO)
        pairs = scene.clearances(options.clearance, exclude=[*p_OC, finger])
        short = max((options.clearance - d for a, b, d in pairs if a in f.links or b in f.links), default=0.0)
        scored.append((float(missing[i]) + short, places[i], posture))
        if len(scored) == _LOOKED_AT or sum(not s[0] for s in scored) == tries:
            break
    return [(place, posture) for _, place, posture in sorted(scored, key=lambda s: s[0])[:tries]]


def _clear(scene: Scene, at: ModeSolution, clearance: float) -> bool:
    scene.set(at.q, at.X_WO)
    return not scene.clearances(clearance, exclude=list(at.p_OC))
