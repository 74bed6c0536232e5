"""What `plan` and `check` say of a plan: the verdict first, then the modes and how near each figure is to its limit."""

from __future__ import annotations

from drake_hand.cli.output import print_table
from drake_hand.model.hand import Hand
from drake_hand.plans.plan import Certificate, Plan


def print_plan(subject: Plan, *, regrasps: int, everything: bool) -> None:
    """Prints the verdict about a new plan, the modes of each finger over time, its steps, and its certificate.

    Args:
        subject: the plan, with its certificate.
        regrasps: fingers that broke contact and made it elsewhere.
        everything: also every part, and all figures of the certificate.
    """
    from drake_hand.plans.words import mode_strip, plan_verdict
    from drake_hand.verify.pieces import piece_lines

    print(plan_verdict(subject, Hand.load(subject.task.hand)))
    print(
        f"{len(subject.parts)} parts, {regrasps} regrasp{'s' * (regrasps != 1)}, {subject.duration:.1f} s of motion\n"
    )
    print("\n".join(mode_strip(subject)), "  . free  = rolling  ~ sliding", *piece_lines(subject), sep="\n")
    if everything:
        print_table(
            "Parts",
            ["#>", "mode", "start s>", "end s>", "event"],
            [(i, p.mode, f"{p.t[0]:.2f}", f"{p.t[-1]:.2f}", ", ".join(p.events)) for i, p in enumerate(subject.parts)],
        )
    if subject.certificate:
        print_figures(subject.certificate, everything=everything)


def print_certificate(certificate: Certificate, subject: Plan, *, everything: bool) -> None:
    """Prints the verdict of a certificate and the figures it rests on.

    Args:
        certificate: what the checker found.
        subject: the plan it is about.
        everything: all figures, not only what a person asks for first and whatever fails.
    """
    from drake_hand.plans.words import verdict

    kinematic = subject.task.options.hold == "kinematic"
    print(verdict(certificate, Hand.load(subject.task.hand), kinematic=kinematic))
    print_figures(certificate, everything=everything)


def print_figures(certificate: Certificate, *, everything: bool) -> None:
    """Prints the figures of a certificate: value, limit, how much of what is allowed is left, and where."""
    from drake_hand.plans.words import figure_lines

    shown = figure_lines(certificate, everything=everything)
    rest = len(certificate.worst) - len(shown)
    print_table(
        f"Worst of {certificate.samples} samples" + (f"; {rest} more figures with --all" if rest else ""),
        ["", "value>", "limit", "margin>", "where", ""],
        [(x.words, x.value, x.limit, x.margin, x.where, "" if x.ok else "FAILS") for x in shown],
    )
