"""Whether the commanded joint offsets produce the contact forces that a plan states."""

from __future__ import annotations

import numpy as np

from drake_hand.compiled import njit
from drake_hand.model.scene import Scene
from drake_hand.plans.plan import Plan
from drake_hand.verify.contacts import FREE, ROLL, SLIDE, runs
from drake_hand.verify.findings import Findings
from drake_hand.verify.observe import Observed

COMMAND_LIMIT_N = 0.2
"""How much the forces may differ: a fifth, as much as friction and stiffness are off in physics' trials, or 0.2 N."""
_LIGHT_PRESS_N = 0.02
"""N; a pad pressed less than this yields as much as if it were."""


def check_command(seen: Observed, plan: Plan, scene: Scene, findings: Findings) -> None:
    """Judges, finger by finger, the forces that the commands produce against those stated.

    A servo of stiffness K commanded to q + o turns with torque K o about q. Some of it holds up the links, some presses
    the pad in, some moves the tip along where the pressed tip, on its smaller radius, has rolled less far than the
    plan's, and where it creeps because it spins; what is left presses the object, which stays where it is. With J of
    the tip at the contact, x = J (o - (J' f - weight) / K) is how far the commands move the tip beyond what the stated
    forces f take, d how far it has to move for the pad; a tip held by the object answers with
    (J J' / K + pad)^-1 (x - d).

    Where a tip slides, or pivots as in the paper, friction is what it is, and only the normal force is judged. What is
    off counts per newton where a contact comes to bear more than one.
    """
    s, hand = seen.states, scene.hand
    assert scene.object is not None
    error = np.full(seen.digits.shape, np.nan)
    if plan.task.options.hold == "equilibrium":
        rolls = plan.task.options.model == "rolling"
        for i, finger in enumerate(hand.fingers):
            c = finger.columns
            for first, end in runs(seen.digits[:, i] != FREE):
                rows = slice(first, end)
                R_WO, n_O = s.X_WO[rows, :3, :3], seen.n_O[rows, i]
                n_W = np.einsum("kij,kj->ki", R_WO, n_O)
                J, K = seen.J_WS[rows, i, :, : len(c)], hand.stiffness[c]
                f_W = s.f_W[rows, i]
                press = np.maximum(-np.sum(f_W * n_W, axis=1), 0.0)
                flat = np.pi * hand.pad.hydroelastic_modulus_pa / np.sqrt(seen.bend[rows, i])
                depth = np.sqrt(press / flat)
                pad = 0.5 / np.sqrt(flat * np.maximum(press, _LIGHT_PRESS_N))
                taken = (np.einsum("kic,ki->kc", J, f_W) - seen.weight[rows, c]) / K
                moved = np.einsum("kic,kc->ki", J, s.q_offset[rows, c] - taken) + depth[:, None] * n_W
                yields = J / K @ np.swapaxes(J, 1, 2) + pad[:, None, None] * np.eye(3)
                normal = np.sum(moved * n_W, axis=1) / np.einsum("ki,kij,kj->k", n_W, yields, n_W)
                error[rows, i] = np.abs(normal)
                R_OT = np.swapaxes(R_WO, 1, 2) @ seen.X_WC[rows, i, :3, :3]
                for a, b in runs((seen.digits[rows, i] == ROLL) & rolls):
                    slid = a > 0 and seen.digits[first + a - 1, i] == SLIDE
                    moved_O = np.einsum("kji,kj->ki", R_WO[a:b], moved[a:b])
                    # where sliding has left the tip is where the friction stated holds it
                    begin = moved_O[0] - n_O[a] * (n_O[a] @ moved_O[0]) if slid else np.zeros(3)
                    turn, n = tip_turns(R_OT[a:b]), (n_O[a + 1 : b] + n_O[a : b - 1]) / 2
                    f_O = np.einsum("kji,kj->ki", R_WO[a:b], f_W[a:b])
                    patch = np.sqrt(2 * finger.radius * depth[a:b] / np.sqrt(seen.bend[rows, i][a:b]))
                    step = rolled_short(depth[a:b], n_O[a:b], turn, n)
                    step += crept(f_O, n_O[a:b], plan.task.physics.friction, patch, turn, n)
                    aside = np.empty_like(n_O[a:b])
                    aside[0] = begin
                    _carry(step, np.ascontiguousarray(n_O[a:b]), aside)
                    off = moved[a:b] - np.einsum("kij,kj->ki", R_WO[a:b], aside)
                    force = np.linalg.solve(yields[a:b], off[..., None])[..., 0]
                    error[first + a : first + b, i] = np.linalg.norm(force, axis=1)
                error[rows, i] /= max(1.0, np.linalg.norm(f_W, axis=1).max())
    findings.add("command_force_n", error, s.t, s.part, plan.fingers, limit=COMMAND_LIMIT_N)


