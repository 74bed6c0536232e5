"""Every field of the certificate: a good plan passes; broken in one respect, `certify` names just that."""

import dataclasses
import json
import subprocess
import sys

import msgspec
import numpy as np
import pytest
from grasped_sphere import ANGLE_DEG, BY_MM, MODE, NAMES, START_MM, Maker, make_plan, make_push

from drake_hand.errors import InputError
from drake_hand.model.hand import Hand
from drake_hand.model.object import Object
from drake_hand.model.scene import Scene
from drake_hand.motion.plan import Plan
from drake_hand.motion.trajectory import Trajectory
from drake_hand.planning.task import Grasp, Pose, Release, Rotate, Slide, Step, Translate
from drake_hand.verify.certificate import certify
from drake_hand.verify.observe import observe, sample_times

replace = msgspec.structs.replace
HAND = Hand.load("kanguera")
LITTLE = list(HAND.joints).index("little_pip")


@pytest.fixture(scope="module")
def scene():
    return Scene(HAND, Object.load("sphere"))


@pytest.fixture(scope="module")
def kinematic():
    return make_plan(hold="kinematic")


@pytest.fixture(scope="module")
def held():
    return make_plan()


@pytest.fixture(scope="module")
def pivot():
    return make_plan(model="pivot", hold="kinematic")


def with_task(plan, **changes):
    return replace(plan, task=replace(plan.task, **changes))


def with_options(plan, **changes):
    return with_task(plan, options=replace(plan.task.options, **changes))


def with_physics(plan, **changes):
    return with_task(plan, physics=replace(plan.task.physics, **changes))


def with_step(plan, index, step):
    return with_task(plan, motion=[step if i == index else s for i, s in enumerate(plan.task.motion)])


def edited(plan, index, **rows):
    """The plan with arrays of one part changed by functions of the array."""
    part = plan.parts[index]
    changes = {name: change(np.array(getattr(part, name))).tolist() for name, change in rows.items()}
    return replace(plan, parts=[replace(p, **changes) if i == index else p for i, p in enumerate(plan.parts)])


def with_contacts(plan, index, change):
    part = plan.parts[index]
    contacts = {name: change(contact) for name, contact in part.contacts.items()}
    return replace(plan, parts=[replace(p, contacts=contacts) if i == index else p for i, p in enumerate(plan.parts)])


def broken(plan, scene, *fields):
    """The worst values, after seeing that just these fields are broken and that the certificate says so."""
    c = certify(plan, scene=scene)
    assert {name for name, w in c.worst.items() if not w.ok} == set(fields), c.failures
    assert c.certified == (not fields)
    assert {f.split()[0] for f in c.failures} == set(fields)
    return c.worst


@pytest.mark.parametrize("plan", ["held", "kinematic", "pivot"])
def test_a_good_plan_is_certified(plan, scene, request):
    plan = request.getfixturevalue(plan)
    c = certify(plan, scene=scene)
    assert c.certified, c.failures
    assert not c.failures
    assert c.worst["slip_mm"].value < 0.01
    assert c.worst["contact_mm"].value < 0.01
    forces = ("force_margin", "effort_ratio", "balance_ratio")
    if plan.task.options.hold == "kinematic":
        assert all(c.worst[name].value is None and c.worst[name].ok for name in forces)
    else:
        # the forces were made for friction 0.5, the task has 0.8
        assert c.worst["force_margin"].value == pytest.approx(1 - 0.5 / 0.8, abs=1e-3)
        assert 0.3 < c.worst["effort_ratio"].value < 1
        assert c.worst["balance_ratio"].value < 0.5
    assert replace(plan, certificate=c).certified
    assert not replace(plan, seed=plan.seed + 1, certificate=c).certified


def test_loads_the_models_itself_and_finds_the_same(held, scene):
    told = []
    c = certify(held, progress=told.append)
    assert c == certify(held, scene=scene)
    assert told == sorted(told)
    assert all(0 <= share <= 1 for share in told)


def test_a_time_optimal_plan_is_certified(scene):
    c = certify(make_plan(timing="optimal"), scene=scene)
    assert c.certified, c.failures
    assert c.worst["acceleration_ratio"].value > 0.9


