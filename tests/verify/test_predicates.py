"""The automaton's predicates along a plan: as clause by clause in a scene, and each clause named when broken."""

import numpy as np
import pytest
from breaking import HAND, LITTLE, edited, replace
from grasped_sphere import MODE

from drake_hand.modes.automaton import Automaton
from drake_hand.modes.measured import State
from drake_hand.modes.situation import Situation
from drake_hand.modes.switch import switch
from drake_hand.plans.trajectory import Trajectory
from drake_hand.verify import observe as observing
from drake_hand.verify.along import Along, at_instants, differences
from drake_hand.verify.certificate import certify
from drake_hand.verify.findings import Findings
from drake_hand.verify.observe import NEAR_M, observe
from drake_hand.verify.predicates import KINDS, check_predicates, judge_predicates

INDEX = HAND.finger("index").columns


@pytest.fixture
def coarse(monkeypatch):
    """Fewer samples, where it is not about how many."""
    monkeypatch.setattr(observing, "SPACING_S", 2e-2)
    monkeypatch.setattr(observing, "SPACING_DEG", 2.0)


@pytest.fixture(scope="module")
def shaken(kinematic):
    """The plan with joints and rates a little wrong everywhere, and jumps at the switches."""
    rng = np.random.default_rng(4)

    def noise(size):
        return lambda x: x + rng.normal(size=x.shape) * size

    for i in range(len(kinematic.parts)):
        kinematic = edited(kinematic, i, q=noise(2e-3), v=noise(0.05))
    return kinematic


def automaton(scene, model="rolling"):
    return Automaton.of(scene.hand, scene.object.name, model=model)


def situation(seen, scene, row, after=None):
    def state(row):
        s = seen.states
        return State(q=s.q[row], X_WO=s.X_WO[row], v=s.v[row], V_WO=s.V_WO[row])

    return Situation(scene=scene, state=state(row), after=None if after is None else state(after))


def same(predicate, along, situations):
    """Worst value of every clause, found at once and one situation after the other."""
    one_by_one = [predicate(s).findings for s in situations]
    for i, finding in enumerate(predicate(along).findings):
        values = np.array([findings[i].value for findings in one_by_one])
        if finding.clause.unit == "mm" and "WO" not in finding.clause.name:
            values = np.minimum(values, NEAR_M)  # the certificate looks no further
        worst = values.max() if finding.clause.relation == "<=" else values.min()
        assert finding.value == pytest.approx(worst, abs=2e-8), finding.clause.name
        assert values[finding.row] == pytest.approx(worst, abs=2e-8)


@pytest.mark.parametrize("model", ["rolling", "pivot"])
def test_the_same_as_clause_by_clause(coarse, shaken, scene, model):
    seen, rng = observe(Trajectory(shaken), scene), np.random.default_rng(5)
    a = automaton(scene, model)
    rows = rng.choice(len(seen.states.t), 25, replace=False)
    along = Along(seen=seen, scene=scene, rows=rows, velocities=at_instants(seen, scene, rows))
    situations = [situation(seen, scene, row) for row in rows]
    for code in ("00111", "02121", "00000"):
        for predicate in (a.init(a.mode(code)), a.inv(a.mode(code))):
            same(predicate, along, situations)
    near = rows[~np.isnan(seen.gap[rows][:, 2:]).any(axis=1)]
    along = Along(seen=seen, scene=scene, rows=near, velocities=at_instants(seen, scene, near))
    situations = [situation(seen, scene, row) for row in near]
    assert len(near) > 5
    for code in ("00111", "00121", "00012"):
        same(a.contact(a.mode(code)), along, situations)


def test_the_same_at_switches(coarse, shaken, scene):
    seen, a = observe(Trajectory(shaken), scene), automaton(scene)
    firsts = np.flatnonzero(np.diff(seen.states.part)) + 1
    assert len(firsts) == 2
    for first in firsts:
        rows = np.array([first - 1])
        at = Along(seen=seen, scene=scene, rows=rows, after_rows=rows + 1, velocities=at_instants(seen, scene, rows))
        for before, after in (("00000", MODE), (MODE, "00000"), (MODE, "00121"), ("00121", "00111")):
            edge = switch(a.mode(before), a.mode(after), a.fingers)
            same(a.jump(edge), at, [situation(seen, scene, first - 1, first)])