def tip_turns(R_OT: np.ndarray) -> np.ndarray:
    """(k - 1, 3) small turns in O from each orientation (k, 3, 3) of a tip to the next, rad."""
    D = R_OT[1:] @ np.swapaxes(R_OT[:-1], 1, 2)
    return np.stack([D[:, 2, 1] - D[:, 1, 2], D[:, 0, 2] - D[:, 2, 0], D[:, 1, 0] - D[:, 0, 1]], axis=1) / 2


def rolled_short(depth: np.ndarray, n_O: np.ndarray, turn: np.ndarray, n: np.ndarray) -> np.ndarray:
    """How much farther aside of where the plan has it a pressed tip's centre gets, as it rolls on a smaller radius.

    Of a tip that rolls without slipping by a turn w, in O, the centre goes w x r n; pressed in by depth it goes
    w x (r - depth) n, and sinks as its normal turns.

    Args:
        depth: (k,) of the pad, m.
        n_O: (k, 3) outward normals.
        turn: (k - 1, 3) of the tip, in between, rad.
        n: (k - 1, 3) normals in between.

    Returns:
        (k - 1, 3) in between, in O, m.
    """
    return (depth[1:] + depth[:-1])[:, None] / 2 * (np.diff(n_O, axis=0) - np.cross(turn, n))


def crept(
    f_O: np.ndarray, n_O: np.ndarray, friction: float, patch: np.ndarray, turn: np.ndarray, n: np.ndarray
) -> np.ndarray:
    """How far a tip creeps that turns about its contact's normal while it pushes the object along its surface.

    Rubbing all round, at r from its middle with w r, a patch bears a force T along the surface only as it slides along
    that at v: to first order, half of what every ring of it rubs with, times v / (w r). Pressure falls as
    1 - (r / patch)^2, so that T = (4 / 3) (v / (w patch)) friction N.

    Args:
        f_O: (k, 3) forces on the object, in O, N.
        n_O: (k, 3) outward normals.
        friction: while it rubs.
        patch: (k,) radii, m.
        turn: (k - 1, 3) of the tip, in between, rad.
        n: (k - 1, 3) normals in between.

    Returns:
        (k - 1, 3) in between, in O, m.
    """
    normal = np.sum(f_O * n_O, axis=1)[:, None]
    share = (f_O - normal * n_O) / (friction * np.maximum(-normal, 1e-9))
    share /= np.maximum(np.linalg.norm(share, axis=1), 1.0)[:, None]
    per_rad = 0.75 * patch[:, None] * share
    return np.abs(np.sum(turn * n, axis=1))[:, None] * (per_rad[1:] + per_rad[:-1]) / 2


@njit("void(f8[:, ::1], f8[:, ::1], f8[:, ::1])")
def _carry(step, n, out):
    """Adds up steps along a surface whose normal turns."""
    for k in range(1, len(n)):
        along = 0.0
        for i in range(3):
            out[k, i] = out[k - 1, i] + step[k - 1, i]
            along += out[k, i] * n[k, i]
        for i in range(3):
            out[k, i] -= along * n[k, i]