def test_samples_are_close_in_time_and_rotation(kinematic):
    quick = replace(kinematic, parts=[*kinematic.parts])
    # the whole plan ten times as fast turns the object by more than 0.25 deg in 2 ms
    parts = [
        replace(
            p,
            t=(np.array(p.t) / 10).tolist(),
            v=(np.array(p.v) * 10).tolist(),
            V_WO=(np.array(p.V_WO) * 10).tolist(),
        )
        for p in quick.parts
    ]
    for plan in (kinematic, replace(quick, parts=parts)):
        trajectory = Trajectory(plan)
        for i, t in enumerate(sample_times(trajectory)):
            assert np.diff(t).max() <= 2e-3 + 1e-12
            assert set(plan.parts[i].t) <= set(t)
            R = trajectory.at(t, part=i).X_WO[:, :3, :3]
            turn = np.linalg.norm(R[1:] - R[:-1], axis=(1, 2)) / np.sqrt(2)
            assert np.degrees(turn.max()) <= 0.25


def test_contact_a_gap(kinematic, scene):
    """The index tip comes 0.2 mm off the sphere, halfway."""
    maker, part = Maker(), kinematic.parts[1]
    k = len(part.t) // 2
    q, finger = np.array(part.q[k]), maker.hand.finger("index")
    maker.scene.set(q)
    centre = maker.scene.tip_position(finger)
    n = (centre - part.X_WO[k][4:]) / np.linalg.norm(centre - part.X_WO[k][4:])
    dq = np.linalg.solve(maker.jacobian(q, finger, centre)[:, finger.columns], 2e-4 * n)

    # a smooth bump over the part, highest at its middle
    span = part.t[-1] - part.t[0]
    phase = 2 * np.pi * (np.array(part.t) - part.t[0])[:, None] / span
    bump = {"q": dq * (1 - np.cos(phase)) / 2, "v": dq * np.sin(phase) * np.pi / span}

    def add(name):
        def change(rows):
            rows[:, finger.columns] += bump[name]
            return rows

        return change

    plan = edited(kinematic, 1, q=add("q"), v=add("v"))
    worst = broken(plan, scene, "contact_mm")["contact_mm"]
    assert worst.value == pytest.approx(0.2, abs=0.02)
    assert worst.where == "index"
    assert worst.part == 1
    assert worst.time_s == pytest.approx(part.t[0] + span / 2, abs=0.2)


def test_contact_a_point_that_is_elsewhere(kinematic, scene):
    plan = with_contacts(kinematic, 1, lambda c: replace(c, p_OP=(np.array(c.p_OP) * 1.01).tolist()))
    worst = broken(plan, scene, "contact_mm")
    assert "stated point" in worst["contact_mm"].where


def test_slip_of_pivoting_contacts_taken_for_rolling(pivot, scene):
    broken(with_options(pivot, model="rolling"), scene, "slip_mm")


def test_slip_of_rolling_contacts_taken_for_pivots(kinematic, scene):
    broken(with_options(kinematic, model="pivot"), scene, "slip_mm")


def test_penetration_of_two_fingers(kinematic, scene):
    ring = list(HAND.joints).index("ring_abduction")

    def across(rows):
        rows[:, ring] = HAND.q_upper[ring]
        return rows

    plan = kinematic
    for i in range(len(plan.parts)):
        plan = edited(plan, i, q=across)
    pairs = {frozenset(p[:2]) for p in _overlaps(plan, scene)}
    worst = broken(plan, scene, "penetration_mm")
    assert frozenset(worst["penetration_mm"].where.split(" and ")) in pairs


def _overlaps(plan, scene):
    scene.set(np.array(plan.parts[1].q[0]), Trajectory(plan).at(plan.parts[1].t[0]).X_WO[0])
    return scene.penetrations(exclude=NAMES)


def test_penetration_of_a_free_tip_that_never_leaves(kinematic, scene):
    """The last part says that all fingers are free, but they stay where they are."""

    def stay(rows):
        rows[:] = rows[0]
        return rows

    broken(edited(kinematic, 2, q=stay, v=lambda v: 0 * v), scene, "penetration_mm")


def test_limits(kinematic, scene):
    def below(rows):
        rows[:, LITTLE] = HAND.q_lower[LITTLE] - 1e-3
        return rows

    plan = kinematic
    for i in range(len(plan.parts)):
        plan = edited(plan, i, q=below)
    worst = broken(plan, scene, "limit_margin_rad")
    assert worst["limit_margin_rad"].where == "little_pip"


