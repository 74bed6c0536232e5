"""How exactly an object gets to random poses without a regrasp, and how often it does.

    python benchmarks/in_grasp.py allegro.hand.yaml
    python benchmarks/in_grasp.py kanguera --object cube --goals 20 --grasps 2

Goals lie up to 50 mm and 20 deg from where the object is grasped. Drawn are those that are within reach: at each of ten
poses on the straight way there, every fingertip of the grasp can still be at its contact. Fingers that are shorter of
room than that are what the search then has to cope with: contacts roll, bodies are in the way, forces have to hold.
Errors are those of the certificate: the object's pose at the end of the plan, against the goal.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from drake_hand import api
from drake_hand.contact.chain import FingerKinematics
from drake_hand.errors import NoPlanFound
from drake_hand.model.hand import Hand
from drake_hand.plans.plan import Plan
from drake_hand.plans.task import Grasp, MoveTo, Options, Physics, Pose, Step, Task
from drake_hand.verify.goal import pose_matrix

FARTHEST, MOST = 0.05, np.radians(20.0)
"""m and rad from the grasp to a goal."""
POSES = 10
"""On the straight way at which fingers have to reach."""


def main() -> None:
    """Plans to every goal and prints a line for each, then the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("hand")
    parser.add_argument("--object", default="cylinder")
    parser.add_argument("--goals", type=int, default=100)
    parser.add_argument("--grasps", type=int, default=5, help="that the goals are shared out to")
    parser.add_argument("--time-limit", type=float, default=60.0, metavar="S", help="of each goal")
    args = parser.parse_args()
    hand, errors, tried = Hand.load(args.hand), [], 0
    print("| grasp | mm away | deg away | goal error mm | goal error deg | plan cpu s | result |\n|" + "---|" * 7)
    for seed in range(args.grasps):
        held = api.plan(_task(args.hand, args.object, "auto", [Step(grasp=Grasp())], seed, args.time_limit))
        share = args.goals // args.grasps + (seed < args.goals % args.grasps)
        for X_WO in _goals(hand, held, share, np.random.default_rng(seed)):
            tried += 1
            X_WS = _matrix(held)
            turn = Rotation.from_matrix(X_WO[:3, :3])
            away = 1e3 * np.linalg.norm(X_WO[:3, 3] - X_WS[:3, 3])
            angle = np.degrees((turn * Rotation.from_matrix(X_WS[:3, :3]).inv()).magnitude())
            move = MoveTo(xyz_mm=tuple(1e3 * X_WO[:3, 3]), rpy_deg=tuple(turn.as_euler("xyz", degrees=True)))
            task = _task(args.hand, args.object, _start(held), [Step(move_to=move)], 0, args.time_limit, held)
            began = time.process_time()
            try:
                worst = api.plan(task).certificate.worst  # type: ignore[union-attr]
            except NoPlanFound as e:
                error, result = None, f"{e.status}: {e.reason}"
            else:
                error, result = (worst["goal_position_mm"].value, worst["goal_rotation_deg"].value), "certified"
                errors.append(error)
            figures = "| |" if error is None else f"{error[0]:.4f} | {error[1]:.4f} |"
            took = time.process_time() - began
            print(f"| {held.modes[-1]} | {away:.0f} | {angle:.0f} | {figures} {took:.1f} | {result} |", flush=True)
    print(f"\n{len(errors)} of {tried} certified")
    if errors:
        (median, p95) = np.percentile(np.array(errors), [50, 95], axis=0)
        print(f"goal error: median {median[0]:.4f} mm, {median[1]:.4f} deg; p95 {p95[0]:.4f} mm, {p95[1]:.4f} deg")


def _task(
    hand: str, object_: str, start: Pose | str, motion: list[Step], seed: int, limit: float, held: Plan | None = None
) -> Task:
    """A task; one that begins in a grasp keeps to its mode, and to its gravity."""
    gravity = "auto" if held is None else held.task.physics.gravity
    return Task(
        hand=hand,
        object=object_,
        start=start,  # type: ignore[arg-type]
        motion=motion,
        physics=Physics(gravity=gravity),
        options=Options(time_limit_s=limit, seed=seed, modes=None if held is None else [held.modes[-1]]),
    )


def _start(held: Plan) -> Pose:
    start = held.task.start
    assert isinstance(start, Pose), "a plan states where it starts"
    joints = dict(zip(held.joints, np.degrees(held.parts[-1].q[-1]).tolist(), strict=True))
    return Pose(xyz_mm=start.xyz_mm, rpy_deg=start.rpy_deg, joints_deg=joints)


def _matrix(held: Plan) -> np.ndarray:
    """(4, 4) where the object is grasped."""
    assert isinstance(held.task.start, Pose), "a plan states where it starts"
    return pose_matrix(held.task.start)


def _goals(hand: Hand, held: Plan, count: int, rng: np.random.Generator) -> Iterator[np.ndarray]:
    """Poses X_WO (4, 4) within reach of the fingers that hold the object."""
    X_WS = _matrix(held)
    q = np.array(held.parts[-1].q[-1])
    tips = []
    for name in held.parts[-1].contacts:
        finger = hand.finger(name)
        kin = FingerKinematics.of(hand, finger)
        p_WC, _ = kin.fk(q[finger.columns][None])
        tips.append((kin, q[finger.columns], (p_WC[0] - X_WS[:3, 3]) @ X_WS[:3, :3]))
    while count:
        far, angle = FARTHEST * rng.random(), MOST * rng.random()
        way, axis = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
        R_WO = Rotation.from_rotvec(angle * axis) * Rotation.from_matrix(X_WS[:3, :3])
        share = np.linspace(0, 1, POSES + 1)[1:]
        R = Slerp([0, 1], Rotation.concatenate([Rotation.from_matrix(X_WS[:3, :3]), R_WO]))(share).as_matrix()
        p = X_WS[:3, 3] + far * way * share[:, None]
        at = [(kin, home, R @ p_OC + p) for kin, home, p_OC in tips]
        if all((kin.ik(x, np.repeat(home[None], POSES, axis=0))[1] < 1e-4).all() for kin, home, x in at):
            X_WO = np.eye(4)
            X_WO[:3, :3], X_WO[:3, 3] = R[-1], p[-1]
            count -= 1
            yield X_WO


if __name__ == "__main__":
    main()
