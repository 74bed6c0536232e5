"""A plan made by hand for trials of the drives: every joint swings out and back, at rest at both ends."""

from __future__ import annotations

from collections.abc import Sequence

import msgspec
import numpy as np

from drake_hand.plans.plan import Certificate, Part, Plan
from drake_hand.plans.task import Pose, Release, Step, Task

KNOT_S = 0.05


def swing(
    joints: Sequence[str],
    duration: float = 1.5,
    *,
    amplitude_deg: float = 25.0,
    swings: int = 1,
    certified: bool = True,
) -> Plan:
    """A plan whose joints go out and back together, each a little less far than the one before.

    Args:
        joints: names.
        duration: s.
        amplitude_deg: of the first joint.
        swings: out and back, so many times.
        certified: whether it carries a certificate that says yes.
    """
    t = np.linspace(0.0, duration, max(3, round(duration / KNOT_S) + 1))
    w = 2 * np.pi * swings / duration
    amplitude = np.radians(amplitude_deg) * np.linspace(1.0, 0.5, len(joints))
    q = np.outer(1 - np.cos(w * t), amplitude) / 2
    v = np.outer(w * np.sin(w * t), amplitude) / 2
    still = [[1.0] + [0.0] * 6] * len(t)
    part = Part(
        mode="0",
        events=[],
        t=t.tolist(),
        q=q.tolist(),
        v=v.tolist(),
        X_WO=still,
        V_WO=[[0.0] * 7] * len(t),
        contacts={},
    )
    plan = Plan(
        task=Task(
            hand="kanguera", object="pencil", start=Pose(xyz_mm=(0.0, 0.0, 0.0)), motion=[Step(release=Release())]
        ),
        hand="kanguera",
        urdf_sha256="0" * 64,
        fingers=["all"],
        joints=list(joints),
        object_mass_kg=0.008,
        parts=[part],
        seed=0,
        versions={},
    )
    certificate = Certificate(certified=certified, samples=1, worst={}, failures=[], plan_hash=plan.hash).sealed()
    return msgspec.structs.replace(plan, certificate=certificate.sealed())