def test_limits_of_the_command(held, scene):
    def pull(rows):
        rows[1:-1, LITTLE] = HAND.q_lower[LITTLE] - 0.1
        return rows

    plan = edited(held, 1, q_offset=pull)
    worst = broken(plan, scene, "limit_margin_rad")
    assert worst["limit_margin_rad"].where == "little_pip, commanded"


@pytest.mark.parametrize(("field", "limit"), [("speed_ratio", "speed"), ("acceleration_ratio", "acceleration")])
def test_speed_and_acceleration(kinematic, field, limit):
    slower = dataclasses.replace(HAND, **{limit: 0.05 * getattr(HAND, limit)})
    weak = Scene(slower, Object.load("sphere"))
    worst = broken(kinematic, weak, field)[field]
    states = Trajectory(kinematic).at(np.linspace(0, kinematic.duration, 5001))
    rates = np.abs(states.v if limit == "speed" else states.a) / getattr(slower, limit)
    assert worst.value == pytest.approx(rates.max(), rel=1e-2)
    assert worst.where == HAND.joints[int(rates.max(axis=0).argmax())]


def test_speed_of_the_command(held, scene):
    def tug(rows):
        rows[len(rows) // 2, LITTLE] = 0.3
        return rows

    worst = broken(edited(held, 1, q_offset=tug), scene, "speed_ratio")["speed_ratio"]
    assert worst.where == "little_pip, commanded"


def test_rest_at_mode_changes(kinematic, scene):
    def rush(rows):
        rows[-1, LITTLE] = 0.05
        return rows

    broken(edited(kinematic, 1, v=rush), scene, "rest_speed_rad_s")


def test_rest_of_the_object(kinematic, scene):
    def rush(rows):
        rows[0, 6] = 3e-4
        return rows

    # it moves in the fixture's hands, too little to matter
    broken(edited(kinematic, 0, V_WO=rush), scene, "rest_speed_rad_s")


def test_jump_of_a_joint(kinematic, scene):
    def aside(rows):
        rows[:, LITTLE] += 0.01
        return rows

    plan = edited(kinematic, 1, q=aside)
    worst = broken(plan, scene, "joint_jump_rad")
    assert worst["joint_jump_rad"].value == pytest.approx(0.01)


def test_jump_of_a_command(held, scene):
    def press(rows):
        rows[0, LITTLE] = 0.01
        return rows

    broken(edited(held, 1, q_offset=press), scene, "joint_jump_rad")


def test_start_away_from_the_joints_the_task_gives(kinematic, scene):
    start = Pose(xyz_mm=START_MM, joints_deg={"little_pip": 5.0})
    c = certify(with_task(kinematic, start=start), scene=scene)
    assert not c.worst["joint_jump_rad"].ok


def test_jump_of_the_object(kinematic, scene):
    def aside(rows):
        rows[:, 4] += 5e-5
        return rows

    broken(edited(kinematic, 2, X_WO=aside), scene, "object_jump_mm")


def test_drift_in_the_fixture(kinematic, scene):
    def wander(rows):
        rows[2:-2, 4] += 5e-5
        return rows

    broken(edited(kinematic, 0, X_WO=wander), scene, "drift_mm")


def test_too_few_contacts(kinematic, scene):
    plan = with_options(kinematic, min_contacts=4)
    worst = broken(plan, scene, "contacts")
    assert worst["contacts"].value == 3


def test_friction(held, scene):
    plan = with_physics(held, friction=0.45)
    worst = broken(plan, scene, "force_margin")["force_margin"]
    assert worst.value == pytest.approx(1 - 0.5 / 0.45, abs=1e-3)
    assert worst.where in NAMES


def test_efforts(held):
    weak = Scene(dataclasses.replace(HAND, effort=HAND.effort / 2), Object.load("sphere"))
    broken(held, weak, "effort_ratio")


def test_torques_are_those_of_the_forces_at_the_contact_points(held, scene):
    """The hand-made offsets are K^-1 J^T f, with Jacobians of their own."""
    seen = observe(Trajectory(held), scene)
    s = seen.states
    assert np.allclose(seen.torque, s.q_offset * HAND.stiffness, atol=2e-4)
    assert np.abs(seen.torque).max() > 0.03


def test_forces_that_do_not_balance(held, scene):
    more = with_contacts(held, 1, lambda c: replace(c, f_W=(1.06 * np.array(c.f_W)).tolist()))
    worst = broken(more, scene, "balance_ratio")
    # 6 % of the weight, where 2 % are tolerated
    assert worst["balance_ratio"].value == pytest.approx(3, abs=0.4)


def test_gravity_the_forces_were_not_made_for(held, scene):
    broken(with_physics(held, gravity=(0.0, -9.81, 0.0)), scene, "balance_ratio")


def test_forces_that_balance_without_friction_to_carry_them(held, scene):
    """Torques count: forces swapped between fingers still sum up to the weight."""
    contacts = dict(held.parts[1].contacts)
    contacts["index"], contacts["middle"] = (
        replace(contacts["index"], f_W=contacts["middle"].f_W),
        replace(contacts["middle"], f_W=contacts["index"].f_W),
    )
    plan = replace(held, parts=[held.parts[0], replace(held.parts[1], contacts=contacts), held.parts[2]])
    worst = certify(plan, scene=scene).worst
    assert not worst["balance_ratio"].ok
    assert not worst["force_margin"].ok


def test_goal_position(kinematic, scene):
    short = with_step(kinematic, 1, Step(translate=Translate(by_mm=(BY_MM[0], BY_MM[1], BY_MM[2] - 0.2))))
    worst = broken(short, scene, "goal_position_mm")
    assert worst["goal_position_mm"].value == pytest.approx(0.2, abs=1e-3)


@pytest.mark.parametrize(("angle", "error"), [(ANGLE_DEG + 0.3, 0.3), (ANGLE_DEG - 360, 360), (ANGLE_DEG + 720, 720)])
def test_goal_rotation_counts_winding(kinematic, scene, angle, error):
    plan = with_step(kinematic, 2, Step(rotate=Rotate(axis=(0, 0, 1), angle_deg=angle)))
    worst = broken(plan, scene, "goal_rotation_deg")
    assert worst["goal_rotation_deg"].value == pytest.approx(error, abs=1e-2)


def test_start_pose(kinematic, scene):
    start = Pose(xyz_mm=START_MM, rpy_deg=(0, 0, 0.2))
    worst = certify(with_task(kinematic, start=start), scene=scene).worst
    assert worst["goal_rotation_deg"].where == "start"
    assert worst["goal_rotation_deg"].value == pytest.approx(0.2)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda p: with_options(p, modes=["00000"]), "not among options.modes"),
        (lambda p: edited_events(p, 1, ["make index"]), "where the modes say"),
        (lambda p: with_step(p, 0, Step(grasp=Grasp(fingers=["index", "thumb"]))), "middle not among"),
        (lambda p: with_step(p, 0, Step(grasp=Grasp(fingers=["ring", *NAMES]))), "never grasps with"),
        (lambda p: with_task(p, motion=p.task.motion[:3]), "lets go"),
        (lambda p: without_first(p), "nothing is grasped yet"),
        (lambda p: replace(p, parts=p.parts[:2]), "after a release"),
    ],
)
def test_modes(kinematic, scene, change, says):
    worst = certify(change(kinematic), scene=scene).worst
    assert not worst["mode"].ok
    assert says in worst["mode"].where


