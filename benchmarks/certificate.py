"""The certificate against one that asks Drake about every pair at every sample: same verdicts, same figures?

Plans of a few short tasks, good ones (other seeds, angles, frictions) and ones broken in one respect each:

    python benchmarks/certificate.py --broken 200 --good 50

prints how many verdicts and figures differ, which breakages were found, and cpu seconds of both. Slow: minutes.
"""

from __future__ import annotations

import argparse
import dataclasses
import time
from collections import Counter
from unittest.mock import patch

import msgspec
import numpy as np

from drake_hand import api
from drake_hand.cli.bench import spin_by
from drake_hand.model.hand import Hand
from drake_hand.model.object import Object
from drake_hand.model.scene import Scene
from drake_hand.plans.plan import Certificate, Plan
from drake_hand.plans.task import Step, Task
from drake_hand.verify import certificate
from drake_hand.verify.all_pairs import look_at_all_pairs
from drake_hand.verify.observe import Observed, observe

replace = msgspec.structs.replace
SAME = 1e-9


def plain(trajectory, scene, progress=None) -> Observed:
    """What `observe` sees, as Drake alone sees it."""
    seen = observe(trajectory, scene)
    found = look_at_all_pairs(seen, scene)
    R_WO, p_WO = seen.states.X_WO[:, :3, :3], seen.states.X_WO[:, :3, 3]
    far = (seen.digits == 0) & np.isnan(seen.gap)
    gap, n_O = found.gap.copy(), np.einsum("kji,kfj->kfi", R_WO, found.n_W)
    gap[far], n_O[far] = np.nan, np.nan
    p_OC = np.einsum("kji,kfj->kfi", R_WO, found.p_WC - p_WO[:, None])
    radius = np.array([f.radius for f in scene.hand.fingers])
    rows = [int(np.argmin(np.where(seen.states.part == i, found.clearance, np.inf))) for i in range(len(seen.nearest))]
    return dataclasses.replace(
        seen,
        gap=gap,
        n_O=n_O,
        p_OC=p_OC,
        p_OS=p_OC - (radius + gap)[..., None] * n_O,
        nearest=[(float(found.clearance[row]), row, found.pair[row]) for row in rows],
        torque=found.torque,
    )


def rows_of(plan: Plan, part: int, change, *names: str) -> Plan:
    """The plan with arrays of one part changed."""
    changes = {name: change(np.array(getattr(plan.parts[part], name))).tolist() for name in names}
    return replace(plan, parts=[replace(p, **changes) if i == part else p for i, p in enumerate(plan.parts)])


def contacts_of(plan: Plan, part: int, name: str, change) -> Plan:
    """The plan with points or forces of one part's contacts changed."""
    p = plan.parts[part]
    contacts = {f: replace(c, **{name: change(np.array(getattr(c, name))).tolist()}) for f, c in p.contacts.items()}
    return replace(plan, parts=[replace(q, contacts=contacts) if i == part else q for i, q in enumerate(plan.parts)])


