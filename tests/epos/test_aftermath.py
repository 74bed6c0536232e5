"""What comes after a stop with an object in the hand: a run of each row; benchmarks/aftermath.py makes twenty."""

import pytest
from aftermath_rows import ROWS, violations

from drake_hand import api

pytestmark = [pytest.mark.slow, pytest.mark.clocked]


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    file = tmp_path_factory.mktemp("plans") / "carry.plan.json"
    api.plan("carry").save(file)
    return file


@pytest.mark.parametrize("row", ROWS)
def test_it_is_as_it_has_to_be_and_nothing_is_left_powered(row, file):
    assert violations(row, 1, file) == []