def without_first(plan):
    begin = plan.parts[0].t[-1]
    parts = [replace(p, t=(np.array(p.t) - begin).tolist()) for p in plan.parts[1:]]
    return replace(plan, parts=[replace(parts[0], events=[]), *parts[1:]])


def edited_events(plan, index, events):
    return replace(plan, parts=[replace(p, events=events) if i == index else p for i, p in enumerate(plan.parts)])


def test_a_plan_that_ends_without_what_it_grasped(kinematic, scene):
    plan = with_task(kinematic, motion=kinematic.task.motion[:3])
    broken(plan, scene, "mode", "contacts")


def test_forces_that_are_missing(held, scene):
    bare = with_contacts(held, 1, lambda c: replace(c, f_W=None))
    broken(bare, scene, "mode", "balance_ratio")
    soft = replace(held, parts=[replace(p, q_offset=None) for p in held.parts])
    broken(soft, scene, "mode")


@pytest.mark.parametrize(
    ("change", "key"),
    [
        (lambda p: replace(p, urdf_sha256="0" * 64), "urdf_sha256"),
        (lambda p: replace(p, object_sha256="0" * 64), "object_sha256"),
        (lambda p: replace(p, hand="allegro"), "hand"),
        (lambda p: replace(p, joints=[*p.joints[1:], p.joints[0]]), "joints"),
        (lambda p: replace(p, object_mass_kg=0.001), "object_mass_kg"),
        (lambda p: edited(p, 1, v=lambda v: v * np.nan), "parts[1].v"),
        (lambda p: edited(p, 1, X_WO=lambda X: X * 2), "parts[1].X_WO"),
        (lambda p: replace(p, parts=p.parts[1:]), "parts[0].t[0]"),
        (lambda p: edited(p, 0, X_WO=lambda X: X * ([[1]] * (len(X) - 1) + [[-1]])), "parts[0].X_WO"),
        (lambda p: edited(p, 1, X_WO=lambda X: X * [[-1] * 4 + [1] * 3]), "parts[1].X_WO"),
    ],
)
def test_a_plan_for_other_models_or_malformed_is_an_input_error(kinematic, scene, change, key):
    with pytest.raises(InputError) as e:
        certify(change(kinematic), scene=scene)
    assert e.value.key == key


