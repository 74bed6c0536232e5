"""Ways to break a plan in one respect, and the check that just that is found."""

import msgspec
import numpy as np

from drake_hand.model.hand import Hand
from drake_hand.verify.certificate import certify
from drake_hand.verify.predicates import KINDS

replace = msgspec.structs.replace
HAND = Hand.load("kanguera")
LITTLE = list(HAND.joints).index("little_pip")


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
    """The worst values, after seeing that just these fields are broken and that the certificate says so.

    Predicates fail with the fields that measure the same; test_predicates looks at them.
    """
    c = certify(plan, scene=scene)
    failing = {name for name, w in c.worst.items() if not w.ok}
    assert failing - set(KINDS) == set(fields), c.failures
    assert c.certified == (not failing)
    assert {f.split()[0] for f in c.failures} == failing
    if not fields:
        assert c.certified, c.failures
    return c.worst
