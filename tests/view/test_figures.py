"""Figures show what the plan holds, in a column of a paper."""

from types import SimpleNamespace

import matplotlib.colors
import matplotlib.figure
import matplotlib.image
import numpy as np
import pytest
from PIL import Image

from drake_hand import cli
from drake_hand.errors import InputError
from drake_hand.model.object import Object
from drake_hand.model.scene import Scene
from drake_hand.physics.run import Errors
from drake_hand.plans.trajectory import Trajectory
from drake_hand.verify.observe import observe
from drake_hand.view import figures, paper_figures
from drake_hand.view.colors import SUBMODEL_COLORS, finger_color
from drake_hand.view.course import Course
from drake_hand.view.replay_figures import draw_replay_errors
from drake_hand.view.sketch import Sketch, write_gif

NAMES = [
    "fig11_automaton", "fig12_coordination", "fig13_states", "fig14_frames", "fig15_path", "fig16_velocity",
    "modes", "joints", "speeds", "object", "contacts", "contact_map", "forces", "margin",
]  # fmt: skip


@pytest.fixture(scope="module")
def course(sample_plan, hand):
    return Course.of(sample_plan, hand, np.linspace(0, sample_plan.duration, 101))


def test_all_figures_are_a_column_wide_and_not_blank(sample_plan, hand, tmp_path):
    files = figures.draw_plan(sample_plan, hand, tmp_path / "figures")
    assert [f.stem for f in files] == NAMES
    for f in files:
        image = matplotlib.image.imread(f)
        assert image.std() > 0.02
        assert image.shape[1] == pytest.approx(85 / 25.4 * 300, abs=2)


def test_formats_are_those_asked_for(sample_plan, hand, tmp_path, capsys, monkeypatch):
    """Of one figure: all are drawn above."""
    one = {"modes": figures.drawings(sample_plan, hand)["modes"]}
    monkeypatch.setattr(figures, "drawings", lambda *_: one)
    sample_plan.save(tmp_path / "a.plan.json")
    command = ["plot", str(tmp_path / "a.plan.json"), "-o", str(tmp_path / "f")]
    assert cli.run([*command, "--format", "tiff"]) == 2
    assert "svg, pdf, png" in capsys.readouterr().err
    assert cli.run([*command, "--format", "svg,pdf", "--gif", str(tmp_path / "a.gif")]) == 0
    written = {f.name for f in (tmp_path / "f").iterdir()}
    assert written == {"modes.svg", "modes.pdf"}
    picture = Image.open(tmp_path / "a.gif")
    assert picture.n_frames * picture.info["duration"] == pytest.approx(8000, rel=0.1)
    assert (tmp_path / "a.gif").stat().st_size < 2e6


def test_an_interrupted_moving_picture_is_not_written(sample_plan, hand, tmp_path):
    def interrupt(p):
        seen.append(p.fraction)
        if len(seen) == 2:
            raise KeyboardInterrupt

    seen: list[float] = []
    course = Course.of(sample_plan, hand, np.linspace(0, sample_plan.duration, 20))
    with pytest.raises(KeyboardInterrupt):
        write_gif(sample_plan, course, tmp_path / "a.gif", progress=interrupt)
    assert 0 < seen[0] < seen[1] < 0.1
    assert list(tmp_path.iterdir()) == []


def test_timeline_has_a_bar_per_finger_and_part(sample_plan):
    ax = figures.draw_modes(sample_plan).axes[0]
    assert len(ax.patches) == 25
    bar = next(b for b in ax.patches if b.get_x() == 4.0 and b.get_y() < 3 < b.get_y() + b.get_height())
    assert matplotlib.colors.to_hex(bar.get_facecolor()) == SUBMODEL_COLORS["2"]


def test_contact_gap_is_the_distance_of_tip_and_point(sample_plan, course):
    figure = figures.draw_contacts(sample_plan, course)
    lines = {line.get_label(): line.get_ydata() for line in figure.axes[0].get_lines()}
    assert np.nanmax(lines["thumb"]) < 1e-3
    assert "little" not in lines, "it touches nothing"