def broken(plan: Plan, rng: np.random.Generator) -> tuple[str, Plan]:
    """The plan, broken in one respect, and in which."""
    touching = [i for i, p in enumerate(plan.parts) if p.contacts]
    part, joint = int(rng.choice(touching)), int(rng.integers(len(plan.joints)))
    size, sign = float(rng.uniform(0.3, 1.0)), float(rng.choice([-1, 1]))
    task, held = plan.task, plan.task.options.hold == "equilibrium"

    def bump(amount: float, column: int):
        def change(rows: np.ndarray) -> np.ndarray:
            rows[:, column] += amount * np.sin(np.linspace(0, np.pi, len(rows))) ** 2
            return rows

        return change

    def asked(**changes) -> Plan:
        return replace(plan, task=replace(task, options=replace(task.options, **changes)))

    def events(p: Plan) -> Plan:
        return replace(p, parts=[replace(q, events=[]) if i == part else q for i, q in enumerate(p.parts)])

    def last_goal() -> Plan:
        motion = list(task.motion)
        i, turn = [(i, s.rotate) for i, s in enumerate(motion) if s.rotate][-1]
        motion[i] = Step(rotate=replace(turn, angle_deg=turn.angle_deg + sign * size))
        return replace(plan, task=replace(task, motion=motion))

    kinds = {
        "joint off its path": lambda: rows_of(plan, part, bump(sign * size * 0.3, joint), "q"),
        "joint far off its path": lambda: rows_of(plan, part, bump(sign * size * 1.5, joint), "q"),
        "joint jumps": lambda: rows_of(plan, part, lambda q: q + sign * 2e-3 * np.eye(q.shape[1])[joint], "q"),
        "joint rushes": lambda: rows_of(plan, part, lambda v: v * (1 + 3 * size), "v"),
        "object off its path": lambda: rows_of(plan, part, bump(size * 1e-3, int(rng.integers(4, 7))), "X_WO"),
        "object moves at rest": lambda: rows_of(plan, part, lambda V: V + 2e-3 * size, "V_WO"),
        "contact points elsewhere": lambda: contacts_of(plan, part, "p_OP", lambda p: p + 3e-4 * size),
        "events missing": lambda: events(plan) if plan.parts[part].events else asked(modes=["0" * len(plan.fingers)]),
        "more contacts asked": lambda: asked(min_contacts=len(plan.fingers) + 1),
        "another goal": last_goal,
        "too quick": lambda: replace(
            plan,
            parts=[
                replace(
                    p,
                    t=(np.array(p.t) / 1.5).tolist(),
                    v=(np.array(p.v) * 1.5).tolist(),
                    V_WO=(np.array(p.V_WO) * 1.5).tolist(),
                )
                for p in plan.parts
            ],
        ),
    }
    if held:
        kinds |= {
            "forces too large": lambda: contacts_of(plan, part, "f_W", lambda f: f * (1 + size)),
            "forces aside": lambda: contacts_of(plan, part, "f_W", lambda f: f + 0.2 * size),
            "commands without forces": lambda: rows_of(plan, part, lambda o: 0 * o, "q_offset"),
            "less friction": lambda: replace(plan, task=replace(task, physics=replace(task.physics, friction=0.3))),
            "another gravity": lambda: replace(
                plan, task=replace(task, physics=replace(task.physics, gravity=(0.0, 9.81 * sign, 0.0)))
            ),
        }
    kind = str(rng.choice(list(kinds)))
    return kind, kinds[kind]()


def bases(good: int) -> list[Plan]:
    """Good plans of short tasks."""
    plans = []
    for seed in range(good):
        name = ("paper", "spin")[seed % 2]
        angle = 6.0 + 3.0 * (seed // 2 % 4)
        plans.append(api.plan(spin_by(Task.load(name), angle), seed=seed // 8))
    return plans


def differing(a: Certificate, b: Certificate) -> list[str]:
    """Fields whose values differ."""
    out = [] if a.certified == b.certified else ["verdict"]
    for key, worst in a.worst.items():
        x, y = worst.value, b.worst[key].value
        if (x is None) != (y is None) or (x is not None and y is not None and abs(x - y) > SAME * max(1.0, abs(y))):
            out.append(f"{key} {x} {y}")
    return out


def main() -> None:
    """Runs the comparison."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--broken", type=int, default=200)
    parser.add_argument("--good", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    good = bases(arguments.good)
    rng = np.random.default_rng(arguments.seed)
    plans = [("good", p) for p in good] + [broken(good[i % len(good)], rng) for i in range(arguments.broken)]
    scenes: dict[str, Scene] = {}
    seconds, differ = [0.0, 0.0], 0
    passed, failed = Counter[str](), Counter[str]()
    for kind, plan in plans:
        key = f"{plan.task.hand} {plan.task.object} {plan.object_mass_kg}"
        if key not in scenes:
            object_ = Object.load(plan.task.object)
            scenes[key] = Scene(Hand.load(plan.task.hand), object_, object_mass=plan.object_mass_kg)
        t = [time.process_time()]
        ours = certificate.certify(plan, scene=scenes[key])
        t.append(time.process_time())
        with patch.object(certificate, "observe", plain):
            reference = certificate.certify(plan, scene=scenes[key])
        t.append(time.process_time())
        # the reference looks with `observe` first, for what it does not replace
        seconds[0] += t[1] - t[0]
        seconds[1] += t[2] - t[1]
        (passed if ours.certified else failed)[kind] += 1
        if what := differing(ours, reference):
            differ += 1
            print(f"differs: {kind}: {'; '.join(what)}", flush=True)
    print(f"{len(plans)} plans, {differ} differ in verdict or in a figure by more than {SAME:g}")
    print(f"cpu s: {seconds[0]:.1f}, all pairs {seconds[1]:.1f}")
    for kind in sorted({k for k, _ in plans}):
        print(f"  {kind:26} certified {passed[kind]:3}  refused {failed[kind]:3}")


if __name__ == "__main__":
    main()
