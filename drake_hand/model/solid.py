"""`Solid`: a mesh file as convex pieces: put right, cut where it is not convex, simplified where it is dense.

What the pieces miss or add is measured, and said.
"""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from drake_hand.errors import InputError
from drake_hand.files import sha256, write_atomic
from drake_hand.model.meshes import cache_dir, read_mesh
from drake_hand.model.pieces import WRAP_CELLS, cut

if TYPE_CHECKING:
    import trimesh

SURFACE_ERROR_M, SURFACE_ERROR_SHARE = 1.0e-3, 0.02
"""Largest surface error that pieces may have: m, or share of the mesh's size, whichever is more."""
_FINE_M, _FINE_SHARE = 1.0e-4, 0.003
"""The same of a mesh that is only simplified."""
_CONVEX_SHARE = 1.0e-5
"""Share of its volume by which a body's hull may be larger for the body to be convex."""
_FLAT_SHARE = 1.0e-6
"""Volume of a hull, in cubes of the mesh's size, below which there is no solid."""
_DENSE_FACES = 300
"""Faces of a convex piece above which it is simplified; more where that is not good enough."""
_SAMPLES = 1000
"""Points at which the error is measured."""
_SEAM_M = 2.0e-4
"""m; pieces this near one another have no surface between them that a fingertip could touch."""
_DENSE_INPUT_FACES = 600
"""Faces of a concave body above which it is simplified before it is cut."""
_CONCAVITY_THRESHOLDS = (0.05, 0.03, 0.02)
"""CoACD's threshold, until the error is small enough."""
_VERSION = "3"
"""Of how meshes are decomposed, for the cache."""


@dataclass(frozen=True, kw_only=True)
class Solid:
    """A mesh as a union of convex pieces, in the mesh's frame, scaled."""

    pieces: tuple[tuple[np.ndarray, np.ndarray], ...]
    """(V, 3) vertices and (F, 3) outward faces of each."""
    notes: tuple[str, ...]
    """What was put right, cut or simplified, with figures."""


def read_solid(file: Path, scale: tuple[float, float, float]) -> Solid:
    """Reads a mesh file as convex pieces; what took long is kept in the user's cache.

    Raises:
        InputError: as `read_mesh`, or a flat mesh, or one that cannot be cut well enough.
    """
    key = f"{file.stem}-{sha256(file)[:16]}-{'x'.join(f'{s:g}' for s in scale)}-{_VERSION}.npz"
    kept = cache_dir("solids") / key
    if kept.is_file():
        with np.load(kept) as data:
            n = int(data["n"])
            pieces = tuple((data[f"v{i}"], data[f"f{i}"]) for i in range(n))
            return Solid(pieces=pieces, notes=tuple(str(note) for note in data["notes"]))
    with np.errstate(all="ignore"):  # trimesh divides by volumes that may be none
        solid = _cut(read_mesh(file).apply_scale(scale), file)
    if solid.notes:
        _keep(solid, kept)
    return solid


def _keep(solid: Solid, file: Path) -> None:
    arrays: dict[str, Any] = {"n": len(solid.pieces), "notes": np.array(solid.notes)}
    for i, (vertices, faces) in enumerate(solid.pieces):
        arrays |= {f"v{i}": vertices, f"f{i}": faces}
    data = io.BytesIO()
    np.savez_compressed(data, **arrays)
    write_atomic(file, data.getvalue())


def _cut(mesh: trimesh.Trimesh, file: Path) -> Solid:
    mesh.merge_vertices(merge_tex=True, merge_norm=True)
    size = float(mesh.extents.max())
    notes: list[str] = []
    bodies = _sound(mesh, notes)
    hulls: list[trimesh.Trimesh] = []
    error = 0.0
    for body in bodies:
        found, cut_off = _convex(body, file, size)
        fewer = [_simple(h, size) for h in found]
        hulls += [h for h, _ in fewer]
        error = max(error, cut_off + max(lost for _, lost in fewer))
    if error > 0:
        volume, whole = sum(h.volume for h in hulls), sum(b.volume for b in bodies)
        what = (
            f"{len(hulls)} convex pieces" if len(hulls) > 1 else f"{len(mesh.faces)} faces became {len(hulls[0].faces)}"
        )
        notes.append(
            f"mesh {file.name}: {what}, volume {volume / whole - 1:+.1%}, largest surface error {error * 1e3:.2f} mm"
        )
    allowed = max(SURFACE_ERROR_M, SURFACE_ERROR_SHARE * size)
    if error > allowed:
        raise InputError(
            "mesh cannot be cut into convex pieces well enough",
            file=file,
            found=f"{len(hulls)} pieces, {error * 1e3:.2f} mm off",
            expected=f"at most {allowed * 1e3:.2f} mm; close its surface, or give convex parts",
        )
    return Solid(pieces=tuple((np.asarray(h.vertices), np.asarray(h.faces)) for h in hulls), notes=tuple(notes))


