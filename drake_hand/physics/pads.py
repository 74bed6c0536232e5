"""How stiff pads are at the forces a plan states, for an engine whose pads are springs."""

from __future__ import annotations

import numpy as np

from drake_hand.contact.compliance import pad_compression
from drake_hand.contact.surface import Surface
from drake_hand.model.hand import Hand
from drake_hand.model.object import Object
from drake_hand.physics.engine import stiffer
from drake_hand.plans.plan import Plan

_PRESSED_N = 0.05
"""N; below it a contact is being made or broken."""


def pad_stiffness(plan: Plan, hand: Hand, object_: Object, stiffness: float = 1.0) -> np.ndarray:
    """Force per depth of each finger's pad, the median over its planned contacts.

    A hydroelastic pad grows stiffer the harder it is pressed. A spring of this stiffness yields as much as the pad does
    at the forces that are planned.

    Args:
        plan: with forces; the pad's point stiffness counts where there are none.
        hand: with pads.
        object_: how it curves decides how deep a tip goes.
        stiffness: factor on the pads' material.

    Returns:
        (fingers,) N/m.
    """
    pad, surface = stiffer(hand.pad, stiffness), Surface.of(object_)
    out = np.full(len(hand.fingers), pad.point_stiffness_n_m)
    for i, finger in enumerate(hand.fingers):
        contacts = [part.contacts[finger.name] for part in plan.parts if finger.name in part.contacts]
        points = [p for c in contacts for p in c.p_OP if c.f_W is not None]
        forces = [f for c in contacts for f in c.f_W or ()]
        if not forces:
            continue
        size = np.linalg.norm(forces, axis=1)
        pressed = size > _PRESSED_N
        if not pressed.any():
            continue
        p_OP, force = np.array(points)[pressed], size[pressed]
        p_OC = p_OP + finger.radius * surface.closest(p_OP)[1]
        out[i] = np.median(force / pad_compression(pad, force, surface.bend(p_OC, finger.radius)))
    return out
