"""How exactly an object gets to random poses inside one grasp, and how often it does.

    python benchmarks/in_grasp.py allegro.hand.yaml
    python benchmarks/in_grasp.py kanguera --object cube --goals 20 --starts 2

From start poses that the planner chooses, an object is grasped and brought to goals up to 50 mm and 20 deg away; the
planner chooses the grasp. Drawn are goals within reach: at each of ten poses on the straight way there, the fingertips
of some grasp at the start can still be at its contacts. That contacts roll, bodies are in the way and forces have to
hold is what planning then has to cope with. Errors are those of the certificate: the object's pose at the end, against
the goal.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from typing import Literal

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
    parser.add_argument("--starts", type=int, default=5, help="that the goals are shared out to")
    parser.add_argument("--time-limit", type=float, default=60.0, metavar="S", help="of each goal")
    args = parser.parse_args()
    hand, errors, tried = Hand.load(args.hand), [], 0
    print("| start | mm away | deg away | goal error mm | goal error deg | cpu s | result |\n|" + "---|" * 7)
    for seed in range(args.starts):
        held = api.plan(_task(args, "auto", Physics(gravity="auto"), seed, []))
        share = args.goals // args.starts + (seed < args.goals % args.starts)
        for X_WO in _goals(hand, held, share, np.random.default_rng(seed)):
            tried += 1
            X_WS, turn = _start(held), Rotation.from_matrix(X_WO[:3, :3])
            away = 1e3 * np.linalg.norm(X_WO[:3, 3] - X_WS[:3, 3])
            angle = np.degrees((turn * Rotation.from_matrix(X_WS[:3, :3]).inv()).magnitude())
            xyz, rpy = (1e3 * X_WO[:3, 3]).tolist(), turn.as_euler("xyz", degrees=True).tolist()
            move = Step(move_to=MoveTo(xyz_mm=tuple(xyz), rpy_deg=tuple(rpy)))
            figures, began = "| |", time.process_time()
            try:
                found = api.solve(_task(args, held.task.start, held.task.physics, 0, [move]))
            except NoPlanFound as e:
                result = f"{e.status}: {e.reason}"
            else:
                result = f"{found.regrasps} regrasps"
                if not found.regrasps and found.plan.certificate:
                    worst = found.plan.certificate.worst
                    error = [worst[f"goal_{what}"].value for what in ("position_mm", "rotation_deg")]
                    errors.append(error)
                    figures, result = f"{error[0]:.4f} | {error[1]:.4f} |", "certified"
            took = time.process_time() - began
            print(f"| {seed} | {away:.0f} | {angle:.0f} | {figures} {took:.1f} | {result} |", flush=True)
    print(f"\n{len(errors)} of {tried} certified inside one grasp")
    if errors:
        (median, p95) = np.percentile(np.array(errors), [50, 95], axis=0)
        print(f"goal error: median {median[0]:.4f} mm, {median[1]:.4f} deg; p95 {p95[0]:.4f} mm, {p95[1]:.4f} deg")


def _task(
    args: argparse.Namespace, start: Pose | Literal["auto"], physics: Physics, seed: int, motion: list[Step]
) -> Task:
    """A grasp, and what follows it."""
    options = Options(time_limit_s=args.time_limit, seed=seed)
    steps = [Step(grasp=Grasp()), *motion]
    return Task(hand=args.hand, object=args.object, start=start, motion=steps, physics=physics, options=options)


def _start(held: Plan) -> np.ndarray:
    """(4, 4) where the object is grasped."""
    assert isinstance(held.task.start, Pose), "a plan states where it starts"
    return pose_matrix(held.task.start)


def _goals(hand: Hand, held: Plan, count: int, rng: np.random.Generator) -> Iterator[np.ndarray]:
    """Poses X_WO (4, 4) within reach of the fingers that hold the object."""
    X_WS = _start(held)
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