def test_speeds_are_shares_of_the_limit(sample_plan, hand, course):
    thumb = panel(figures.draw_speeds(sample_plan, course), "thumb")
    (speed,) = (line for line in thumb.get_lines() if line.get_label() == "speed")
    columns = hand.finger("thumb").columns
    assert np.max(speed.get_ydata()) == pytest.approx(
        100 * np.abs(course.states.v[:, columns] / hand.speed[columns]).max()
    )


def test_joints_are_drawn_as_their_place_in_the_range(sample_plan, hand, course):
    index = panel(figures.draw_joints(sample_plan, course), "index")
    (flexion,) = (line for line in index.get_lines() if line.get_label() == "flexion")
    i = hand.joints.index("index_flexion")
    q = hand.q_lower[i] + np.array(flexion.get_ydata()) / 100 * (hand.q_upper[i] - hand.q_lower[i])
    np.testing.assert_allclose(q, course.states.q[:, i], atol=1e-12)


def test_activation_is_that_of_the_modes(sample_plan, course):
    index = panel(paper_figures.draw_coordination(sample_plan, course), "index")
    active = np.array(index.get_lines()[0].get_ydata())
    t = course.states.t
    assert not active[t < 1].any()
    assert active[(t > 1) & (t < 2)].all()
    assert not active[(t > 2) & (t < 4)].any()


def test_states_are_lettered_from_the_one_without_contact(sample_plan):
    figure = paper_figures.draw_states(sample_plan)
    assert [t.get_text() for t in figure.axes[0].texts] == ["A\n00000", "B\n00121", "C\n00111", "D\n00101"]
    arrows = {matplotlib.colors.to_hex(arrow.get_edgecolor()) for arrow in figure.axes[0].patches}
    index = finger_color(sample_plan.fingers.index("index"))
    assert index in arrows
    assert [t.get_text() for t in figure.legends[0].get_texts()] == ["several fingers", "index"]


def test_the_object_is_drawn_from_its_faces_that_look_this_way(sample_plan, course):
    ax = matplotlib.figure.Figure().subplots()
    Sketch(sample_plan, course).draw(ax, 1.5)
    faces = ax.collections[0]
    (mesh,) = [g.to_trimesh() for g in Object.load("pencil_r8").geometries]
    assert 0 < len(faces.get_paths()) < len(mesh.faces)
    assert len(np.unique(faces.get_facecolor(), axis=0)) > 2, "halves and slopes can be told apart"


def test_replay_errors_show_each_engine_and_who_dropped(sample_plan):
    def run(dropped, mm):
        errors = Errors(t=[1.0, 2.0], position_mm=[0.0, mm], tilt_deg=[0.1, 0.2], rotation_deg=[-0.1, -0.3])
        return SimpleNamespace(errors=errors, dropped=dropped)

    figure = draw_replay_errors(sample_plan, {"drake": run(False, 0.5), "mujoco": run(True, 30.0)})
    position, _, turn = figure.axes
    lines = {line.get_label(): line for line in position.get_lines()}
    assert list(lines["drake"].get_ydata()) == [0.01, 0.5]
    assert list(lines["mujoco, dropped"].get_ydata()) == [0.01, 30.0]
    assert list(turn.get_lines()[0].get_ydata()) == [0.1, 0.3]


def test_effort_is_that_of_the_checker(sample_plan, hand, course):
    scene = Scene(hand, Object.load("pencil_r8"))
    seen = observe(Trajectory(sample_plan), scene)
    held = seen.states.t > 1
    shares = np.abs(seen.torque[held]) / hand.effort
    for finger in hand.fingers:
        own = course.effort[course.states.t > 1, finger.index].max()
        assert own == pytest.approx(shares[:, finger.columns].max(), rel=0.02, abs=1e-9)


def test_unknown_format_is_named(sample_plan, hand, tmp_path):
    with pytest.raises(InputError, match="unknown format"):
        figures.draw_plan(sample_plan, hand, tmp_path, formats=("bmp",))


def panel(figure, finger):
    return next(ax for ax in figure.axes if ax.get_title(loc="left") == finger)
