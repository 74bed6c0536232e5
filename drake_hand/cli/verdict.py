"""What `plan` and `check` say of a plan: its parts and its certificate."""

from __future__ import annotations

from drake_hand.cli.output import print_table
from drake_hand.plans.plan import Certificate, Plan, Worst


def print_parts(subject: Plan) -> None:
    """Prints when which mode starts, and by what event."""
    print_table(
        "Parts",
        ["#>", "mode", "start s>", "end s>", "event"],
        [(i, p.mode, f"{p.t[0]:.2f}", f"{p.t[-1]:.2f}", ", ".join(p.events)) for i, p in enumerate(subject.parts)],
    )


def print_certificate(certificate: Certificate) -> None:
    """Prints what was checked, and what fails."""

    def place(w: Worst) -> str:
        when = f"{w.time_s:.3f} s" if w.time_s is not None else ""
        return ", ".join(x for x in (when, f"part {w.part}" if w.part is not None else "", w.where) if x)

    print_table(
        f"Certificate ({certificate.samples} samples)",
        ["", "worst>", "limit>", "", "where"],
        [
            (name, "-" if w.value is None else w.value, w.limit, "ok" if w.ok else "FAILS", place(w))
            for name, w in certificate.worst.items()
        ],
    )
    if certificate.worst["force_margin"].value is None:
        print("hold: kinematic - the plan closes the loops; no contact forces were planned or checked")
    for failure in certificate.failures:
        print(f"fails: {failure}")
