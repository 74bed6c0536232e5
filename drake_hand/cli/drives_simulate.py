"""``drake-hand drives simulate``: simulated drives on a bus, until interrupted."""

from __future__ import annotations

import signal
import sys
import threading
from pathlib import Path
from typing import Annotated

import numpy as np
from cyclopts import Parameter
from cyclopts.validators import Number

from drake_hand.epos.drives import Drives
from drake_hand.epos.master import open_bus
from drake_hand.epos.sim.drives import SimulatedDrives
from drake_hand.epos.sim.faults import FaultsFile
from drake_hand.epos.sim.process import serve, standard_input
from drake_hand.plans.plan import Plan


def simulate(
    *,
    drives: str = "kanguera",
    interface: str = "udp_multicast",
    channel: str | None = None,
    at: Path | None = None,
    no_zero: bool = False,
    log: Path | None = None,
    faults: Path | None = None,
    settings: Path | None = None,
    seed: Annotated[int, Parameter(validator=Number(gte=0))] = 0,
) -> int:
    """Serve simulated drives on a bus, until Ctrl-C.

    Faults can be injected while it runs: each line of JSON on standard input is one fault, such as
    `{"kind": "emcy", "joint": "index_pip", "code": 8976}`; `{"kind": "clear", "joint": "all"}` ends all lasting faults.

    ```console
    $ drake-hand drives simulate --at spin.plan.json
    $ drake-hand execute spin.plan.json --drives kanguera --interface udp_multicast
    ```

    Args:
        drives: a bundled name (kanguera) or a drives file.
        interface: python-can interface.
        channel: its channel; of udp_multicast 239.74.163.2:43113 unless given.
        at: plan at whose first point the motors start; without it, they start at encoder count 0.
        no_zero: as if just switched on: the encoders count from where they are, until `drives zero`.
        log: file for the timeline of status words and positions (JSON lines).
        faults: schedule of faults (YAML).
        settings: JSON file that keeps the parameters stored in the drives, across restarts.
        seed: of everything random.
    """
    found = Drives.load(drives)
    schedule = FaultsFile.load(faults, found) if faults else None
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    with (
        open_bus(found.bus, interface, channel) as bus,
        SimulatedDrives(
            bus, found, q=_first(at, found), zeroed=not no_zero, log=log, faults=schedule, seed=seed, settings=settings
        ) as simulated,
    ):
        where = " ".join(f"{k} {v}" for k, v in found.bus.arguments(interface, channel).items())
        print(f"{len(found.drives)} simulated drives on {where}; Ctrl-C ends", file=sys.stderr, flush=True)
        serve(simulated, standard_input(), stop, until_eof=False)
    return 0


def _first(plan: Path | None, drives: Drives) -> np.ndarray | None:
    """(n,) first waypoint of a plan, with its offset, as commanded."""
    if plan is None:
        return None
    found = Plan.load(plan)
    part = found.parts[0]
    q = np.array(part.q[0]) + (np.array(part.q_offset[0]) if part.q_offset else 0.0)
    return q[drives.columns(found.joints)]
