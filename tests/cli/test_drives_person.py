"""The person at the hand: what counts as Enter, and what does not."""

import os
import sys
import time

import pytest

from drake_hand.cli.drives_person import Terminal


@pytest.fixture
def typing(monkeypatch):
    """``typing(text)`` types; ``typing(None)`` goes away for good."""
    read, write = os.pipe()
    monkeypatch.setattr(sys, "stdin", os.fdopen(read, "r", buffering=1))
    with os.fdopen(write, "w") as keyboard:

        def typed(text):
            keyboard.close() if text is None else (keyboard.write(text), keyboard.flush())

        yield typed
    sys.stdin.close()


def terminal(**options) -> Terminal:
    return Terminal(lambda _: "what", power=True, **options)


def test_a_pause_ends_on_enter_and_not_when_nobody_can_type(typing, capsys):
    person = terminal(words={1.0: "hand it over"})
    assert not person.goes_on(1.0)
    typing("\n")
    assert person.goes_on(1.0)
    typing(None)
    assert not person.goes_on(2.0)
    assert "1.00 s: hand it over; Enter goes on" in capsys.readouterr().err


def test_a_pause_ends_after_its_time(typing):
    person = terminal(go_after=0.2)
    assert not person.goes_on(1.0)
    time.sleep(0.25)
    assert person.goes_on(1.0)
    assert not person.goes_on(2.0)


def test_a_hand_that_holds_is_let_go_by_a_word_only(typing, capsys):
    person = terminal()
    assert person.decides() is None
    assert "for 60 s at most" in capsys.readouterr().err
    typing("\nwhat\n")
    assert [person.decides(), person.decides()] == [None, None]
    typing("open\n")
    assert person.decides() == "open"


def test_power_is_not_given_without_a_terminal(typing):
    typing("\n")
    with pytest.raises(ValueError, match="nobody is there"):
        terminal().agrees(None)
