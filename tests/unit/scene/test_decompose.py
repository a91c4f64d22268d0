"""Meshes: the pieces hold the surface, do not stick out far, and are made once; files that are broken say so."""

import logging

import numpy as np
import pytest
import trimesh
from cases import each, refused
from scipy.spatial import ConvexHull as Qhull

from elastic_strips import decompose
from elastic_strips.errors import SceneError
from elastic_strips.scene import Mesh


def outside(points, pieces):
    """How far [m] each point lies outside of the union of the hulls (negative: inside)."""
    best = np.full(len(points), np.inf)
    for piece in pieces:
        equations = Qhull(piece).equations
        best = np.minimum(best, (points @ equations[:, :3].T + equations[:, 3]).max(axis=1))
    return best


def piece_vertices(mesh):
    """Hull vertices of the parts as Coal has them, in the mesh's frame."""
    return [np.array([p.geometry.point(i) for i in range(p.geometry.num_points)]) + p.center for p in mesh.parts]


def surface(mesh, count=3000):
    points, _ = trimesh.sample.sample_surface(mesh, count, seed=0)
    return np.vstack([points, mesh.vertices])


def gap_mesh():
    """A ring with a hole: the hole must stay free."""
    return trimesh.creation.annulus(0.5, 1.0, 0.3)


def open_bucket():
    mesh = trimesh.creation.annulus(0.4, 0.5, 0.6, sections=12)
    mesh.update_faces(np.arange(len(mesh.faces)) % 17 != 3)  # not watertight
    return mesh


@pytest.mark.parametrize(
    "make", [gap_mesh, lambda: trimesh.creation.torus(1.0, 0.3, major_sections=16, minor_sections=8), open_bucket]
)
def test_pieces_hold_the_surface_and_stick_out_little(make):
    source = make()
    mesh = Mesh(source.vertices, source.faces)
    pieces = piece_vertices(mesh)
    assert len(pieces) > 1
    size = np.linalg.norm(source.extents)
    assert outside(surface(source), pieces).max() <= decompose.SURFACE_TOLERANCE * size
    corners = np.vstack(pieces)
    _, far, _ = trimesh.proximity.closest_point(source, corners)
    assert far[outside_of(source, corners)].max(initial=0.0) < 0.05 * size


def outside_of(source, points):
    return ~source.contains(points) if source.is_watertight else np.ones(len(points), dtype=bool)


@each("most", [4, 16])
@each("make", [gap_mesh, open_bucket])
def test_few_pieces_hold_all_bodies_of_a_mesh(make, most):
    source = trimesh.util.concatenate([make(), trimesh.creation.box((0.1, 0.2, 0.1)).apply_translation((0, 0, 1.0))])
    pieces = decompose.few_pieces(source.vertices, source.faces, most)
    assert 1 < len(pieces) <= most
    points = np.vstack((surface(source), [[0.0, 0.0, 1.0]]))
    assert outside(points, pieces).max() <= decompose.SURFACE_TOLERANCE * np.linalg.norm(source.extents)


def test_a_mesh_with_a_lone_bar_is_its_hull():
    """A triangle without an area is no part of a body, but something may touch it."""
    ring = gap_mesh()
    corners = np.vstack((ring.vertices, [[0.0, 0.0, 3.0], [0.0, 0.0, 4.0]]))
    n = len(ring.vertices)
    pieces = decompose.few_pieces(corners, np.vstack((ring.faces, [[n, n + 1, n + 1]])), 4)
    assert outside(corners, pieces).max() <= decompose.SURFACE_TOLERANCE * 4.0


def test_bare_vhacd_would_cut_corners():
    """The reason why pieces grow; if this fails, growing has become pointless."""
    source = gap_mesh()
    bare = [
        p["vertices"] for p in trimesh.decomposition.convex_decomposition(source, resolution=50_000, maxConvexHulls=32)
    ]
    assert outside(surface(source), bare).max() > 1e-3


def test_the_hole_of_a_ring_stays_free():
    source = gap_mesh()
    pieces = piece_vertices(Mesh(source.vertices, source.faces))
    rng = np.random.default_rng(0)
    inner = rng.uniform(-0.3, 0.3, (500, 3)) * (1, 1, 0.5)
    assert outside(inner, pieces).min() > 0.05
    angle = rng.uniform(0, 2 * np.pi, 500)
    solid = np.column_stack([0.75 * np.cos(angle), 0.75 * np.sin(angle), rng.uniform(-0.1, 0.1, 500)])
    assert (outside(solid, pieces) < 0).mean() > 0.99


@pytest.mark.parametrize("make", [lambda: trimesh.creation.box((1, 2, 3)), lambda: trimesh.creation.icosphere(2)])
def test_a_convex_mesh_is_one_exact_hull(make):
    source = make()
    mesh = Mesh(source.vertices, source.faces)
    assert len(mesh.parts) == 1
    assert mesh.parts[0].geometry.num_points == len(source.vertices)


