"""``workshop carve``: no surface of a small furnished room is called free, and where carving is wrong it says so."""

from __future__ import annotations

import numpy as np
import pytest

from elastic_strips.errors import ParameterError
from elastic_strips.native import twin
from elastic_strips.perception import volume_twin
from elastic_strips.scene import ConvexHull, Scene
from workshop.bench.carve import Setting, bench_cloud, measure_setting, surface_voxels

CORNERS = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])


def _box(size: tuple[float, float, float], at: tuple[float, float, float]) -> np.ndarray:
    return CORNERS * size + at


PIECES = [
    _box((7.0, 7.0, 0.1), (1.0, 0.0, -0.05)),  # the floor
    _box((0.1, 6.0, 2.4), (2.63, 0.0, 1.2)),
    _box((6.0, 0.1, 2.4), (0.0, 2.17, 1.2)),
    _box((0.9, 1.4, 0.04), (1.72, -0.31, 0.737)),
    *(_box((0.05, 0.05, 0.7), (1.72 + x, -0.31 + y, 0.35)) for x in (-0.4, 0.4) for y in (-0.6, 0.6)),
    *(_box((0.3, 1.0, 0.03), (2.43, -0.4, z)) for z in (1.1, 1.43, 1.79)),
    _box((0.42, 0.42, 0.05), (1.06, 0.93, 0.46)),
    *(_box((0.04, 0.04, 0.44), (1.06 + x, 0.93 + y, 0.22)) for x in (-0.18, 0.18) for y in (-0.18, 0.18)),
    _box((0.04, 0.04, 1.9), (1.23, 0.41, 0.95)) @ np.array([[0.96, 0.28, 0.0], [-0.28, 0.96, 0.0], [0.0, 0.0, 1.0]]),
]
PLACES = np.array([[0.0, 0.0, 0.1], [0.3, -0.6, 0.5]])


@pytest.fixture(scope="module")
def surface() -> np.ndarray:
    return surface_voxels(PIECES, 0.025)


def test_the_voxels_of_a_surface_are_those_that_it_crosses(surface):
    low, high = surface - 0.0125, surface + 0.0125
    table = PIECES[3]
    touch = ((high >= table.min(axis=0)) & (low <= table.max(axis=0))).all(axis=1)
    assert touch.sum() >= 36 * 56  # its top
    outside = np.ones(len(surface), dtype=bool)
    for piece in PIECES:
        outside &= ((low > piece.max(axis=0) + 1e-9) | (high < piece.min(axis=0) - 1e-9)).any(axis=1)
    assert not outside.any()


@pytest.mark.parametrize("noise", ["exact", "default", "worst"])
def test_no_surface_is_called_free(looking_tiago, surface, noise, brief):
    scene = Scene([ConvexHull(piece) for piece in PIECES])
    found = measure_setting(
        looking_tiago, scene, surface, PLACES[: 1 if brief else 2], Setting(160, 120, noise), seed=1
    )
    assert found["called_free"] == 0, found["where"]
    assert found["looked_at"] > 1000
    assert found["reach_free"] > 2000


def test_carving_by_the_pixel_over_the_middle_is_found_out(looking_tiago, surface, monkeypatch):
    cover = volume_twin._Sight.cover

    def middle_alone(sight, c, radius):
        columns, rows, near, far, known = cover(sight, c, radius)
        middles = [np.repeat(span.mean(axis=1, keepdims=True), 2, axis=1) for span in (columns, rows)]
        return *middles, near, far, known

    monkeypatch.setattr(volume_twin._Sight, "cover", middle_alone)
    scene = Scene([ConvexHull(piece) for piece in PIECES])
    with twin():
        found = measure_setting(looking_tiago, scene, surface, PLACES[:1], Setting(80, 60, "exact"), seed=1)
    assert found["called_free"] > 10


def test_of_a_recorded_image_what_is_held_out_is_not_free_and_what_is_before_it_is(tmp_path):
    v, u = np.mgrid[:480, :640]
    z = np.where((abs(u - 300) < 60) & (v > 200), 1.2, 2.6).astype("<f4")
    points = np.stack(((u - 319.5) * z / 525.0, (v - 239.5) * z / 525.0, z), axis=-1).astype("<f4")
    lines = ["VERSION .7", "FIELDS x y z", "SIZE 4 4 4", "TYPE F F F", "COUNT 1 1 1", "WIDTH 640", "HEIGHT 480"]
    head = "\n".join([*lines, "VIEWPOINT 0 0 0 1 0 0 0", "POINTS 307200", "DATA binary", ""])
    cloud = tmp_path / "wall.pcd"
    cloud.write_bytes(head.encode() + points.tobytes())
    bands = bench_cloud([cloud], draws=2)["held_out"]["every second column"]
    assert all(band["free"] == 0 for band in bands.values())
    assert bands["1-1.5 m"]["points"] > 30_000
    assert bands["2-3 m"]["before"] > 0.3 * bands["2-3 m"]["points"]
    with pytest.raises(ParameterError):
        bench_cloud([cloud], focal=400.0)
