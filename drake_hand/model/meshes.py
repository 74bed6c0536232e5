"""Mesh files: found from the URIs people write, cut into convex pieces, converted to what Drake reads."""

from __future__ import annotations

import logging
import os
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from drake_hand.errors import InputError
from drake_hand.files import sha256, write_atomic

if TYPE_CHECKING:
    import trimesh

DRAKE_READS = (".obj", ".gltf", ".vtk")
_CONVEX = 0.95
"""Least share of its convex hull that a piece fills to be taken for convex."""


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
    where = "a file in or above the folder of the model" if scheme else str(candidates[0])
    raise InputError("mesh file is missing", file=file, key=key, found=uri or "no file name", expected=where)


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
    return mesh


def convex_parts(file: Path, scale: tuple[float, float, float]) -> list[tuple[np.ndarray, np.ndarray]]:
    """Convex pieces of a mesh file: its separate pieces if each is convex, else one hull around all.

    Returns:
        (V, 3) vertices and (F, 3) outward faces of each piece, in the mesh's frame, scaled.

    Raises:
        InputError: as :func:`read_mesh`, or if the mesh is flat.
    """
    mesh = read_mesh(file).apply_scale(scale)
    mesh.merge_vertices(merge_tex=True, merge_norm=True)
    pieces = mesh.split(only_watertight=False)
    try:
        hulls = [piece.convex_hull for piece in pieces]
        if not all(piece.volume > _CONVEX * hull.volume for piece, hull in zip(pieces, hulls, strict=True)):
            hulls = [mesh.convex_hull]
    except Exception:  # qhull: a piece is flat
        try:
            hulls = [mesh.convex_hull]
        except Exception as e:
            raise InputError("mesh is flat", file=file, found=mesh.extents, expected="a solid") from e
    return [(np.asarray(h.vertices), np.asarray(h.faces)) for h in hulls]


def to_drake(file: Path) -> Path:
    """A mesh file that Drake reads: the file itself, or its conversion to OBJ in the user's cache.

    Raises:
        InputError: as :func:`read_mesh`.
    """
    if file.suffix.lower() in DRAKE_READS:
        return file
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "drake_hand" / "meshes"
    target = cache / f"{file.stem}-{sha256(file)[:16]}.obj"
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
