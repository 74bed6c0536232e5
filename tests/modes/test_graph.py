"""The drawing: every mode has a place on the ring of its contacts, and files are whole or not there."""

from pathlib import Path

import numpy as np
import pytest

from drake_hand.errors import InputError
from drake_hand.modes.code import Mode, all_modes
from drake_hand.modes.graph import draw, layout

FINGERS = ["ring", "index", "thumb"]


@pytest.mark.parametrize("n", [1, 3, 5])
def test_modes_stand_apart_on_the_ring_of_their_contacts(n: int) -> None:
    places, radii = layout(n)
    assert sorted(places) == list(all_modes(n))
    for mode, place in places.items():
        assert np.linalg.norm(place) == pytest.approx(radii[len(mode.touching)])
    points = np.array(list(places.values()))
    distances = np.linalg.norm(points[:, None] - points, axis=-1) + np.eye(len(points)) * 9
    assert distances.min() > 0.4


def test_drawing_shows_every_code(tmp_path: Path) -> None:
    draw(tmp_path / "g.svg", FINGERS, title="modes", highlight=Mode.parse("011", FINGERS))
    text = (tmp_path / "g.svg").read_text()
    assert all(f"<!-- {mode} -->" in text for mode in all_modes(3))
    assert "2 fingers: 12 modes" in text


def test_png(tmp_path: Path) -> None:
    draw(tmp_path / "g.PNG", FINGERS, title="modes")
    assert (tmp_path / "g.PNG").read_bytes().startswith(b"\x89PNG")


def test_what_cannot_be_drawn_is_said_and_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="svg, png, pdf"):
        draw(tmp_path / "g.jpg", FINGERS, title="modes")
    with pytest.raises(InputError, match="too many to draw"):
        draw(tmp_path / "g.svg", [f"f{i}" for i in range(7)], title="modes")
    assert not list(tmp_path.iterdir())
