"""Runs the cases of a sweep on processes of this machine, or on a Dask cluster."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Callable, Generator, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING

from drake_hand.errors import DrakeHandError, InputError
from drake_hand.physics.runs import cores, undisturbed
from drake_hand.sweep.spec import Case
from drake_hand.sweep.store import Store
from drake_hand.sweep.work import CaseRow, Done, work

if TYPE_CHECKING:
    from distributed import Client, LocalCluster

_CASES_PER_WORKER = 2
"""Cases handed out per worker: one that it works on, and one that waits."""
_CASES_PER_START = 250
"""Cases per worker after which a process per core is started anew: each leaves a megabyte that Drake does not give back
(RobotLocomotion/drake#24529). Workers of a cluster are told how long they live when they are started."""
_MOST_DEATHS = 2
"""Workers that may die of a case before it is given up as ``crashed``."""


@dataclass(frozen=True)
class SweepProgress:
    """Where a sweep stands."""

    stage: str
    fraction: float
    certified: int = 0
    per_hour: float = 0.0
    left_s: float = 0.0


def run_sweep(
    cases: list[Case],
    store: Store,
    *,
    scheduler: str | None = None,
    progress: Callable[[SweepProgress], None] | None = None,
) -> None:
    """Does all cases that the store does not have.

    Args:
        cases: of the sweep.
        store: where their results go.
        scheduler: address of a Dask scheduler whose workers have drake_hand installed; else a process per core.
        progress: called after every case.

    Raises:
        InputError: there is no such scheduler, or Dask is not installed.
        DrakeHandError: the scheduler was lost; what was done until then is in the store.
    """
    todo = [case for case in cases if case.id not in store.rows]
    if not todo:
        return
    tell = progress or (lambda _: None)
    began, last = time.monotonic(), len(todo)
    with closing(_started_anew(scheduler, todo)) as results:
        for n, done in enumerate(results, start=1):
            store.add(done)
            rate = n / (time.monotonic() - began)
            tell(
                SweepProgress(
                    stage=f"{len(cases) - last + n} of {len(cases)} cases",
                    fraction=1 - (last - n) / len(cases),
                    certified=sum(r.status == "certified" for r in store.rows.values()),
                    per_hour=3600 * rate,
                    left_s=(last - n) / rate,
                )
            )


def _started_anew(scheduler: str | None, todo: list[Case]) -> Generator[Done]:
    """The results of the cases; processes of this machine live for so many of them."""
    block = len(todo) if scheduler else _CASES_PER_START * cores()
    for first in range(0, len(todo), block):
        with _client(scheduler) as client:
            yield from _results(client, todo[first : first + block])


def _results(client: Client, todo: list[Case]) -> Iterator[Done]:
    """The results of the cases as they finish; no more are handed out than keep every worker busy."""
    from distributed import as_completed

    waiting = iter(todo)
    futures = {}
    ahead = _CASES_PER_WORKER * max(1, len(client.scheduler_info(n_workers=-1)["workers"]))
    running = as_completed()

    def hand_out() -> None:
        case = next(waiting, None)
        if case is not None:
            future = client.submit(work, case, key=f"drake_hand-{case.id}", pure=False)
            futures[future.key] = case
            running.add(future)

    for _ in range(ahead):
        hand_out()
    for future in running:
        case = futures.pop(future.key)
        if future.status == "finished":
            yield future.result()
        elif future.status == "error":
            yield Done(row=CaseRow.of(case, status="crashed", reason=" ".join(str(future.exception()).split())))
        else:
            raise DrakeHandError("the scheduler is lost; run the sweep again to continue where it stopped")
        future.release()
        hand_out()


async def _kill(cluster: LocalCluster) -> None:
    """Ends the workers at once, and leaves none for the cluster to retire, which waits for them."""
    nannies = list(cluster.workers.values())
    cluster.worker_spec.clear()
    cluster.workers.clear()
    for nanny in nannies:
        nanny.auto_restart = False
    await asyncio.gather(*(nanny.close(timeout=0.1) for nanny in nannies))


@contextmanager
def _client(scheduler: str | None) -> Iterator[Client]:
    try:
        import dask
        from distributed import Client, LocalCluster
    except ImportError as e:
        raise InputError("sweeps need Dask", found="none", expected="pip install 'drake_hand[sweep]'") from e
    quiet = {
        "distributed.scheduler.allowed-failures": _MOST_DEATHS - 1,
        "distributed.comm.retry.count": 0,
        "distributed.admin.log-format": "%(message)s",
    }
    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # also while what was interrupted goes down
    with dask.config.set(quiet):
        if scheduler is None:
            with (
                LocalCluster(
                    n_workers=cores(),
                    threads_per_worker=1,
                    dashboard_address=None,
                    memory_limit=0,
                    silence_logs="CRITICAL",
                ) as cluster,
                Client(cluster) as client,
            ):
                try:
                    yield client
                except (KeyboardInterrupt, GeneratorExit):  # nobody waits for what the workers still do
                    with undisturbed():
                        cluster.sync(_kill, cluster)
                    raise
            return
        try:
            client = Client(scheduler, timeout=5)
        except (OSError, ValueError) as e:
            raise InputError(
                "no scheduler answers", key="--scheduler", found=scheduler, expected="tcp://host:port of one that runs"
            ) from e
        with client:
            yield client