def test_each_body_of_a_table_is_its_own_exact_piece():
    bodies = [trimesh.creation.box((1, 0.6, 0.05))]
    for x in (-0.4, 0.4):
        for y in (-0.2, 0.2):
            leg = trimesh.creation.box((0.05, 0.05, 0.7))
            leg.apply_translation((x, y, -0.4))
            bodies.append(leg)
    source = trimesh.util.concatenate(bodies)
    mesh = Mesh(source.vertices, source.faces)
    assert len(mesh.parts) == 5
    assert sum(Qhull(p).volume for p in piece_vertices(mesh)) == pytest.approx(0.03 + 4 * 0.05**2 * 0.7)


def test_a_convex_mesh_without_shared_vertices_is_one_hull():
    """STL files repeat every vertex."""
    source = trimesh.creation.box((1, 1, 1))
    soup = source.vertices[source.faces].reshape(-1, 3)
    assert len(Mesh(soup, np.arange(len(soup)).reshape(-1, 3)).parts) == 1


def test_an_open_box_is_not_filled():
    source = trimesh.creation.box((1, 1, 1))
    source.update_faces(source.face_normals[:, 2] < 0.5)  # no lid
    pieces = piece_vertices(Mesh(source.vertices, source.faces))
    assert outside(surface(source), pieces).max() < 1e-6
    assert outside(np.array([[0, 0, 0.0], [0.1, 0.1, 0.3]]), pieces).min() > 0.1


def test_a_flat_mesh_becomes_a_thin_plate():
    mesh = Mesh([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]])
    assert len(mesh.parts) == 2
    assert max(p.half_extents[2] for p in mesh.parts) == pytest.approx(decompose.PLATE_REACH)


def test_decomposition_is_deterministic_and_done_once(monkeypatch, caplog):
    source = trimesh.creation.annulus(0.3, 0.5, 0.2, sections=16)
    first = decompose.convex_pieces(source.vertices, source.faces)
    assert decompose.convex_pieces(source.vertices.copy(), source.faces.copy()) is first
    decompose._cache.clear()
    with caplog.at_level(logging.DEBUG, logger="elastic_strips.decompose"):
        again = decompose.convex_pieces(source.vertices, source.faces)
    assert "pieces" in caplog.text
    assert again is not first
    assert len(again) == len(first)
    assert all(np.array_equal(a, b) for a, b in zip(again, first, strict=True))


@each("suffix", ["stl", "obj", "ply", "dae"])
def test_mesh_files_are_read(tmp_path, suffix):
    path = tmp_path / f"box.{suffix}"
    trimesh.creation.box((100, 200, 300)).export(path)
    mesh = Mesh.from_file(path, scale=0.01, at=(0, 0, 1), name="crate")
    assert mesh.name == "crate"
    assert len(mesh.parts) == 1
    np.testing.assert_allclose(mesh.parts[0].half_extents, (0.5, 1.0, 1.5), rtol=1e-6)


def broken(tmp_path):
    good = tmp_path / "good.stl"
    trimesh.creation.box((1, 1, 1)).export(good)
    (tmp_path / "cut.stl").write_bytes(good.read_bytes()[:200])
    (tmp_path / "empty.stl").write_bytes(b"")
    (tmp_path / "text.stl").write_text("hello, this is no mesh at all " * 10)
    (tmp_path / "noise.ply").write_bytes(bytes(range(256)) * 4)
    (tmp_path / "noise.dae").write_text("<xml>nothing</xml>")
    (tmp_path / "points.obj").write_text("v 0 0 0\nv 1 0 0\n")
    (tmp_path / "nan.obj").write_text("v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    (tmp_path / "index.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n")
    (tmp_path / "flat.step").write_text("x")
    (tmp_path / "folder.stl").mkdir()
    return ["missing.stl", "cut.stl", "empty.stl", "text.stl", "noise.ply", "noise.dae", "points.obj", "nan.obj",
            "index.obj", "flat.step", "folder.stl"]  # fmt: skip


def test_broken_mesh_files_raise_a_scene_error_with_the_path(tmp_path):
    for name in broken(tmp_path):
        with pytest.raises(SceneError) as caught:
            Mesh.from_file(tmp_path / name)
        assert str(tmp_path / name) in str(caught.value), name


def test_bad_scale_is_refused(tmp_path):
    path = tmp_path / "box.stl"
    trimesh.creation.box((1, 1, 1)).export(path)
    for scale in (0, -1, float("nan"), True, "2"):
        with refused(SceneError, "Mesh", "scale"):
            Mesh.from_file(path, scale=scale)
