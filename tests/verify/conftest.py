"""Plans that are right, to be broken: a sphere grasped and turned."""

import pytest
from breaking import HAND
from grasped_sphere import make_plan

from drake_hand.model.object import Object
from drake_hand.model.scene import Scene


@pytest.fixture(scope="session")
def scene():
    return Scene(HAND, Object.load("sphere"))


@pytest.fixture(scope="session")
def kinematic():
    return make_plan(hold="kinematic")


@pytest.fixture(scope="session")
def held():
    return make_plan()


@pytest.fixture(scope="session")
def pivot():
    return make_plan(model="pivot", hold="kinematic")
