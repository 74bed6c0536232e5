"""Errors as a user and as a program see them."""

from pathlib import Path

import pytest

from drake_hand.errors import DrakeHandError, Evidence, InputError, MissingFile, NoPlanFound, nearest


def test_input_error_lists_what_it_knows():
    e = InputError("wrong", file="a.yaml", key="b", found=1, expected="2 or 3", line=7)
    assert str(e) == "wrong\n  file:     a.yaml, line 7\n  key:      b\n  found:    1\n  expected: 2 or 3"
    assert e.brief == "wrong (in a.yaml; key b; found 1; expected 2 or 3)"
    assert InputError("wrong").brief == "wrong"


def test_within_adds_the_file_where_none_is_named():
    e = MissingFile("wrong", key="b", found=1, expected=2)
    assert e.within(None) is e
    told = e.within(Path("a.yaml"))
    assert (type(told), told.file, told.key, told.found, told.expected) == (MissingFile, Path("a.yaml"), "b", 1, 2)
    assert told.within("b.yaml") is told


@pytest.mark.parametrize(("error", "builtin"), [(InputError, ValueError), (MissingFile, FileNotFoundError)])
def test_errors_are_caught_as_the_builtins_they_are(error, builtin):
    with pytest.raises(builtin) as e:
        raise error("no", file="a")
    assert isinstance(e.value, DrakeHandError)
    assert e.value.exit_status == 2


def test_no_plan_compares_by_how_far_it_got():
    got = [NoPlanFound(str(p), evidence=Evidence(progress=p)) for p in (0.0, None, 0.5)]
    assert [e.progress for e in got] == [0.0, -1.0, 0.5]
    assert max(got, key=lambda e: e.progress) is got[2]
    with pytest.raises(AttributeError):
        got[0].evidence.progress = 1.0


def test_nearest_names_the_nearest_first_and_takes_anything():
    assert nearest("spim", ["carry", "spin"]) == "did you mean 'spin'? known: carry, spin"
    assert nearest(None, ["carry", "spin"]) == "one of: carry, spin"
