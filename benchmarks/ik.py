"""Prints the rate of the batched inverse kinematics and its ratio to one program per contact (`--help` for options)."""

import argparse
from statistics import median

from drake_hand.cli.bench_ik import BATCH_ROWS, IK_TOLERANCE_M, SINGLE_ROWS, ik_samples
from drake_hand.model.hand import Hand

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("hand", nargs="?", default="kanguera", help="bundled name or path of a hand.yaml")
parser.add_argument("--repeats", type=int, default=5)
parser.add_argument("--seed", type=int, default=0)
args = parser.parse_args()

hand = Hand.load(args.hand)
print(
    f"{hand.name}: {BATCH_ROWS} contacts a finger in a batch, {SINGLE_ROWS} one by one,"
    f" residual <= {IK_TOLERANCE_M:g} m"
)
for name, values in ik_samples(hand, repeats=args.repeats, seed=args.seed).items():
    print(f"{name:16} median {median(values):10.0f}  min {min(values):10.0f}  max {max(values):10.0f}  n {len(values)}")