def _sound(mesh: trimesh.Trimesh, notes: list[str]) -> list[trimesh.Trimesh]:
    """The separate bodies of a mesh, closed and with their faces outward where that can be done."""
    import trimesh

    bodies, turned = [], 0
    closed = bool((np.bincount(mesh.edges_unique_inverse) > 1).all())
    for body in _split(mesh):
        trimesh.repair.fill_holes(body)
        if body.is_watertight and body.volume < 0:
            body.invert()
            turned += 1
        bodies.append(body)
    if turned:
        notes.append(f"mesh: {turned} of {len(bodies)} bodies were inside out, and were turned")
    if not closed:
        left = sum(not body.is_watertight for body in bodies)
        rest = (
            f"; {left} of {len(bodies)} bodies are still open, and are closed by their hulls or by wrapping"
            if left
            else ""
        )
        notes.append(f"mesh: its surface was open; holes were filled{rest}")
    return bodies


def _split(mesh: trimesh.Trimesh) -> list[trimesh.Trimesh]:
    """The separate bodies of a mesh, also of one in which more than two faces meet at an edge: where bodies touch.

    What is open once the closed bodies are taken out is put together again.
    """
    import trimesh

    bodies: list[trimesh.Trimesh] = list(mesh.split(only_watertight=False))
    left = [body for body in bodies if not body.is_watertight]
    if not 1 < len(left) < len(bodies):
        return bodies
    rest: Any = trimesh.util.concatenate(left)
    rest.merge_vertices()
    return [body for body in bodies if body.is_watertight] + list(rest.split(only_watertight=False))


def _convex(body: trimesh.Trimesh, file: Path, size: float) -> tuple[list[trimesh.Trimesh], float]:
    """Convex pieces of one body, and their surface error, m: its hull, where that is the body."""
    try:
        hull = body.convex_hull
    except Exception as e:  # qhull: it is flat
        raise InputError("mesh is flat", file=file, found=body.extents, expected="a solid") from e
    if hull.volume < _FLAT_SHARE * size**3:
        raise InputError("mesh is flat", file=file, found=body.extents, expected="a solid")
    if body.is_watertight and hull.volume < body.volume * (1 + _CONVEX_SHARE):
        return [hull], 0.0
    off = _error(body, [hull])
    if off <= SURFACE_ERROR_M / 2:
        return [hull], off
    if not body.is_watertight and not _encloses(body):  # its wrapping would be a shell, in hundreds of pieces
        raise InputError(
            "mesh is torn open",
            file=file,
            found=f"{len(body.faces)} faces with holes too large to be filled; their hull is {off * 1e3:.2f} mm off",
            expected="a surface that encloses the solid",
        )
    return _decompose(body, file, size)


def _decompose(body: trimesh.Trimesh, file: Path, size: float) -> tuple[list[trimesh.Trimesh], float]:
    """Convex pieces of a concave body and their error, as fine as it takes."""
    import trimesh

    coarse = _fewer(body.vertices, body.faces, _DENSE_INPUT_FACES) if len(body.faces) > _DENSE_INPUT_FACES else body
    best: tuple[float, list[trimesh.Trimesh]] | None = None
    for concavity in _CONCAVITY_THRESHOLDS:
        found = cut(
            np.asarray(coarse.vertices),
            np.asarray(coarse.faces),
            closed=coarse.is_watertight,
            concavity=concavity,
            file=file,
        )
        hulls = [trimesh.convex.convex_hull(vertices) for vertices, _ in found]
        error = _error(body, hulls)
        if best is None or error < best[0]:
            best = error, hulls
        if error <= max(SURFACE_ERROR_M, SURFACE_ERROR_SHARE * size):
            break
    assert best is not None, "there are concavities to try"
    return best[1], best[0]


