"""The morning of docs/hardware.md: every command ends as it says there, and leaves nothing powered."""

import re

import pytest
from morning_commands import commands, morning

pytestmark = [pytest.mark.slow, pytest.mark.clocked]


def test_a_morning_with_the_hand(tmp_path, capsys):
    from drake_hand.api import plan

    file = tmp_path / "carry.plan.json"
    plan("carry").save(file)
    ended, outcome = morning(file)
    out, err = capsys.readouterr()
    assert ended == [command.status for command in commands(file)]
    assert err.count("its zero is not known") == 15
    assert not outcome.dropped  # in the last run; after the fault it fell
    assert outcome.position_error_mm < 1.0
    assert outcome.tilt_error_deg < 3.0
    assert outcome.rotation_error_deg < 8.0
    assert "the zeros of 15 drives are known" in out
    assert "ring_pip (node 6): EMCY 0x2310 over-current" in out
    assert "15 of 15 drives are off" in out
    assert "--open lets it fall" in err
    assert "played; 15 drives" in out
    status = out[out.rindex("15 of 15 drives answer") :]
    assert len(re.findall("switch on disabled", status)) == 15
    assert "homed" in status
