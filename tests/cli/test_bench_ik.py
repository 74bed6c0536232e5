import numpy as np

from drake_hand.cli import bench_ik
from drake_hand.contact.chain import FingerKinematics
from drake_hand.model.hand import Hand


def test_every_ratio_has_a_sample_per_repeat(monkeypatch):
    monkeypatch.setattr(bench_ik, "BATCH_ROWS", 300)
    monkeypatch.setattr(bench_ik, "SINGLE_ROWS", 2)
    samples = bench_ik.ik_samples(Hand.load("kanguera"), repeats=2, seed=0)
    assert {"ik_per_s", "ik_vs_drake"} <= set(samples) <= {"ik_per_s", "ik_vs_drake", "ik_vs_pinocchio"}
    assert all(len(values) == 2 and min(values) > 0 for values in samples.values())


def test_the_baseline_reaches_the_same_residual():
    """A baseline that fails would flatter the ratio."""
    hand, rng = Hand.load("kanguera"), np.random.default_rng(0)
    for f, solve in zip(hand.fingers, bench_ik._drake_solvers(hand), strict=True):
        kinematics = FingerKinematics.of(hand, f)
        target = kinematics.fk(rng.uniform(kinematics.lower, kinematics.upper, (40, 3)))[0]
        q = np.array([solve(p) for p in target])
        residual = np.linalg.norm(kinematics.fk(q)[0] - target, axis=1)
        assert (residual <= bench_ik.IK_TOLERANCE_M).mean() > 0.9