def test_differences_are_the_velocities(kinematic, scene, monkeypatch):
    plan = replace(kinematic, parts=kinematic.parts[:2])
    seen = observe(Trajectory(plan), scene)
    rows = np.flatnonzero(seen.states.part == 1)[1:-1:97]
    exact, found = at_instants(seen, scene, rows), differences(seen, scene)[rows]
    held = [2, 3, 4]
    assert np.abs(exact.centre[:, held]).max() > 1e-3  # rolling, the tip centre moves
    np.testing.assert_allclose(found.centre[:, held], exact.centre[:, held], atol=5e-5)
    np.testing.assert_allclose(found.contact[:, held], exact.contact[:, held], atol=5e-5)


def at_knot(row, columns, by):
    """Adds to some columns of one knot."""

    def change(x):
        x[row, columns] += by
        return x

    return change


def normal_rates(plan, scene, finger, row, speed):
    """Joint rates that move a fingertip away from the object at a knot of the second part."""
    q, X = np.array(plan.parts[1].q[row]), np.array(plan.parts[1].X_WO[row])
    f = HAND.finger(finger)
    scene.set(q)
    away = scene.tip_position(f) - X[4:]
    step = 1e-6
    J = []
    for c in f.columns:
        scene.set(q + step * np.eye(HAND.nq)[c])
        J.append((scene.tip_position(f) - X[4:] - away) / step)
    return np.linalg.pinv(np.array(J).T) @ (speed * away / np.linalg.norm(away))


def sliding(plan):
    return replace(plan, parts=[plan.parts[0], replace(plan.parts[1], mode="00121"), plan.parts[2]])


BREAKS = {
    "limits": (
        lambda p, s: edited(p, 1, q=at_knot(slice(None), LITTLE, 10.0)),
        ("inv", "inv(00111): joint limits", "(little_pip)"),
    ),
    "contact": (
        lambda p, s: edited(p, 1, q=at_knot(5, INDEX, normal_rates(p, s, "index", 5, 5e-4))),
        ("inv", "inv(00111): contact[index tip on sphere]: |gap| = ", "mm <= 0.1 mm"),
    ),
    "clear": (
        lambda p, s: replace(p, parts=[p.parts[0], into_the_sphere(p, s), p.parts[2]]),
        ("inv", "inv(00011): clear[middle tip on sphere]: gap = -", "mm >= -0.1 mm"),
    ),
    "no slip": (
        lambda p, s: edited(p, 1, v=at_knot(5, INDEX[0], 0.3)),
        ("contact", "contact(00111): no slip[index tip on sphere]: |relative velocity| = ", "mm/s <= 1 mm/s"),
    ),
    "stays on": (
        lambda p, s: edited(sliding(p), 1, v=at_knot(5, INDEX, normal_rates(p, s, "index", 5, 0.01))),
        ("contact", "contact(00121): stays on[index tip on sphere]: |relative normal velocity| = ", "mm/s <= 1 mm/s"),
    ),
    "departs": (
        lambda p, s: edited(p, 1, v=at_knot(-1, INDEX, normal_rates(p, s, "index", -1, -0.01))),
        ("jump", "break thumb): departs[index tip on sphere]: relative normal velocity = -10 mm/s >= -1 mm/s", ""),
    ),
    "makes without impact": (
        lambda p, s: edited(p, 0, v=at_knot(-1, INDEX, normal_rates(p, s, "index", 0, -0.01))),
        ("jump", "no slip[index tip on sphere]: |relative velocity| = 10.", "mm/s <= 1 mm/s"),
    ),
    "q' = q": (
        lambda p, s: edited(p, 1, q=at_knot(0, LITTLE, 1e-3)),
        ("jump", "q' = q: max |q' - q| = 0.0573 deg <= 0.00573 deg", "(little_pip)"),
    ),
    "X_WO' = X_WO": (
        lambda p, s: edited(p, 1, X_WO=at_knot(0, 5, 5e-5)),
        ("jump", "X_WO' = X_WO: |p_WO' - p_WO| + 100 mm x turn = 0.05 mm <= 0.01 mm", ""),
    ),
    "hand at rest": (
        lambda p, s: edited(p, 0, v=at_knot(0, LITTLE, 0.1)),
        ("init", "init(00000): hand at rest: max |v| = 5.73 deg/s <= 0.0573 deg/s", "(little_pip)"),
    ),
    "not turning": (
        lambda p, s: edited(p, 0, V_WO=at_knot(0, 1, 0.01)),
        ("init", "init(00000): sphere not turning: |w_WO| = 1.146 deg/s <= 0.0573 deg/s", ""),
    ),
    "not moving": (
        lambda p, s: edited(p, 0, V_WO=at_knot(0, 5, 0.001)),
        ("init", "init(00000): sphere not moving: |v_WO| = 1 mm/s <= 0.1 mm/s", ""),
    ),
}


