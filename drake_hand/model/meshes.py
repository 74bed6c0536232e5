"""Mesh files: found from the URIs people write, read, converted to what Drake reads."""

from __future__ import annotations

import logging
import os
import tempfile
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from drake_hand.errors import InputError
from drake_hand.files import sha256, write_atomic

if TYPE_CHECKING:
    import trimesh

DRAKE_READS = (".obj", ".gltf", ".vtk")

_MOST_ENTRIES = 20_000
"""Files and folders looked at for a mesh that is not where it should be."""


def find_mesh(uri: str, file: Path, *, key: str) -> Path:
    """The file that a mesh URI (``package://``, ``file://``, relative or absolute) of a model file means.

    Args:
        uri: as written in the model file.
        file: the model file; ``package://`` is looked for in its folder and all above, nothing is downloaded.
        key: where in the model file, for the error.

    Raises:
        InputError: there is no such file.
    """
    scheme, _, rest = uri.rpartition("://")
    inside = Path(rest)
    if scheme in ("package", "model") and len(inside.parts) > 1:
        # the package's folder may bear another name than the package
        tails = [inside, inside.relative_to(inside.parts[0])]
        candidates = [folder / tail for folder in file.resolve().parents for tail in tails]
    else:
        candidates = [file.resolve().parent / inside]
    for path in candidates:
        if path.is_file():
            return path
    near = _of_that_name(inside.name, file)
    where = "a file in or above the folder of the model" if scheme else str(candidates[0])
    if near:
        where += f"; of that name there is {', '.join(near)}"
    raise InputError("mesh file is missing", file=file, key=key, found=uri or "no file name", expected=where)


def _of_that_name(name: str, file: Path) -> list[str]:
    """Up to three files of a name near a model file, in its folder or that above, relative to the model's."""
    folder, found, looked = file.resolve().parent, [], 0
    for base, folders, files in os.walk(folder.parent):
        folders.sort()
        looked += len(files) + len(folders)
        if name and name in files:
            found.append(os.path.relpath(Path(base) / name, folder))
        if looked > _MOST_ENTRIES or len(found) == 3:
            break
    return found


def read_mesh(file: Path) -> trimesh.Trimesh:
    """Reads any mesh format, all its parts in one mesh.

    Raises:
        InputError: unreadable, empty, or with coordinates that are not finite.
    """
    import trimesh

    logging.getLogger("trimesh").addHandler(logging.NullHandler())  # it logs tracebacks of what it then reads otherwise
    try:
        mesh = trimesh.load_mesh(file)
    except Exception as e:  # each of trimesh's readers raises errors of its own
        found = " ".join(str(e).split()) or type(e).__name__
        raise InputError("cannot read mesh", file=file, found=found, expected="a mesh file") from e
    if len(mesh.faces) == 0 or not np.isfinite(mesh.vertices).all():
        raise InputError("mesh has no shape", file=file, found=f"{len(mesh.faces)} faces", expected="finite triangles")
    if mesh.vertices.shape[1] != 3:
        found = f"{mesh.vertices.shape[1]} coordinates per vertex"
        raise InputError("mesh has no shape", file=file, found=found, expected="3 coordinates per vertex")
    return mesh


@lru_cache(maxsize=64)
def hull(file: Path, scale: tuple[float, float, float]) -> tuple[tuple[np.ndarray, np.ndarray]]:
    """The convex hull of a mesh file, which is what Drake takes a hand's link for.

    Returns:
        ((V, 3) vertices, (F, 3) outward faces), in the mesh's frame, scaled; the only piece.

    Raises:
        InputError: as :func:`read_mesh`, or if the mesh is flat.
    """
    mesh = read_mesh(file).apply_scale(scale)
    try:
        whole = mesh.convex_hull
    except Exception as e:  # qhull: it is flat
        raise InputError("mesh is flat", file=file, found=mesh.extents, expected="a solid") from e
    return ((np.asarray(whole.vertices), np.asarray(whole.faces)),)


def cache_dir(kind: str) -> Path:
    """A folder of the user's cache, or of the machine's temporary files where that cannot be written."""
    try:
        base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
        folder = base / "drake_hand" / kind
        folder.mkdir(parents=True, exist_ok=True)
        if os.access(folder, os.W_OK):
            return folder
    except (OSError, RuntimeError):  # no home, or none that may be written
        pass
    folder = Path(tempfile.gettempdir()) / f"drake_hand-{os.getuid()}" / kind
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def to_drake(file: Path) -> Path:
    """A mesh file that Drake reads: the file itself, or its conversion to OBJ in the user's cache.

    Raises:
        InputError: as :func:`read_mesh`.
    """
    if file.suffix.lower() in DRAKE_READS:
        return file
    target = cache_dir("meshes") / f"{file.stem}-{sha256(file)[:16]}.obj"
    if not target.is_file():
        write_obj(file, target)
    return target


def write_obj(file: Path, target: Path) -> None:
    """Converts any mesh file to OBJ with normals, without materials.

    Raises:
        InputError: as :func:`read_mesh`.
    """
    from trimesh.exchange.obj import export_obj

    text = export_obj(read_mesh(file), include_normals=True, include_color=False, include_texture=False)
    target.parent.mkdir(parents=True, exist_ok=True)
    write_atomic(target, text)
