"""Steps that need no search over the automaton: starting inside a grasp, sliding, pushing, letting go.

The task names the finger and where it goes, so there is nothing to choose. Each step is either carried out, with the
checks that a search would make, or refused with what prevents it.
"""

from __future__ import annotations

import numpy as np

from drake_hand.contact.submodel import Model
from drake_hand.errors import InputError, nearest
from drake_hand.planning import approach
from drake_hand.planning.collision import Clearance
from drake_hand.planning.failure import code, no_plan
from drake_hand.planning.kernels.world import BALANCE, EDGE, FINGERS, SINGULAR
from drake_hand.planning.legs import LegBuilder
from drake_hand.planning.moves import Moves
from drake_hand.planning.object_path import ObjectPath, still
from drake_hand.planning.on_table import check_release
from drake_hand.planning.park import park
from drake_hand.planning.reach import ContactSpan, ReachTable
from drake_hand.planning.slide import SLIDE_STEP_M, slid
from drake_hand.plans.tolerances import TOLERANCES

TOUCHING_M = 1e-3 * TOLERANCES["contact_mm"]
"""A fingertip this near the object's surface touches it, m (``start`` with ``joints_deg``)."""
_SLIDE_ENDS = {
    EDGE: ("there is an edge", "edge"),
    BALANCE: ("the others do not hold the object", "hold"),
    FINGERS: ("it would hit something", "collision"),
    SINGULAR: ("its tip would turn over the surface rather than slide, or jump", "singular"),
}
"""What ends a slide, in words and as a constraint; anything else is reach."""
OPPOSED_COS = np.cos(np.radians(30.0))
"""A contact pushes if its normal is within 30 deg of opposing the push."""


def current_spans(builder: LegBuilder, table: ReachTable) -> list[ContactSpan]:
    """The contacts there are, carried along the table's path.

    Raises:
        NoPlanFound: a finger cannot keep its contact at all.
    """
    holds = []
    for i in sorted(builder.touching):
        finger = builder.hand.fingers[i]
        hold = table.from_contact(i, 0, builder.q[finger.columns])
        if hold is None:
            what = f"finger {finger.name} cannot keep its contact"
            raise no_plan(what, mode=builder.mode, finger=finger.name, constraint="contact", X_WO=builder.X_WO)
        holds.append(hold)
    return holds


def start_inside(builder: LegBuilder, clearance: Clearance, joints_deg: dict[str, float], model: Model) -> None:
    """Puts the hand where ``start.joints_deg`` says; contacts are where the fingertips touch.

    Raises:
        InputError: unknown joints, angles beyond the limits, or no fingertip that touches the object.
    """
    hand, q = builder.hand, builder.q.copy()
    for name, angle in joints_deg.items():
        key = f"start.joints_deg.{name}"
        if name not in hand.joints:
            expected = nearest(name, hand.joints)
            raise InputError(f"hand '{hand.name}' has no joint '{name}'", key=key, found=name, expected=expected)
        column = hand.joints.index(name)
        q[column] = np.radians(angle)
        low, high = np.degrees((hand.q_lower[column], hand.q_upper[column]))
        if not low <= angle <= high:
            raise InputError("joint is beyond its limits", key=key, found=angle, expected=f"{low:g} .. {high:g}")
    gaps = {}
    for i, finger in enumerate(hand.fingers):
        p_WC = clearance.kinematics[i].fk(q[None, finger.columns])[0]
        foot, _, distance = clearance.surface.closest((p_WC - builder.X_WO[:3, 3]) @ builder.X_WO[:3, :3])
        gaps[finger.name] = float(distance[0]) - finger.radius
        if abs(gaps[finger.name]) < TOUCHING_M:
            builder.touching[i] = foot[0]
    if not builder.touching:
        found = ", ".join(f"{name} {gap * 1e3:.2f} mm away" for name, gap in gaps.items())
        expected = f"a fingertip within {TOUCHING_M * 1e3:g} mm of the surface"
        raise InputError("no fingertip touches the object", key="start.joints_deg", found=found, expected=expected)
    builder.q = q
    # Tips that touch to within rounding are put exactly onto the surface.
    for hold in current_spans(builder, ReachTable(clearance, still(builder.X_WO), model)):
        builder.q[hand.fingers[hold.finger].columns] = hold.q[0]
    builder.dwell()  # in which the grasp's forces rise


