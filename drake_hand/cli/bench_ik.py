"""How fast is the batched inverse kinematics, compared with one Drake program or one Pinocchio loop per contact?"""

from __future__ import annotations

import importlib.util
import time
from collections.abc import Callable

import numpy as np

from drake_hand.contact.chain import FingerKinematics
from drake_hand.model.hand import Finger, Hand

IK_TOLERANCE_M = 1e-5
"""Residual all of them have to reach, m."""
BATCH_ROWS = 20_000
"""Contacts per finger in one batch; the others solve the first `SINGLE_ROWS` of them, one by one."""
SINGLE_ROWS = 20

Solver = Callable[[np.ndarray], np.ndarray]
"""From targets p_WC (..., 3) to joint angles of a finger (..., m)."""


def ik_samples(hand: Hand, *, repeats: int, seed: int) -> dict[str, list[float]]:
    """Rates and ratios of contacts solved to `IK_TOLERANCE_M`, all fingers of a hand, one value per repeat.

    Targets are tip centres at random joint angles. One not solved to the tolerance does not count as solved, but its
    time counts. The single solvers start in the middle of the joint ranges.

    Args:
        hand: to solve for.
        repeats: fresh targets each time.
        seed: of the targets.

    Returns:
        ``ik_per_s`` and ``ik_vs_drake`` (rate over rate), and ``ik_vs_pinocchio`` where the package pin is installed.
    """
    rng = np.random.default_rng(seed)
    fingers = [FingerKinematics.of(hand, f) for f in hand.fingers]
    batched = [_batch(f) for f in fingers]
    single = {"drake": _drake_solvers(hand)}
    if importlib.util.find_spec("pinocchio"):
        single["pinocchio"] = _pinocchio_solvers(hand, fingers)
    samples: dict[str, list[float]] = {key: [] for key in ("ik_per_s", *(f"ik_vs_{name}" for name in single))}
    for _ in range(repeats):
        targets = [f.fk(rng.uniform(f.lower, f.upper, (BATCH_ROWS, len(f.lower))))[0] for f in fingers]
        rate = _rate(fingers, targets, batched)
        samples["ik_per_s"].append(rate)
        few = [t[:SINGLE_ROWS] for t in targets]
        for name, solvers in single.items():
            samples[f"ik_vs_{name}"].append(rate / _rate(fingers, few, [_one_by_one(s) for s in solvers]))
    return samples


def _rate(fingers: list[FingerKinematics], targets: list[np.ndarray], solvers: list[Solver]) -> float:
    """Targets (N, 3) per finger solved per second."""
    solved, elapsed = 0, 0.0
    for finger, p_WC, solve in zip(fingers, targets, solvers, strict=True):
        start = time.perf_counter()
        q = solve(p_WC)
        elapsed += time.perf_counter() - start
        solved += int((np.linalg.norm(finger.fk(q)[0] - p_WC, axis=1) <= IK_TOLERANCE_M).sum())
    return solved / elapsed


def _batch(finger: FingerKinematics) -> Solver:
    finger.ik(finger.fk(finger.lower[None])[0])  # starting points are laid out once per finger and process
    return lambda p_WC: finger.ik(p_WC, tolerance=IK_TOLERANCE_M)[0]


def _one_by_one(solve: Solver) -> Solver:
    return lambda p_WC: np.array([solve(p) for p in p_WC])


def _drake_solvers(hand: Hand) -> list[Solver]:
    """What one would write without a batched kernel: an InverseKinematics program per contact, solved by SNOPT."""
    from pydrake.multibody.inverse_kinematics import InverseKinematics
    from pydrake.multibody.parsing import Parser
    from pydrake.multibody.plant import MultibodyPlant
    from pydrake.solvers import SnoptSolver

    plant = MultibodyPlant(0.0)
    Parser(plant).AddModels(str(hand.urdf.file))
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName(hand.palm))
    plant.Finalize()
    middle = (plant.GetPositionLowerLimits() + plant.GetPositionUpperLimits()) / 2
    # SNOPT oversteps bounds by up to 1e-6 m: the corners of a box of 0.4 of the tolerance stay within it all the same.
    snopt, box = SnoptSolver(), np.full(3, 0.4 * IK_TOLERANCE_M)

    def solver(f: Finger) -> Solver:
        tip = plant.GetFrameByName(f.tip_link)
        columns = [plant.GetJointByName(j).position_start() for j in f.joints]

        def solve(p_WC: np.ndarray) -> np.ndarray:
            ik = InverseKinematics(plant)
            ik.AddPositionConstraint(tip, f.p_LC, plant.world_frame(), p_WC - box, p_WC + box)
            return snopt.Solve(ik.prog(), middle).GetSolution(ik.q())[columns]

        return solve

    return [solver(f) for f in hand.fingers]


def _pinocchio_solvers(hand: Hand, fingers: list[FingerKinematics]) -> list[Solver]:
    """The closed loop of Pinocchio's example: damped steps by the frame's Jacobian, within limits."""
    import pinocchio as pin

    model = pin.buildModelFromUrdf(str(hand.urdf.file), mimic=True)
    data = model.createData()

    def solver(f: FingerKinematics) -> Solver:
        tip = model.getFrameId(f.finger.tip_link)
        joints = [model.joints[model.getJointId(j)] for j in f.finger.joints]
        q_columns, v_columns = [j.idx_q for j in joints], [j.idx_v for j in joints]

        def solve(p_WC: np.ndarray) -> np.ndarray:
            q = pin.neutral(model)
            q[q_columns] = (f.lower + f.upper) / 2
            for _ in range(50):
                pin.framesForwardKinematics(model, data, q)
                arm_W = data.oMf[tip].rotation @ f.finger.p_LC
                e = p_WC - data.oMf[tip].translation - arm_W
                if e @ e <= IK_TOLERANCE_M**2:
                    break
                J = pin.computeFrameJacobian(model, data, q, tip, pin.LOCAL_WORLD_ALIGNED)[:, v_columns]
                J = J[:3] - pin.skew(arm_W) @ J[3:]
                step = J.T @ np.linalg.solve(J @ J.T + 1e-6 * np.eye(3), e)
                q[q_columns] = np.clip(q[q_columns] + step, f.lower, f.upper)
            return q[q_columns]

        return solve

    return [solver(f) for f in fingers]
