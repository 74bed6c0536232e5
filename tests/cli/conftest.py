"""Plans of bundled tasks that several modules need, planned once."""

import pytest

from drake_hand.plans.plan import Plan


@pytest.fixture(scope="session")
def carry() -> Plan:
    from drake_hand.api import plan

    return plan("carry")


@pytest.fixture(scope="session")
def paper() -> Plan:
    from drake_hand.api import plan

    return plan("paper")
