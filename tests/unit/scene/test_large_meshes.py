"""Large and broken meshes: within a time that does not grow with faces × facets, and with nothing left out.

What is outside is asked by the half-spaces of Qhull's hulls of Coal's own corners, and what is inside by rays, of
trimesh, so nothing is shared with what makes the pieces.
"""

import logging
import subprocess
import sys

import coal
import numpy as np
import pytest
import trimesh
from scipy.spatial import ConvexHull

from elastic_strips import decompose
from elastic_strips.errors import RobotError, SceneError
from elastic_strips.hulls import MOST_CORNERS, convex_shape, few_corners
from elastic_strips.scene import Mesh


def outside(points, mesh):
    """How far [m] each point lies outside of the union of a mesh's parts."""
    best = np.full(len(points), np.inf)
    for part in mesh.parts:
        equations = ConvexHull(np.asarray(part.geometry.points()).reshape(-1, 3) + part.center).equations
        best = np.minimum(best, (points @ equations[:, :3].T + equations[:, 3]).max(axis=1))
    return best


def points_of(source, count=400):
    """Points of the surface and of the inside of each closed body of a mesh."""
    surface, _ = trimesh.sample.sample_surface(source, count, seed=1)
    rng = np.random.default_rng(2)
    box = rng.uniform(*source.bounds, (count, 3))
    held = np.zeros(count, dtype=bool)
    for body in source.split(only_watertight=True):
        body.fix_normals()
        held |= body.contains(box)
    return np.vstack((surface, source.vertices[np.unique(source.faces)][:400], box[held]))


