"""What is said of a certificate: verdict first, margins in per cent, plain words."""

import msgspec
import pytest

from drake_hand.plans.plan import Certificate, Worst
from drake_hand.plans.task import Task
from drake_hand.plans.words import KINEMATIC, figure, figure_lines, mode_strip, per_cent, plan_verdict, verdict


def certificate(*, certified=True, **worst):
    return Certificate(certified=certified, samples=9, worst=worst, failures=[], plan_hash="")


def at(value, limit, ok=True, **place):
    return Worst(value=value, limit=limit, ok=ok, **place)


def test_verdict_names_what_is_nearest_to_its_limit_and_what_the_limit_is(hand):
    speed = at(0.998, 1.0, time_s=0.39, part=0, where="thumb_opposition")
    found = certificate(contact_mm=at(0.001, 0.1), speed_ratio=speed, force_margin=at(0.45, 0.0))
    limit = hand.speed[hand.joints.index("thumb_opposition")] * 57.29578
    nearest = f"joint speed 99.8 % of {limit:.0f} deg/s (0.39 s, thumb_opposition)"
    assert verdict(found, hand) == f"certified; nearest to its limit: {nearest}"
    low = certificate(speed_ratio=at(0.7, 1.0), force_margin=at(0.02, 0.0, where="ring"))
    assert verdict(low) == "certified; nearest to its limit: friction cone left 2.0 % (ring)"


def test_verdict_of_what_fails_names_all_that_fails():
    found = certificate(certified=False, slip_mm=at(0.8, 0.5, ok=False, where="index"), contact_mm=at(0.01, 0.1))
    assert verdict(found) == "NOT certified: slip of a contact 0.8 mm (index) (limit at most 0.5 mm)"


def test_a_plan_that_stops_on_the_way_says_how_far_it_got():
    missed = at(273.0, 0.1, ok=False, time_s=9.0, where="step 2, rotate: turned 87 of 360 deg")
    found = certificate(certified=False, goal_rotation_deg=missed)
    (line,) = figure_lines(found)
    assert (line.value, line.margin, line.where) == ("273 deg", "turned 87 of 360 deg", "9.00 s, step 2, rotate")
    assert verdict(found).startswith("NOT certified: turned 87 of 360 deg (9.00 s, step 2, rotate)")


def test_kinematic_plans_are_not_called_certified_alone():
    found = certificate(force_margin=at(None, 0.0), slip_mm=at(0.4, 0.5))
    assert verdict(found, kinematic=True).startswith("certified, kinematics only; nearest to its limit: slip")
    (force,) = (line for line in figure_lines(found) if line.field == "force_margin")
    assert (force.value, force.margin) == (KINEMATIC, "")


def test_margins_are_shares_of_what_is_allowed():
    found = certificate(slip_mm=at(0.1, 0.5), limit_margin_rad=at(0.0698, 0.0), penetration_mm=at(-1.03, 0.0))
    told = {line.field: (line.value, line.limit, line.margin) for line in figure_lines(found)}
    assert told["slip_mm"] == ("0.1 mm", "at most 0.5 mm", "80 %")
    assert told["limit_margin_rad"] == ("4 deg", "at least 0 deg", "")
    (missed,) = figure_lines(certificate(goal_position_mm=at(166.0, 0.1, ok=False)))
    assert (missed.value, missed.margin) == ("166 mm", "1660 x the limit")
    assert told["penetration_mm"] == ("1.03 mm", "at least 0 mm", "")


def test_short_table_still_shows_whatever_fails():
    found = certificate(certified=False, drift_mm=at(1.0, 0.01, ok=False), object_jump_mm=at(0.0, 0.01))
    assert [line.field for line in figure_lines(found, everything=False)] == ["drift_mm"]
    assert {line.field for line in figure_lines(found)} == {"drift_mm", "object_jump_mm"}


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.9998, "99.98 %"), (0.45, "45 %"), (1.0, "100 %"), (0.0, "0 %"), (0.0016, "0.16 %"), (-0.5, "-50 %")],
)
def test_per_cent_tells_from_none_and_all(value, text):
    assert per_cent(value) == text


@pytest.mark.parametrize(("value", "text"), [(1e-9, "0"), (0.0007842, "0.000784"), (1500.0, "1500"), (29.57, "29.6")])
def test_figures_have_three_digits(value, text):
    assert figure(value) == text


def test_mode_strip_has_a_line_per_finger_thumb_first(sample_plan):
    strip = mode_strip(sample_plan, width=10)
    assert strip[0].split() == ["thumb", "..========"]
    assert strip[1].split() == ["index", "..==....~~"]
    assert strip[-1].split() == ["0", "5", "s"]


def test_a_plan_shows_itself_and_is_short(sample_plan):
    assert plan_verdict(sample_plan) == "not checked yet"
    assert repr(sample_plan) == "Plan(pencil_r8: grasp; kanguera, 5 parts, 5.0 s, not checked)"
    html = msgspec.structs.replace(sample_plan, hand="<b>")._repr_html_()
    assert "&lt;b&gt;" in html
    assert "thumb ....." in html
    assert len(html) < 5000


def test_a_task_shows_what_was_written():
    shown = Task.load("carry")._repr_html_()
    for told in (
        "{translate: {by_mm: [10.0, 0.0, 0.0]}}",
        "{xyz_mm: [53.0, -2.0, 119.0], rpy_deg: ",
        "{grasp: {}}",
        ">kanguera<",
    ):
        assert told in shown
    assert "None" not in shown
    assert "time_limit_s" not in shown
    assert "joints_deg" not in shown


def test_a_plan_is_asked_at_times(sample_plan, hand):
    states = sample_plan.at([0.0, 2.5])
    assert states.q.shape == (2, hand.nq)
    assert states.part.tolist() == [0, 2]
