"""Figures show what the plan holds."""

import matplotlib.image
import numpy as np
import pytest

from drake_hand.contact.submodel import Submodel
from drake_hand.plans.trajectory import Trajectory
from drake_hand.view import figures
from drake_hand.view.colors import SUBMODEL


def states(plan):
    return Trajectory(plan).at(np.linspace(0, plan.duration, 101))


def test_all_figures_are_written(sample_plan, hand, tmp_path):
    files = figures.draw_plan(sample_plan, hand, tmp_path / "figures")
    assert [f.stem for f in files] == ["modes", "joints", "speeds", "object", "contacts", "forces"]
    for f in files:
        assert matplotlib.image.imread(f).std() > 0.02


def test_timeline_has_a_bar_per_finger_and_part(sample_plan):
    ax = figures.draw_modes(sample_plan).axes[0]
    assert len(ax.patches) == 25
    bar = next(b for b in ax.patches if b.get_x() == 4.0 and b.get_y() < 3 < b.get_y() + b.get_height())
    assert matplotlib.colors.to_hex(bar.get_facecolor()) == SUBMODEL[Submodel.SLIDE]


def test_contact_gap_is_the_distance_of_tip_and_point(sample_plan, hand):
    figure = figures.draw_contacts(sample_plan, hand, states(sample_plan))
    lines = {line.get_label(): line.get_ydata() for line in figure.axes[0].get_lines()}
    assert np.nanmax(np.abs(lines["thumb"])) < 1e-3
    assert np.isnan(lines["little"]).all()


def test_speeds_are_shares_of_the_limit(sample_plan, hand):
    s = states(sample_plan)
    thumb = panel(figures.draw_speeds(sample_plan, hand, s), "thumb")
    (speed,) = (line for line in thumb.get_lines() if line.get_label() == "speed")
    columns = hand.finger("thumb").columns
    assert np.max(speed.get_ydata()) == pytest.approx(np.abs(s.v[:, columns] / hand.speed[columns]).max())


def panel(figure, finger):
    return next(ax for ax in figure.axes if ax.get_title(loc="left") == finger)


def test_joint_panels_carry_limits(sample_plan, hand):
    index = panel(figures.draw_joints(sample_plan, hand, states(sample_plan)), "index")
    drawn = {round(float(line.get_ydata()[0]), 3) for line in index.get_lines() if line.get_linestyle() == "--"}
    columns = hand.finger("index").columns
    limits = np.degrees(np.r_[hand.q_lower[columns], hand.q_upper[columns]])
    assert {round(float(x), 3) for x in limits} <= drawn
