"""The one table of tolerances, used by the automaton's predicates and by the certificate, and the scales they go by."""

from __future__ import annotations

import math

from drake_hand.model.gravity import STANDARD_GRAVITY as STANDARD_GRAVITY
from drake_hand.model.table import TABLE_TOUCH_M

TORQUE_LENGTH_M = 0.01
"""m; a force at this length weighs as much as a torque."""
UNBALANCED_SHARE = 0.02
"""Part of the object's weight that may stay unbalanced; torque: that force at `TORQUE_LENGTH_M`."""
TWIST_RAD = math.radians(3.0)
"""Spin that a pad takes up by twisting before it rubs: torsion over the stiffness 16 G a^3 / 3 of a round patch
(Johnson 1985, section 3.9), for a = 2 mm, G = 0.7 MPa and 2 N."""
PATCH_M = 1e-3
"""m; half the width of what a fingertip touches that is pressed by some tenths of a newton."""
LEVER_M = 0.1
"""m; a point this far from O turns an object's rotation into a length, and its speed into a rate."""
DROPPED_MM = 30.0
"""So far from the plan the object has left the hand."""

TOLERANCES = {
    "contact_mm": 0.1,
    "slip_mm": 0.5,
    "slip_mm_s": 1.0,
    "penetration_mm": 0.0,
    "limit_margin_rad": 0.0,
    "speed_ratio": 1.0,
    "acceleration_ratio": 1.0,
    "rest_speed_rad_s": 1e-3,
    "joint_jump_rad": 1e-4,
    "object_jump_mm": 1e-2,
    "drift_mm": 1e-2,
    "table_mm": 1e3 * TABLE_TOUCH_M,
    "force_margin": 0.0,
    "effort_ratio": 1.0,
    "balance_ratio": 1.0,
    "give_mm": 0.2,
    "pinch_deg": 5.0,
    "goal_position_mm": 0.1,
    "goal_rotation_deg": 0.1,
    "mode": 0.0,
    "init": 0.0,
    "inv": 0.0,
    "contact": 0.0,
    "jump": 0.0,
}
"""Limits by the name of what is measured: fields of the certificate, and ``slip_mm_s``, the velocity of a contact that
the predicates take for none. `contacts`, the number of fingers that hold, is limited by the task's min_contacts."""
AT_LEAST = {"limit_margin_rad", "force_margin", "contacts"}
"""Fields whose value must not be below the limit; all others must not be above."""