def test_a_finger_may_push_what_lies_on_a_support(scene):
    push = make_push()
    broken(push, scene)
    # without a push in the task, two fingers have to hold what moves
    moved = Step(translate=Translate(by_mm=push.task.motion[0].push.by_mm))
    broken(with_task(push, motion=[Step(grasp=Grasp()), moved]), scene, "contacts", "mode")
    # and it is the finger the task names that pushes
    other = Step(push=replace(push.task.motion[0].push, finger="index"))
    broken(with_task(push, motion=[other]), scene, "drift_mm")


def test_a_slide_is_as_long_as_the_task_asks(kinematic, scene):
    """The index contact's way over the sphere, called a slide."""
    part = kinematic.parts[1]
    p_OP = np.array(part.contacts["index"].p_OP)
    length = float(np.linalg.norm(np.diff(p_OP, axis=0), axis=1).sum() * 1000)
    sliding = replace(kinematic, parts=[kinematic.parts[0], replace(part, mode="00121"), kinematic.parts[2]])

    def told(x):
        motion = kinematic.task.motion
        return with_task(sliding, motion=[*motion[:3], Step(slide=Slide(finger="index", by_mm=(x, 0.0))), motion[3]])

    assert length > 1
    broken(told(length), scene)
    worst = broken(told(length + 0.5), scene, "goal_position_mm")["goal_position_mm"]
    assert worst.value == pytest.approx(0.5, abs=0.05)
    assert worst.where == "step 4, slide"
    asked = with_task(
        kinematic, motion=[*kinematic.task.motion[:3], told(length).task.motion[3], Step(release=Release())]
    )
    assert "never slides" in broken(asked, scene, "mode")["mode"].where


def test_a_plan_file_carries_its_certificate(kinematic, scene, tmp_path):
    c = certify(kinematic, scene=scene)
    file = tmp_path / "plan.json"
    replace(kinematic, certificate=c).save(file)
    assert Plan.load(file).certified
    raw = json.loads(file.read_text())
    raw["parts"][1]["q"][3][0] += 1e-3
    file.write_text(json.dumps(raw))
    tampered = Plan.load(file)
    assert not tampered.certified
    assert certify(tampered, scene=scene) != c


def test_shares_nothing_with_the_planner():
    code = "import sys, drake_hand.verify.certificate; print(*(m for m in sys.modules if m.startswith('drake_hand.')))"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    rows = ("drake_hand.contact", "drake_hand.modes", "drake_hand.planning.", "drake_hand.motion.")
    shared = {m for m in out if m.startswith(rows)}
    assert shared == {"drake_hand.planning.task", "drake_hand.motion.plan", "drake_hand.motion.trajectory"}


def test_release_is_part_of_the_hand_made_plan():
    """What the tests above rely on: the fixture has the object at both ends."""
    plan = make_plan(hold="kinematic")
    assert plan.modes == ["00000", MODE, "00000"]
    assert plan.task.motion[-1] == Step(release=Release())