def slide(builder: LegBuilder, moves: Moves, finger: int, s: np.ndarray) -> None:
    """One finger slides over the surface by chart coordinates s (2,) in m; the object rests, held by the others.

    Raises:
        NoPlanFound: it does not touch, the others do not hold, or an edge, its reach or a collision is in the way.
    """
    hand, surface = builder.hand, moves.clearance.surface
    mode = code(hand, builder.touching, {finger})

    def fail(what: str, constraint: str) -> None:
        name = hand.fingers[finger].name
        raise no_plan(f"finger {name} {what}", mode=mode, finger=name, constraint=constraint, X_WO=builder.X_WO)

    if finger not in builder.touching:
        fail("is to slide, but does not touch the object", "contact")
    u = np.linspace(0, 1, max(3, int(np.ceil(np.linalg.norm(s) / SLIDE_STEP_M)) + 1))[:, None]
    p_OP, n_O = surface.move(np.repeat(builder.touching[finger][None], len(u), axis=0), u * s)
    q, length, why = slid(moves, builder.state, finger, p_OP[None], n_O[None])
    if length[0] < len(u) - 1:
        words, constraint = _SLIDE_ENDS.get(int(why[0]), ("that is as far as it reaches", "joint limit"))
        fail(f"slides no farther than {1e3 * np.linalg.norm(u[length[0]] * s):.1f} mm: {words}", constraint)
    builder.slide(finger, q[0, :, : len(hand.fingers[finger].columns)], p_OP)


def push(builder: LegBuilder, clearance: Clearance, path: ObjectPath, model: Model, finger: int) -> None:
    """One finger pushes the object, which lies on a support, along a straight path, and lifts off.

    The contact's normal opposes the push, and the line of push passes the mass centre as near as can be.

    Raises:
        NoPlanFound: the finger reaches no such contact, or none of them without a collision.
    """
    hand, X, name = builder.hand, builder.X_WO, builder.hand.fingers[finger].name
    mode = code(hand, {finger})

    def fail(what: str, constraint: str) -> None:
        raise no_plan(f"finger {name} {what}", mode=mode, finger=name, constraint=constraint, X_WO=X)

    others = [i for i in range(len(hand.fingers)) if i != finger]
    settle(builder, clearance, park(clearance, path, others, builder.q))
    waiting = {i: builder.q[hand.fingers[i].columns] for i in others}
    table = ReachTable(clearance, path, model, waiting)
    lasting = [h for h in table.spans(finger, 0) if h.end == path.ticks]
    if not lasting:
        word = table.most_common_limit(finger, 0)
        fail(f"reaches no contact that it could keep along the push ({word})", word)
    along = path.X_WO[-1, :3, 3] - X[:3, 3]
    along /= np.linalg.norm(along)
    opposed = [h for h in lasting if -h.n_W[0] @ along >= OPPOSED_COS]
    if not opposed:
        fail("reaches no contact whose normal opposes the push", "direction of push")
    p_WCom = table.p_WCom(np.zeros(1, dtype=int))[0]
    for h in sorted(opposed, key=lambda h: float(np.linalg.norm(np.cross(h.p_WP[0] - p_WCom, along)))):
        contact = approach.PlannedContact(q=h.q[0], n_W=h.n_W[0], p_OP=X[:3, :3].T @ (h.p_WP[0] - X[:3, 3]))
        if approach.close(builder, clearance, {finger: contact}):
            builder.carry(clearance, {h.finger: h.q}, path.X_WO)
            release(builder, clearance)
            return
    fail("cannot get to a contact that opposes the push without a collision", "approach")


def release(builder: LegBuilder, clearance: Clearance) -> None:
    """All fingers that touch lift off at once and go where they wait.

    Raises:
        NoPlanFound: they cannot without a collision, or the object would fall onto the table.
    """
    X, normals = builder.X_WO, {}
    check_release(clearance, X, builder.mode)
    for i in builder.touching:
        p_WC = clearance.kinematics[i].fk(builder.q[None, builder.hand.fingers[i].columns])[0]
        n_O = clearance.surface.closest((p_WC - X[:3, 3]) @ X[:3, :3])[1]
        normals[i] = X[:3, :3] @ n_O[0]
    builder.dwell()
    if not approach.open_(builder, clearance, normals, park(clearance, still(X), [])):
        what = "the fingers cannot let go without a collision"
        raise no_plan(what, mode=builder.mode, constraint="collision", X_WO=X)


def settle(builder: LegBuilder, clearance: Clearance, q: np.ndarray) -> None:
    """Brings the fingers that do not touch to q (nq,); a plan that has not begun yet begins there.

    Raises:
        NoPlanFound: there is no path.
    """
    if not builder.legs and not builder.touching:
        builder.q = q.copy()
        return
    free = {i: q[f.columns] for i, f in enumerate(builder.hand.fingers) if i not in builder.touching}
    ways = approach.joint_paths(clearance, builder.q, free, builder.X_WO)
    if ways is None:
        what = "the fingers that take no part find no path to where they would wait"
        raise no_plan(what, mode=builder.mode, constraint="collision", X_WO=builder.X_WO)
    for way in ways:
        builder.move(way)
