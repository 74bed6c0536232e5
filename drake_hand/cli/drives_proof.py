"""The certificate of a plan, computed again in a process with Drake: this one stays without, for the bus's sake."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from pathlib import Path

import msgspec

_CHILD = "import sys; from drake_hand.cli import run; sys.exit(run(['check', sys.argv[1], '--json']))"


def prove(plan: Path) -> list[str]:
    """Proves a plan file again; why it may not be played, one line each, empty when it holds."""
    if importlib.util.find_spec("pydrake") is None:
        return [
            "the plan cannot be certified again: Drake is not installed (--trust relies on the certificate in the file)"
        ]
    child = subprocess.run([sys.executable, "-c", _CHILD, str(plan)], capture_output=True, text=True)
    try:
        answer = msgspec.json.decode(child.stdout)
        holds = answer.get("certified") is True
    except (msgspec.DecodeError, AttributeError):
        last = (child.stderr.strip().splitlines() or ["no answer"])[-1]
        return [f"the plan could not be certified again: {last}"]
    if holds and child.returncode == 0:
        return []
    said = answer.get("failures") or [answer.get("reason", f"exit status {child.returncode}")]
    return ["checked again, the plan is not certified: " + "; ".join(map(str, said))]
