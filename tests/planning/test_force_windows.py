"""Forces in windows are those of one program over the whole path, and windows that are alike are solved once."""

from dataclasses import replace

import numpy as np
import pytest

from drake_hand.contact.cone_program import Unbalanced
from drake_hand.contact.contact_sets import ContactSets
from drake_hand.contact.forces import ForceProblem, balance_forces
from drake_hand.planning import force_windows

LEG = 12


def path(legs: int, *, friction: float = 0.6) -> tuple[ContactSets, ForceProblem, np.ndarray]:
    """Three contacts about a disc whose preload comes and goes once every four legs; with the knots legs start at."""
    n = legs * LEG + 1
    angle = np.array([0.0, 2.1, 4.2])
    n_W = np.stack([np.cos(angle), np.sin(angle), np.zeros(3)], axis=1)
    sets = ContactSets(
        p_WP=np.tile(0.02 * n_W, (n, 1, 1)),
        n_W=np.tile(n_W, (n, 1, 1)),
        J_WP=np.zeros((n, 3, 3, 1)),
        mask=np.ones((n, 3), dtype=bool),
        p_WCom=np.zeros((n, 3)),
    )
    preload = 0.5 + 0.3 * np.sin(2 * np.pi * np.arange(n) / (4 * LEG))
    problem = ForceProblem(
        load=np.ones((n, 3)),
        preload=np.repeat(preload[:, None], 3, axis=1),
        force_W=np.array([0.0, 0.0, -0.3]),
        friction=friction,
        torsion_radius=1e-3,
        effort=np.ones((3, 1)),
    )
    return sets, problem, np.arange(legs + 1) * LEG


def test_windows_agree_with_one_program() -> None:
    """The ends of blocks, where smoothness is cut, differ by few thousandths of a newton."""
    sets, problem, starts = path(20)
    whole = balance_forces(sets, problem).f_W
    assert np.abs(force_windows.forces_along(sets, problem, starts) - whole).max() < 5e-3


def test_repeats_are_solved_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Twice as long a gait takes no more programs."""
    solved = []
    monkeypatch.setattr(force_windows, "balance_forces", lambda s, p: solved.append(len(s)) or balance_forces(s, p))
    for legs in (20, 40):
        sets, problem, starts = path(legs)
        force_windows.forces_along(sets, problem, starts)
    assert len(solved) % 2 == 0
    assert sum(solved[: len(solved) // 2]) < len(path(20)[0]) * 1.8
    assert sorted(solved[: len(solved) // 2]) == sorted(solved[len(solved) // 2 :])


def test_what_was_solved_before_is_not_solved_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """Only the windows that reach where the problem has changed."""
    sets, problem, starts = path(40)
    arm, solved = np.zeros(problem.load.shape), dict[bytes, np.ndarray]()
    problem = replace(problem, spin=np.ones(arm.shape), spin_arm=arm.copy())
    before = force_windows.forces_along(sets, problem, starts, solved)
    known, asked = len(solved), []
    monkeypatch.setattr(force_windows, "balance_forces", lambda s, p: asked.append(p) or balance_forces(s, p))
    np.testing.assert_array_equal(force_windows.forces_along(sets, problem, starts, solved), before)
    assert not asked
    arm[300] = 4e-3
    force_windows.forces_along(sets, replace(problem, spin_arm=arm), starts, solved)
    assert 0 < len(asked) == len(solved) - known <= 3


def test_windows_that_differ_are_not_taken_for_alike() -> None:
    """An object that is heavier in one place is held there, and elsewhere as before."""
    sets, problem, starts = path(40)
    force_W = np.tile(problem.force_W, (len(sets), 1))
    force_W[300] *= 2
    f = force_windows.forces_along(sets, replace(problem, force_W=force_W), starts)
    np.testing.assert_allclose(f.sum(axis=1), -force_W, atol=1e-6)
    usual = force_windows.forces_along(sets, problem, starts)
    assert np.abs(f[:200] - usual[:200]).max() == 0


def test_a_pad_that_is_twisted_once_makes_a_difference() -> None:
    """Its torque is borne by the others there, and elsewhere forces are as before."""
    sets, problem, starts = path(40)
    spin = np.zeros(problem.load.shape)
    spin[300, 0] = 1.0
    spinning = replace(problem, spin=spin, spin_arm=4e-3)
    f, usual = (force_windows.forces_along(sets, some, starts) for some in (spinning, problem))
    torque = np.cross(sets.p_WP[300], f[300]).sum(axis=0)
    assert torque @ sets.n_W[300, 0] > 1e-4
    assert np.abs(f[:200] - usual[:200]).max() == 0


def test_no_balance_is_said() -> None:
    """As by one program."""
    with pytest.raises(Unbalanced):
        force_windows.forces_along(*path(20, friction=0.0))


def test_forces_are_given_up_when_time_is_up() -> None:
    sets, problem, starts = path(4)
    with pytest.raises(force_windows.OutOfTime):
        force_windows.forces_along(sets, problem, starts, until=0.0)
