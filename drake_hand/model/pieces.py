"""`cut`: a concave body in convex pieces, by CoACD in a process of its own, where it may crash or never end."""

from __future__ import annotations

import resource
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from drake_hand.errors import InputError

CPU_S = 20
"""Processor time that CoACD may take."""
WRAP_CELLS = 30
"""Cells along an open body in the grid in which it is wrapped."""
Pieces = list[tuple[np.ndarray, np.ndarray]]
"""(V, 3) vertices and (F, 3) faces of each."""


def cut(vertices: np.ndarray, faces: np.ndarray, *, closed: bool, concavity: float, file: Path) -> Pieces:
    """Cuts a body into convex pieces (Wei et al., "Approximate convex decomposition ...", 2022).

    Args:
        vertices: (V, 3) of the body, m.
        faces: (F, 3) triangles.
        closed: whether they enclose it; else it is wrapped first.
        concavity: CoACD's threshold: the smaller, the more pieces.
        file: the body is from, for the error.

    Raises:
        InputError: CoACD crashes or takes too long.
    """
    with tempfile.TemporaryDirectory() as folder:
        body, pieces = Path(folder) / "body.npz", Path(folder) / "pieces.npz"
        np.savez(body, vertices=vertices, faces=faces)
        asked = [str(concavity), "off" if closed else "on", str(CPU_S)]
        command: list[str | Path] = [sys.executable, "-m", __name__, body, pieces, *asked]
        done = subprocess.run(command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        if done.returncode:
            raise InputError(
                "mesh cannot be cut into convex pieces",
                file=file,
                found=_end(done.returncode),
                expected="a closed surface that does not cross itself, or convex parts",
            )
        with np.load(pieces) as data:
            return [(data[f"v{i}"], data[f"f{i}"]) for i in range(len(data.files) // 2)]


def _end(status: int) -> str:
    if status in (-signal.SIGXCPU, -signal.SIGKILL):
        return f"CoACD did not finish in {CPU_S} s of processor time"
    return f"CoACD crashed ({signal.Signals(-status).name if status < 0 else f'exit status {status}'})"


def _child(body: str, pieces: str, concavity: str, wrap: str, cpu_s: str) -> None:
    resource.setrlimit(resource.RLIMIT_CPU, (int(cpu_s), int(cpu_s) + 1))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    import coacd

    coacd.set_log_level("error")
    with np.load(body) as data:
        mesh = coacd.Mesh(data["vertices"], data["faces"])
    found = coacd.run_coacd(
        mesh,
        threshold=float(concavity),
        preprocess_mode=wrap,
        preprocess_resolution=WRAP_CELLS,
        resolution=1000,
        mcts_nodes=10,
        mcts_iterations=40,
        mcts_max_depth=2,
        seed=0,
    )
    arrays = {f"{key}{i}": a for i, piece in enumerate(found) for key, a in zip("vf", piece, strict=True)}
    np.savez(pieces, **arrays)


if __name__ == "__main__":
    _child(*sys.argv[1:])