def torus(faces=2000):
    around = int(np.sqrt(faces))
    return trimesh.creation.torus(0.5, 0.15, major_sections=around, minor_sections=max(3, faces // 2 // around))


def l_profile():
    corners = [(0, 0), (1, 0), (1, 0.2), (0.2, 0.2), (0.2, 1), (0, 1)]
    vertices = np.array([(x, y, z) for z in (0.0, 0.3) for x, y in corners])
    bottom = [(0, 3, 1), (1, 3, 2), (0, 5, 3), (3, 5, 4)]
    faces = bottom + [tuple(i + 6 for i in abc[::-1]) for abc in bottom]
    for i in range(6):
        k = (i + 1) % 6
        faces += [(i, k, k + 6), (i, k + 6, i + 6)]
    return trimesh.Trimesh(vertices, faces, process=False)


def mixed_up():
    """Every other triangle is the wrong way round."""
    source = torus()
    faces = source.faces.copy()
    faces[::2] = faces[::2, ::-1]
    return trimesh.Trimesh(source.vertices, faces, process=False)


def inside_out():
    source = torus()
    source.invert()
    return source


def crossing():
    one, two = torus(), torus()
    two.apply_transform(trimesh.transformations.rotation_matrix(1.2, [1, 0, 0], [0.1, 0.2, 0]))
    return trimesh.util.concatenate([one, two])


def noisy():
    source = trimesh.creation.icosphere(3, radius=0.3)
    rng = np.random.default_rng(0)
    direction = source.vertices / 0.3
    size = (
        1.0 + 0.02 * rng.normal(size=len(direction)) + 0.3 * np.sin(5 * direction[:, 0]) * np.cos(4 * direction[:, 1])
    )
    source.vertices *= size[:, None]
    return source


def table_and_ring():
    bodies = [trimesh.creation.box((1, 0.6, 0.04)), trimesh.creation.annulus(0.1, 0.15, 0.4, sections=60)]
    bodies[1].apply_translation((0, 0, 0.22))
    for x in (-0.45, 0.45):
        leg = trimesh.creation.box((0.05, 0.05, 0.7))
        leg.apply_translation((x, 0.25, -0.37))
        bodies.append(leg)
    return trimesh.util.concatenate(bodies)


def screws(count=1500):
    """More bodies than are told apart."""
    rng = np.random.default_rng(0)
    box = trimesh.creation.box((1, 1, 1))
    vertices = box.vertices[None] * rng.uniform(0.005, 0.02, (count, 1, 3)) + rng.uniform(-1, 1, (count, 1, 3))
    faces = box.faces[None] + 8 * np.arange(count)[:, None, None]
    return trimesh.Trimesh(vertices.reshape(-1, 3), faces.reshape(-1, 3), process=False)


@pytest.mark.parametrize(
    "make", [torus, l_profile, mixed_up, inside_out, crossing, noisy, table_and_ring, screws], ids=lambda m: m.__name__
)
def test_no_point_of_the_surface_or_of_the_inside_is_outside_of_the_pieces(make):
    source = make()
    mesh = Mesh(source.vertices, source.faces)
    assert outside(points_of(source), mesh).max() <= decompose.SURFACE_TOLERANCE * source.scale
    assert len(mesh.parts) <= decompose.MANY_BODIES


def test_the_check_sees_a_piece_that_is_missing():
    """If this fails, the test above has become blind."""
    source = torus()
    mesh = Mesh(source.vertices, source.faces)
    copy = type("Parts", (), {"parts": mesh.parts[1:]})
    assert outside(points_of(source), copy).max() > 1e-3


def test_a_convex_body_of_20480_triangles_is_one_piece_that_holds_it_and_takes_little_memory():
    code = (
        "import resource, trimesh, elastic_strips as es\n"
        "m = trimesh.creation.icosphere(subdivisions=5, radius=0.3)\n"
        "before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss\n"
        "mesh = es.Mesh(m.vertices, m.faces)\n"
        "print(len(mesh.parts), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=300)
    parts, kilobytes = map(int, done.stdout.split())
    assert parts == 1
    assert kilobytes < 600_000


@pytest.mark.parametrize("inverted", [False, True])
def test_a_large_convex_body_sticks_out_little(inverted):
    source = trimesh.creation.icosphere(subdivisions=5, radius=0.3)
    if inverted:
        source.invert()
    mesh = Mesh(source.vertices, source.faces)
    assert len(mesh.parts) == 1
    assert mesh.parts[0].geometry.num_points <= MOST_CORNERS
    assert outside(source.vertices, mesh).max() <= 1e-9
    corners = np.asarray(mesh.parts[0].geometry.points()).reshape(-1, 3) + mesh.parts[0].center
    assert np.linalg.norm(corners, axis=1).max() < 0.3 * 1.01


def test_a_large_cylinder_keeps_its_flat_ends():
    source = trimesh.creation.cylinder(0.3, 0.5, sections=10_000)
    mesh = Mesh(source.vertices, source.faces)
    assert len(mesh.parts) == 1
    assert mesh.parts[0].half_extents[2] == pytest.approx(0.25, abs=1e-6)
    assert outside(source.vertices, mesh).max() <= 1e-9


def test_a_large_body_that_is_not_convex_is_held_too(brief):
    source = torus(20_000 if brief else 40_000)
    mesh = Mesh(source.vertices, source.faces)
    points, _ = trimesh.sample.sample_surface(source, 3000, seed=0)
    assert outside(points, mesh).max() <= decompose.SURFACE_TOLERANCE * source.scale
    assert outside(np.zeros((1, 3)), mesh)[0] > 0.2  # the hole
    assert max(part.geometry.num_points for part in mesh.parts) <= MOST_CORNERS


def test_a_thin_walled_bin_is_closed_and_yet_not_filled():
    outer, inner = trimesh.creation.box((1, 1, 1)), trimesh.creation.box((0.99, 0.99, 0.995))
    inner.apply_translation((0, 0, 0.0025))
    walls = [box.slice_plane([0, 0, 0.4], [0, 0, -1]) for box in (outer, inner)]
    rims = [[(s * x, t * x) for s, t in ((-1, -1), (1, -1), (1, 1), (-1, 1))] for x in (0.5, 0.495)]
    top = np.array([(x, y, 0.4) for rim in rims for x, y in rim])
    ring = [abc for i in range(4) for k in [(i + 1) % 4] for abc in ((i, k, 4 + k), (i, 4 + k, 4 + i))]
    source = trimesh.util.concatenate([walls[0], walls[1], trimesh.Trimesh(top, ring, process=False)])
    source.merge_vertices()
    mesh = Mesh(source.vertices, source.faces)
    assert outside(points_of(source), mesh).max() <= decompose.SURFACE_TOLERANCE * source.scale
    assert outside(np.array([[0.0, 0.0, 0.0], [0.2, -0.2, 0.2]]), mesh).min() > 0.05


def test_a_flat_body_of_many_triangles_becomes_plates():
    """Convex: one; else some for each cube of space, with the hole left free."""
    grid = np.stack(np.meshgrid(np.linspace(-1, 1, 41), np.linspace(-1, 1, 41)), axis=-1).reshape(-1, 2)
    index = np.arange(41 * 41).reshape(41, 41)
    a, b, c, d = (index[i : 40 + i, k : 40 + k].ravel() for i, k in ((0, 0), (0, 1), (1, 1), (1, 0)))
    faces = np.vstack((np.column_stack((a, b, c)), np.column_stack((a, c, d))))
    points = np.column_stack((grid, np.zeros(len(grid))))
    whole = Mesh(points, faces)
    assert len(whole.parts) == 1
    assert outside(points, whole).max() <= 1e-9
    middle = np.linalg.norm(points[faces].mean(axis=1), axis=1)
    holed = trimesh.Trimesh(points, faces[middle > 0.4], process=False)
    mesh = Mesh(holed.vertices, holed.faces)
    samples, _ = trimesh.sample.sample_surface(holed, 2000, seed=0)
    assert outside(samples, mesh).max() <= 1e-7
    assert outside(np.zeros((1, 3)), mesh)[0] > 0.1


@pytest.mark.parametrize("spoil", ["duplicates", "no area", "unused", "twice"])
def test_broken_meshes_are_held(spoil):
    source = torus(800)
    vertices, faces = np.array(source.vertices), np.array(source.faces)
    if spoil == "duplicates":  # as in STL files
        vertices, faces = vertices[faces].reshape(-1, 3), np.arange(3 * len(faces)).reshape(-1, 3)
    elif spoil == "no area":
        faces = np.vstack((faces, [[0, 0, 1], [5, 5, 5], [0, 1, 0]]))
    elif spoil == "unused":
        vertices = np.vstack((vertices, [[50.0, 0, 0]]))
    else:
        faces = np.vstack((faces, faces[:40]))
    mesh = Mesh(vertices, faces)
    assert outside(points_of(source), mesh).max() <= decompose.SURFACE_TOLERANCE * source.scale
    assert outside(np.zeros((1, 3)), mesh)[0] > 0.2
    assert max(np.abs(part.center).max() for part in mesh.parts) < 2.0


def test_a_body_with_a_wall_inside_is_solid():
    """Three triangles share each edge of the wall."""
    source = torus()
    outer = trimesh.creation.icosphere(3, radius=0.1).apply_scale((1, 1, 3))
    assert source.is_watertight
    ring = np.argsort(np.arctan2(*outer.vertices[np.abs(outer.vertices[:, 2]) < 1e-9][:, :2].T))
    rim = np.flatnonzero(np.abs(outer.vertices[:, 2]) < 1e-9)[ring]
    wall = np.column_stack((np.full(len(rim) - 2, rim[0]), rim[1:-1], rim[2:]))
    bent = np.array(outer.vertices)
    bent[:, 0] += 3.0 * bent[:, 2] ** 2  # not convex
    solid = trimesh.Trimesh(bent, outer.faces, process=False)
    mesh = Mesh(bent, np.vstack((outer.faces, wall)))
    assert outside(points_of(solid), mesh).max() <= decompose.SURFACE_TOLERANCE * source.scale


def test_a_spike_without_an_area_is_a_bar(caplog):
    source = trimesh.creation.box((1, 1, 1))
    vertices = np.vstack((source.vertices, [[2.0, 0.5, 0.5]]))
    tip = int(np.argmax(np.all(source.vertices == 0.5, axis=1)))
    with caplog.at_level(logging.WARNING):
        mesh = Mesh(vertices, np.vstack((source.faces, [[tip, 8, 8]])))
    spike = np.linspace([0.5, 0.5, 0.5], [2.0, 0.5, 0.5], 20)
    assert outside(spike, mesh).max() <= 1e-9
    assert caplog.records


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_vertices_that_are_not_finite_are_refused(value):
    source = torus()
    vertices = np.array(source.vertices)
    vertices[7, 1] = value
    with pytest.raises(SceneError):
        Mesh(vertices, source.faces)


def test_more_triangles_than_are_accepted_are_refused():
    count = decompose._MAX_FACES + 1
    with pytest.raises(SceneError, match=str(count)):
        Mesh(np.eye(3), np.tile([[0, 1, 2]], (count, 1)))


def bodies(rng):
    round_ = rng.normal(size=(12_000, 3))
    round_ /= np.linalg.norm(round_, axis=1)[:, None]
    angle = np.linspace(0, 2 * np.pi, 5000, endpoint=False)
    rim = np.column_stack((np.cos(angle), np.sin(angle), 0 * angle))
    corner = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T * (0.3, 0.2, 0.1)
    return {
        "ball": 0.3 * round_,
        "far ball": 0.3 * round_ + (100, 50, 0),
        "crumb": 1e-3 * round_,
        "needle": round_ * (1.0, 0.01, 0.02),
        "coin": np.vstack((0.5 * rim, 0.5 * rim + (0, 0, 1e-3))),
        "cone": np.vstack((0.3 * rim, [[0, 0, 0.8]])),
        "rounded box": (0.02 * round_[:1500, None] + corner).reshape(-1, 3),
    }


@pytest.mark.parametrize("name", bodies(np.random.default_rng(0)))
@pytest.mark.parametrize("most", [300, MOST_CORNERS])
def test_a_hull_of_few_corners_holds_the_points_and_sticks_out_as_said(name, most, rng):
    points = bodies(rng)[name]
    few, sticks_out = few_corners(points, name, SceneError, most=most)
    assert len(few) <= most
    size = np.linalg.norm(np.ptp(points, axis=0))
    equations = ConvexHull(few).equations
    for rows in np.array_split(points, 20):
        assert (rows @ equations[:, :3].T + equations[:, 3]).max() <= 1e-12 * max(1.0, np.abs(points).max())
    directions = rng.normal(size=(300, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    more = (directions @ few.T).max(axis=1) - (directions @ points.T).max(axis=1)
    assert more.max() <= sticks_out + 1e-9
    assert sticks_out <= 0.05 * size + 2e-5


def test_few_corners_leave_small_hulls_alone(rng):
    inside = rng.uniform(-0.2, 0.2, (20_000, 3))
    corners = rng.normal(size=(200, 3))
    few, sticks_out = few_corners(np.vstack((inside, corners)), "cloud", SceneError)
    assert sticks_out == 0.0
    assert ConvexHull(few).volume == pytest.approx(ConvexHull(corners).volume, rel=1e-9)


def test_a_shape_of_very_many_corners_is_quick_and_no_nearer_than_said(rng):
    points = 0.3 * (lambda p: p / np.linalg.norm(p, axis=1)[:, None])(rng.normal(size=(8000, 3)))
    shape, corners = convex_shape(points, "ball", RobotError)
    assert len(corners) <= MOST_CORNERS
    result = coal.DistanceResult()
    away = coal.Transform3s(np.eye(3), np.array([1.0, 0.0, 0.0]))
    coal.distance(shape, coal.Transform3s.Identity(), coal.Sphere(0.1), away, coal.DistanceRequest(), result)
    assert 0.595 < result.min_distance <= 1.0 - 0.1 - points[:, 0].max() + 1e-6


def test_progress_is_said_in_the_log(monkeypatch, caplog):
    from elastic_strips import progress

    monkeypatch.setattr(progress, "PROGRESS_PERIOD", -1.0)
    source = table_and_ring()
    decompose._cache.clear()
    with caplog.at_level(logging.INFO, logger=progress.LOGGER):
        Mesh(source.vertices + 0.5, source.faces)
    assert caplog.records
    assert {record.name for record in caplog.records if "bodies" in record.getMessage()} == {progress.LOGGER}