def _encloses(body: trimesh.Trimesh) -> bool:
    """Whether an open body has an inside: grid cells that its surface shuts off; the grid closes small holes."""
    from scipy.ndimage import binary_fill_holes

    surface = np.pad(body.voxelized(float(body.extents.max()) / WRAP_CELLS).matrix, 1)
    return bool(binary_fill_holes(surface).sum() > surface.sum())


def _fewer(vertices: np.ndarray, faces: np.ndarray, count: int) -> trimesh.Trimesh:
    """A mesh with about so many faces (quadric decimation)."""
    import fast_simplification
    import trimesh

    points, triangles = fast_simplification.simplify(
        np.asarray(vertices, dtype=np.float32), np.asarray(faces, dtype=np.int32), target_count=count
    )
    return trimesh.Trimesh(points.astype(float), triangles)


def _simple(hull: trimesh.Trimesh, size: float) -> tuple[trimesh.Trimesh, float]:
    """A convex piece with fewer faces, where they are many, and how far its surface is off, m."""
    import trimesh

    fewer, lost = hull, 0.0
    for target in (_DENSE_FACES, 2 * _DENSE_FACES, 4 * _DENSE_FACES):
        if len(hull.faces) <= target:
            return hull, 0.0
        corners = np.unique((np.asarray(hull.vertices) @ _directions(target // 2).T).argmax(axis=0))
        fewer = trimesh.convex.convex_hull(hull.vertices[corners])
        lost = _beyond(hull.vertices, fewer)
        if lost <= max(_FINE_M, _FINE_SHARE * size):
            break
    return fewer, lost


def _directions(n: int) -> np.ndarray:
    """(n, 3) unit vectors spread evenly (a Fibonacci lattice)."""
    k = np.arange(n) + 0.5
    z, phi = 1 - 2 * k / n, np.pi * (1 + 5**0.5) * k
    s = np.sqrt(1 - z * z)
    return np.column_stack([s * np.cos(phi), s * np.sin(phi), z])


def _beyond(points: np.ndarray, hull: trimesh.Trimesh) -> float:
    """How far the farthest of some points is above the faces of a convex mesh, m."""
    normals = np.asarray(hull.face_normals)
    offset = np.einsum("fi,fi->f", np.asarray(hull.triangles)[:, 0], normals)
    return max(float((block @ normals.T - offset).max()) for block in np.array_split(points, len(points) // 2000 + 1))


def _error(mesh: trimesh.Trimesh, hulls: list[trimesh.Trimesh]) -> float:
    """Largest distance between the surface of a mesh and that of the union of convex pieces, m, in both directions."""
    import trimesh

    union = trimesh.util.concatenate(hulls)
    outside = [_outside(hull, [h for h in hulls if h is not hull]) for hull in hulls]
    added = trimesh.proximity.closest_point(mesh, np.concatenate(outside))[1].max()
    points = trimesh.sample.sample_surface(mesh, _SAMPLES, seed=0)[0]
    for hull in hulls:
        points = points[~_contains(hull, points)]
    missed = trimesh.proximity.closest_point(union, points)[1].max() if len(points) else 0.0
    return float(max(added, missed))


def _outside(hull: trimesh.Trimesh, others: list[trimesh.Trimesh]) -> np.ndarray:
    """(N, 3) points on the surface of a piece that no other piece covers or adjoins."""
    import trimesh

    share = max(200, _SAMPLES // (len(others) + 1))
    points, faces = trimesh.sample.sample_surface(hull, share, seed=0)
    above = points + _SEAM_M * hull.face_normals[faces]
    for other in others:
        free = ~_contains(other, above)
        points, above = points[free], above[free]
    return points


def _contains(hull: trimesh.Trimesh, points: np.ndarray) -> np.ndarray:
    """(N,) whether points (N, 3) are in a convex mesh."""
    normals = np.asarray(hull.face_normals)
    offset = np.einsum("fi,fi->f", np.asarray(hull.triangles)[:, 0], normals)
    return (points @ normals.T - offset).max(axis=1) <= 0