def into_the_sphere(plan, scene):
    """The second part with the middle finger called free and pressed in."""
    part = replace(
        plan.parts[1], mode="00011", contacts={k: c for k, c in plan.parts[1].contacts.items() if k != "middle"}
    )
    middle = HAND.finger("middle").columns
    rates = normal_rates(plan, scene, "middle", 5, -0.5e-3)
    q = np.array(part.q)
    q[5, middle] += rates
    return replace(part, q=q.tolist())


@pytest.mark.parametrize("what", BREAKS)
def test_each_clause_is_named_when_broken(coarse, kinematic, scene, what):
    change, (kind, *words) = BREAKS[what]
    plan = change(kinematic, scene)
    plan.validate()
    findings = Findings()
    check_predicates(observe(Trajectory(plan), scene), plan, scene, findings)
    assert not findings.worst[kind].ok
    seen = observe(Trajectory(plan), scene)
    judged = {f"{j.predicate}: {j.finding.said}": j for j in judge_predicates(seen, plan, scene)}
    failing = [text for text, j in judged.items() if not j.finding.holds]
    assert any(all(word in text for word in words) for text in failing), failing
    assert findings.worst[kind].where in failing


def test_penetration_is_named(coarse, kinematic, scene):
    """The ring finger bent until its links are in the sphere."""
    ring = HAND.finger("ring").columns
    plan = edited(kinematic, 1, q=lambda q: _bent(q, ring))
    findings = Findings()
    check_predicates(observe(Trajectory(plan), scene), plan, scene, findings)
    said = [
        j.finding.said
        for j in judge_predicates(observe(Trajectory(plan), scene), plan, scene)
        if j.kind == "inv" and j.finding.clause.name == "no penetration" and not j.finding.holds
    ]
    assert said
    assert "distance of all other pairs = -" in said[0]


def _bent(q, columns):
    q[3:8, columns[1:]] = HAND.q_upper[columns[1:]] - 0.02
    return q


def test_a_good_plan_breaks_none(coarse, kinematic, pivot, scene):
    for plan in (kinematic, pivot):
        findings = Findings()
        check_predicates(observe(Trajectory(plan), scene), plan, scene, findings)
        assert all(findings.worst[kind].ok and findings.worst[kind].value == 0 for kind in KINDS)


def test_the_certificate_says_clause_mode_finger_and_amount(coarse, kinematic, scene):
    plan = edited(kinematic, 1, q=at_knot(5, INDEX, normal_rates(kinematic, scene, "index", 5, 5e-4)))
    c = certify(plan, scene=scene)
    (sentence,) = [f for f in c.failures if f.startswith("inv ")]
    assert "in part 1 (inv(00111): contact[index tip on sphere]: |gap| = " in sentence
    assert c.worst["inv"].time_s == pytest.approx(plan.parts[1].t[5], abs=2e-2)
