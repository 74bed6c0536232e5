"""A plan for other players: tables of commands (CSV, npz) and a ROS 2 JointTrajectory. Needs no Drake."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import yaml

from drake_hand.errors import InputError
from drake_hand.plans.plan import Plan
from drake_hand.plans.trajectory import Trajectory, quaternions

RATE_HZ = 100.0
_TEXT_DIGITS = 9
"""Of numbers in text: nanoradians."""


@dataclass(frozen=True, kw_only=True)
class Samples:
    """A plan at equally spaced times and at its end."""

    joints: tuple[str, ...]
    t: np.ndarray
    """(k,) s."""
    modes: tuple[str, ...]
    """(k,) codes; at a switch, the mode that begins."""
    q: np.ndarray
    """(k, nq) where the joints are to be, rad."""
    command: np.ndarray
    """(k, nq) commands of their servos, q and the offset that makes them press, rad."""
    rate: np.ndarray
    """(k, nq) of the command, rad/s; zero at both ends."""
    X_WO: np.ndarray
    """(k, 4, 4) object."""


def sample(plan: Plan, rate_hz: float = RATE_HZ) -> Samples:
    """Samples a plan.

    Raises:
        InputError: it is not certified: what plays the samples knows nothing of certificates.
    """
    if not plan.certified:
        raise InputError(
            "plan is not certified, or was changed since", key="certificate", expected="a plan that `check` proves"
        )
    trajectory = Trajectory(plan)
    t0, t1 = trajectory.knots[0], trajectory.knots[-1]
    t = np.append(t0 + np.arange(int(np.ceil((t1 - t0) * rate_hz - 1e-6))) / rate_hz, t1)
    states = trajectory.at(t)
    # Offsets are linear between knots: their rate is taken over one period, so that corners are rounded.
    ahead, behind = (trajectory.at(np.clip(t + d / rate_hz, t0, t1)).q_offset for d in (0.5, -0.5))
    rate = states.v + (ahead - behind) * rate_hz
    rate[[0, -1]] = 0.0
    return Samples(
        joints=tuple(plan.joints),
        t=t,
        modes=tuple(plan.parts[i].mode for i in states.part),
        q=states.q,
        command=states.q_command,
        rate=rate,
        X_WO=states.X_WO,
    )


def to_csv(s: Samples) -> bytes:
    """One row a sample: time, mode, command, rate and position of each joint, object pose (m, quaternion w x y z)."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    columns = [f"{kind}.{joint}" for kind in ("command_rad", "rate_rad_s", "q_rad") for joint in s.joints]
    pose = ["object_x_m", "object_y_m", "object_z_m", "object_qw", "object_qx", "object_qy", "object_qz"]
    writer.writerow(["t_s", "mode", *columns, *pose])
    numbers = np.hstack([s.command, s.rate, s.q, s.X_WO[:, :3, 3], quaternions(s.X_WO[:, :3, :3])])
    for t, mode, row in zip(s.t, s.modes, numbers, strict=True):
        writer.writerow([f"{t:.{_TEXT_DIGITS}f}", mode, *(f"{v:.{_TEXT_DIGITS}f}" for v in row)])
    return out.getvalue().encode()


def to_npz(s: Samples) -> bytes:
    """Arrays by the names of `Samples`."""
    out = io.BytesIO()
    np.savez_compressed(
        out,
        joints=np.array(s.joints),
        modes=np.array(s.modes),
        t=s.t,
        q=s.q,
        command=s.command,
        rate=s.rate,
        X_WO=s.X_WO,
    )
    return out.getvalue()


def to_ros2(s: Samples) -> bytes:
    """A ``trajectory_msgs/JointTrajectory`` in YAML, as ``ros2 topic pub`` and controllers take it."""

    def numbers(row: np.ndarray) -> list[float]:
        return [round(float(v), _TEXT_DIGITS) + 0.0 for v in row]

    points = []
    for t, command, rate in zip(s.t, s.command, s.rate, strict=True):
        sec, nanosec = divmod(round(t * 1e9), 10**9)
        stamp = {"sec": int(sec), "nanosec": int(nanosec)}
        points.append({"positions": numbers(command), "velocities": numbers(rate), "time_from_start": stamp})
    header = {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""}
    message = {"header": header, "joint_names": list(s.joints), "points": points}
    dumper = getattr(yaml, "CSafeDumper", yaml.SafeDumper)
    return yaml.dump(message, Dumper=dumper, sort_keys=False, default_flow_style=None, width=10**6).encode()


WRITERS: dict[str, Callable[[Samples], bytes]] = {"csv": to_csv, "npz": to_npz, "ros2": to_ros2}
"""Writers by name."""
