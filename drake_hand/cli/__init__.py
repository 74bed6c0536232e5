"""The command line, thin: parse, call, print. Command modules load only when their command runs."""

from __future__ import annotations

import sys

from cyclopts import App

from drake_hand import __version__
from drake_hand.errors import DrakeHandError

app = App(name="drake-hand", version=__version__, help="Plan, prove, show and play finger gaits of dexterous hands.")

for name, target in {
    "plan": "drake_hand.cli.plans:plan",
    "check": "drake_hand.cli.plans:check",
    "show": "drake_hand.cli.plans:show",
    "plot": "drake_hand.cli.plans:plot",
    "simulate": "drake_hand.cli.plans:simulate",
    "demo": "drake_hand.cli.demo:demo",
    "modes": "drake_hand.cli.modes:modes",
    "hand": "drake_hand.cli.hand:app",
    "bench": "drake_hand.cli.bench:bench",
    "execute": "drake_hand.cli.drives:execute",
    "drives": "drake_hand.cli.drives:app",
    "mirror": "drake_hand.cli.drives:mirror",
}.items():
    app.command(target, name=name)


def main() -> None:
    """Entry point: runs a command; errors become one message on stderr and the exit status of their kind."""
    try:
        result = app()
    except DrakeHandError as e:
        print(f"drake-hand: {e}", file=sys.stderr)
        sys.exit(e.exit_status)
    except KeyboardInterrupt:
        print("drake-hand: interrupted", file=sys.stderr)
        sys.exit(130)
    sys.exit(result if isinstance(result, int) else 0)
