"""Mode codes: what they say, what is refused, and how many there are."""

from collections import Counter

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drake_hand.contact.submodel import Submodel
from drake_hand.errors import InputError
from drake_hand.modes.code import Mode, all_modes, contact_counts, listed

FINGERS = ["little", "ring", "middle", "index", "thumb"]


@given(st.text("012", min_size=1, max_size=9))
def test_code_survives_parsing(code: str) -> None:
    mode = Mode.parse(code, [f"f{i}" for i in range(len(code))])
    assert mode.code == str(mode) == code
    assert sorted(mode.touching + mode.free) == list(range(len(code)))
    assert all(code[i] == "0" for i in mode.free)


@pytest.mark.parametrize(
    ("code", "words"),
    [
        ("00111", "little and ring free; middle, index and thumb rolling"),
        ("22212", "index rolling; little, ring, middle and thumb sliding"),
        ("00000", "little, ring, middle, index and thumb free"),
        ("00010", "little, ring, middle and thumb free; index rolling"),
    ],
)
def test_words(code: str, words: str) -> None:
    assert Mode.parse(code, FINGERS).words(FINGERS) == words


@pytest.mark.parametrize(
    ("code", "said"),
    [
        ("0011", "has 4 digits for a hand of 5 fingers"),
        ("001111", "has 6 digits"),
        ("", "has 0 digits"),
        ("00131", "has '3' at place 4"),
        ("0011a", "has 'a' at place 5"),
        ("0²111", "has '²' at place 2"),
    ],
)
def test_wrong_codes_are_refused_in_words(code: str, said: str) -> None:
    with pytest.raises(InputError, match="mode code") as e:
        Mode.parse(code, FINGERS, key="options.modes[0]")
    assert said in str(e.value)
    assert e.value.exit_status == 2
    assert e.value.found == code
    assert e.value.key == "options.modes[0]"
    assert "little, ring, middle, index, thumb" in str(e.value)


def test_five_fingers_have_the_papers_counts() -> None:
    assert contact_counts(5) == [1, 10, 40, 80, 80, 32]


@given(st.integers(1, 6))
def test_counts_are_those_of_the_modes(n: int) -> None:
    modes = list(all_modes(n))
    assert len(set(modes)) == 3**n
    assert modes == sorted(modes)
    counts = Counter(len(m.touching) for m in modes)
    assert [counts[k] for k in range(n + 1)] == contact_counts(n)


def test_replace_changes_one_finger() -> None:
    mode = Mode.parse("00111", FINGERS)
    assert mode.replace(4, Submodel.FREE).code == "00110"
    assert mode.replace(0, Submodel.SLIDE).code == "20111"


@pytest.mark.parametrize(("names", "text"), [([], ""), (["a"], "a"), (["a", "b"], "a and b")])
def test_listed(names: list[str], text: str) -> None:
    assert listed(names) == text
