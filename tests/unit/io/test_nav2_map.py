"""Nav2 maps: which cells become boxes and where, both kinds of PGM, PNG, the three modes, what is refused."""

from __future__ import annotations

import logging
import math

import numpy as np
import pytest
from cases import each, refused
from shared_data import shared_data

from elastic_strips.errors import ScenarioError
from elastic_strips.io import load_nav2_map
from elastic_strips.io.nav2_map import WALL_HEIGHT
from elastic_strips.scene import Scene

image = pytest.importorskip("PIL.Image")
YAML = """image: map.pgm
mode: trinary
resolution: 0.5
origin: [1.0, -2.0, 0]
negate: 0
occupied_thresh: 0.65
free_thresh: 0.25
"""
PIXELS = np.array([[0, 254, 254], [254, 205, 254], [254, 254, 100], [254, 254, 10]], dtype=np.uint8)
"""4 rows of 3 pixels, the uppermost first; 205 (p = 0.196) is free, 100 (p = 0.61) unknown, 0 and 10 occupied."""


def write(folder, pixels=PIXELS, text=YAML, comment=b"# made\n", kind=b"P5"):
    """A map file with its image; returns its path."""
    rows, columns = pixels.shape
    head = kind + b"\n" + comment + f"{columns} {rows}\n255\n".encode()
    body = pixels.tobytes() if kind == b"P5" else " ".join(map(str, pixels.ravel())).encode()
    (folder / "map.pgm").write_bytes(head + body)
    path = folder / "map.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def covered(scene: Scene, point) -> bool:
    """Whether a world point lies in one of the scene's boxes."""
    for part, R, t in zip(scene.table.parts, scene.table.rotation, scene.table.translation, strict=True):
        local = R.T @ (np.asarray(point) - t)
        if part.geometry is not None and (np.abs(local) <= np.asarray(part.geometry.halfSide) + 1e-12).all():
            return True
        if any((np.abs(local - at) <= np.asarray(box.halfSide) + 1e-12).all() for box, at in part.boxes):
            return True
    return False


def cells(scene: Scene, yaw=0.0) -> set[tuple[int, int]]:
    """(column, row from below) of the cells of the 3 × 4 grid whose middle is covered."""
    c, s = math.cos(yaw), math.sin(yaw)
    found = set()
    for i in range(3):
        for j in range(4):
            x, y = (i + 0.5) * 0.5, (j + 0.5) * 0.5
            if covered(scene, (1.0 + c * x - s * y, -2.0 + s * x + c * y, 0.99)):
                found.add((i, j))
    return found


@each("kind", [b"P5", b"P2"])
@each("comment", [b"", b"# one\n# two # three\n"])
def test_occupied_cells_are_boxes_where_the_map_says(tmp_path, kind, comment):
    """The image's last row is the lowest, the origin is the lower left corner, boxes stand on the floor."""
    scene = load_nav2_map(write(tmp_path, kind=kind, comment=comment))
    assert scene.names[0] == "map"
    assert cells(scene) == {(0, 3), (2, 0)}
    assert not covered(scene, (1.25, -0.25, -0.01))
    scene = Scene([scene.obstacle("map")])
    low = (scene.table.center - scene.table.half_extents).min(axis=0)
    high = (scene.table.center + scene.table.half_extents).max(axis=0)
    np.testing.assert_allclose([low, high], [[1.0, -2.0, 0.0], [2.5, 0.0, WALL_HEIGHT]], atol=1e-12)


def test_the_outside_of_a_map_is_not_free(tmp_path):
    """Whatever leaves the rectangle at any side, at any height of the walls, meets something; unless it is said."""
    for yaw in (0.0, 0.7, -2.0):
        path = write(tmp_path, text=YAML.replace("-2.0, 0]", f"-2.0, {yaw}]"))
        scene = load_nav2_map(path, height=2.0, low=-0.5)
        c, s = math.cos(yaw), math.sin(yaw)
        for x, y in [(-0.01, 1.0), (1.51, 1.0), (0.7, -0.01), (0.7, 2.01), (-0.5, -0.5), (2.0, 2.5), (-1, 3), (3, -1)]:
            for z in (-0.49, 0.3, 1.99):
                assert covered(scene, (1.0 + c * x - s * y, -2.0 + s * x + c * y, z)), (yaw, x, y, z)
        inside = [(x, y) for x in (0.01, 0.7, 1.49) for y in (0.01, 1.0, 1.99)]
        edges = Scene([o for o in scene if o.name != "map"])
        assert not any(covered(edges, (1.0 + c * x - s * y, -2.0 + s * x + c * y, 0.3)) for x, y in inside)
        assert load_nav2_map(path, outside="free").names == ("map",)
    with refused(ScenarioError, "outside='open'"):
        load_nav2_map(path, outside="open")


def test_walls_are_between_two_heights(tmp_path):
    scene = load_nav2_map(write(tmp_path), low=0.4, height=1.2, outside="free")
    assert [covered(scene, (1.25, -0.25, z)) for z in (0.39, 0.41, 1.19, 1.21)] == [False, True, True, False]
    with refused(ScenarioError, "Voxels size"):
        load_nav2_map(write(tmp_path), low=1.0, height=1.0)


@each("turns", [1, -2, 40])
def test_a_yaw_of_more_than_a_turn_is_taken_and_said(tmp_path, caplog, turns):
    yaw = 0.7 + 2.0 * math.pi * turns
    with caplog.at_level(logging.WARNING):
        scene = load_nav2_map(write(tmp_path, text=YAML.replace("-2.0, 0]", f"-2.0, {yaw!r}]")))
    assert cells(scene, 0.7) == {(0, 3), (2, 0)}
    assert "degrees" in caplog.text


HEADERS = [
    b"P5\r\n# made\r\n3 4\r\n255\r\n", b"P5\r3 4\r255\r", b"P5 3 4 255\r\n", b"P5\n3 4\n255# made\n",
    b"P5\n#a\r#b\n3 4\n255\n", b"P5\n3 4\n255 # made\n", b"P5 3 # three\n4\t255 ",
]  # fmt: skip


@each("head", HEADERS)
@each("after", [b"", b"\n"])
def test_headers_with_other_ends_of_lines_do_not_shift_the_pixels(tmp_path, head, after):
    if after and head in (b"P5 3 4 255\r\n", b"P5\n3 4\n255 # made\n"):
        pytest.skip("it cannot be told what the bytes are")
    path = write(tmp_path)
    for first in (0, 10, 13, 35):  # pixels that are ends of lines, or begin a comment
        pixels = PIXELS.copy()
        pixels[0, 0] = first
        (tmp_path / "map.pgm").write_bytes(head + pixels.tobytes() + after)
        assert cells(load_nav2_map(path)) == {(0, 3), (2, 0)}
        (tmp_path / "map.pgm").write_bytes(head.replace(b"P5", b"P2") + " ".join(map(str, pixels.ravel())).encode())
        assert cells(load_nav2_map(path)) == {(0, 3), (2, 0)}


def test_unknown_cells_and_height(tmp_path):
    scene = load_nav2_map(write(tmp_path), unknown="occupied", height=2.0)
    assert cells(scene) == {(0, 3), (2, 0), (2, 1)}
    assert covered(scene, (1.25, -0.25, 1.99))


def test_a_turned_and_negated_map(tmp_path):
    text = YAML.replace("-2.0, 0]", "-2.0, 0.7]").replace("negate: 0", "negate: 1")
    assert cells(load_nav2_map(write(tmp_path, 255 - PIXELS, text)), 0.7) == {(0, 3), (2, 0)}


def test_a_map_of_free_cells_is_an_empty_scene(tmp_path):
    path = write(tmp_path, np.full((4, 3), 254, dtype=np.uint8))
    assert len(load_nav2_map(path, outside="free")) == 0
    assert "map" not in load_nav2_map(path).names


BAD_YAML = [
    (YAML.replace("image: map.pgm\n", ""), "the key 'image' is missing"),
    (
        YAML.replace("map.pgm", "gone.pgm"),
        r"map\.yaml:1: image: .*gone\.pgm: cannot read the map's image: No such file",
    ),
    (YAML.replace("map.pgm", "map.yaml"), r"map\.yaml: .* PGM"),
    (YAML.replace("trinary", "scaled"), r"map\.yaml:2: mode: unknown value 'scaled'; did you mean 'scale'"),
    (YAML.replace("0.5\n", "0\n"), r"map\.yaml:3: resolution: 0 must be"),
    (YAML.replace(", 0]", "]"), "origin: must be a list of 3 numbers"),
    (YAML.replace("negate: 0", "negate: 2"), r"negate: is 2, outside \[0, 1\]"),
    (YAML.replace("0.25", "0.9"), r"map\.yaml:7: free_thresh: is 0.9; it must not exceed 'occupied_thresh', 0.65"),
    (YAML.replace("negate: 0", "negate: maybe"), "negate: must be an integer"),
]


@each("text, message", BAD_YAML)
def test_a_wrong_map_names_file_line_and_key(tmp_path, text, message):
    with pytest.raises(ScenarioError, match=message):
        load_nav2_map(write(tmp_path, text=text))


BAD_IMAGES = [
    (b"", "PGM"),
    (b"P6\n3 4\n255\n" + bytes(36), "PGM"),
    (b"P5\n3 4\n255\n" + bytes(11), r"has 11 pixels; 3 × 4 = 12 are needed"),
    (b"P2\n3 4\n255\n" + b"1 2 x", "a number"),
    (b"P2\n1 2\n255\n" + b"1 300", "beyond its largest value, 255"),
    (b"P5\n3 four\n255\n" + bytes(12), "header is damaged"),
    (b"P5\n3 # 4", "header is damaged"),
    (b"P5\n0 4\n255\n", "0 × 4 pixels up to 255 are not read"),
    (b"P5\n999999 999999\n255\n", "are not read"),
    (b"P5\n3 4\n99999\n", "are not read"),
]


@each("image, message", BAD_IMAGES)
def test_a_wrong_image_is_refused(tmp_path, image, message):
    path = write(tmp_path)
    (tmp_path / "map.pgm").write_bytes(image)
    with pytest.raises(ScenarioError, match=message):
        load_nav2_map(path)


def test_sixteen_bit_images(tmp_path):
    path = write(tmp_path)
    wide = (PIXELS.astype(">u2") * 257).astype(">u2")
    (tmp_path / "map.pgm").write_bytes(b"P5 3 4 65535\n" + wide.tobytes())
    assert cells(load_nav2_map(path)) == {(0, 3), (2, 0)}


def write_png(folder, pixels, text=YAML):
    write(folder)
    image.fromarray(np.asarray(pixels)).save(folder / "map.png")
    (folder / "map.yaml").write_text(text.replace("map.pgm", "map.png"), encoding="utf-8")
    return folder / "map.yaml"


@each(
    "pixels",
    [PIXELS, np.dstack([PIXELS] * 3), np.dstack([*[PIXELS] * 3, np.full_like(PIXELS, 255)])[:, :, [0, 1, 2]],
     PIXELS.astype(np.uint16) * 257],
    ids=["grey", "colour", "opaque", "16 bits"],
)  # fmt: skip
def test_a_png_has_the_cells_of_its_pgm(tmp_path, pixels):
    assert cells(load_nav2_map(write_png(tmp_path, pixels))) == {(0, 3), (2, 0)}


def test_opacity_counts_as_in_nav2(tmp_path):
    """What is not opaque is unknown; in mode trinary it is occupied where it was for older versions, which took opacity
    for one more colour: black is then p = 1 where it is clear, and 0.75 where it is opaque."""
    opacity = np.full_like(PIXELS, 255)
    opacity[3, 2], opacity[0, 0] = 254, 0
    path = write_png(tmp_path, np.dstack([PIXELS, PIXELS, PIXELS, opacity]))
    assert cells(load_nav2_map(path)) == {(0, 3), (2, 0)}
    path = write_png(tmp_path, np.dstack([PIXELS, PIXELS, PIXELS, opacity]), YAML.replace("0.65", "0.8"))
    assert cells(load_nav2_map(path)) == {(0, 3)}
    assert cells(load_nav2_map(path, unknown="occupied")) >= {(0, 3), (2, 0)}
    solid = np.dstack([PIXELS, PIXELS, PIXELS, np.full_like(PIXELS, 255)])
    assert cells(load_nav2_map(write_png(tmp_path, solid, YAML.replace("0.65", "0.8")))) == {(0, 3), (2, 0)}
    path = write_png(tmp_path, np.dstack([PIXELS, PIXELS, PIXELS, opacity]), YAML.replace("trinary", "scale"))
    assert cells(load_nav2_map(path)) == set()
    assert cells(load_nav2_map(path, unknown="occupied")) == {(0, 3), (2, 0)}


def test_a_threshold_belongs_to_what_it_bounds(tmp_path):
    """100 is p = 155 / 255 exactly; so it is occupied, or free."""
    text = YAML.replace("0.65", repr(1.0 - 100 / 255))
    assert cells(load_nav2_map(write(tmp_path, text=text))) == {(0, 3), (2, 0), (2, 1)}
    text = YAML.replace("0.25", repr(1.0 - 100 / 255))
    assert cells(load_nav2_map(write(tmp_path, text=text), unknown="occupied")) == {(0, 3), (2, 0)}


def test_what_map_servers_take_is_taken(tmp_path, caplog):
    """negate as a word, keys that nobody knows: the second are named in the log."""
    text = YAML.replace("negate: 0", "negate: true") + "maker: me\n"
    with caplog.at_level(logging.WARNING):
        assert cells(load_nav2_map(write(tmp_path, 255 - PIXELS, text))) == {(0, 3), (2, 0)}
    assert "left out: the keys 'maker'" in caplog.text


def test_scale_and_raw_maps_have_occupancies_between(tmp_path, caplog):
    """205 is p = 0.196, free; 100 is p = 0.608 and so (0.608 − 0.25) / 0.4 = 89 %."""
    path = write(tmp_path, text=YAML.replace("trinary", "scale"))
    with caplog.at_level(logging.WARNING):
        assert cells(load_nav2_map(path)) == {(0, 3), (2, 0)}
    assert "left out: 1 cell" in caplog.text
    assert cells(load_nav2_map(path, lethal=90)) == {(0, 3), (2, 0)}
    assert cells(load_nav2_map(path, lethal=89)) == {(0, 3), (2, 0), (2, 1)}
    path = write(tmp_path, text=YAML.replace("trinary", "raw"))
    caplog.clear()
    with caplog.at_level(logging.WARNING):
        assert cells(load_nav2_map(path)) == {(2, 1)}  # 100; 205 and 254 are unknown, 0 is free, 10 nearly
    assert "left out: 9 cells that are unknown, 1 cell" in caplog.text
    assert cells(load_nav2_map(path, lethal=10)) == {(2, 1), (2, 0)}


def test_a_damaged_png_is_refused(tmp_path):
    path = write_png(tmp_path, PIXELS)
    sound = (tmp_path / "map.png").read_bytes()
    for data in (sound[:-30], sound[:30], sound.replace(b"IDAT", b"IDAX"), b"\x89PNG" + bytes(50)):
        (tmp_path / "map.png").write_bytes(data)
        with refused(ScenarioError, "map.png:"):
            load_nav2_map(path)
    image.new("L", (5000, 5000)).save(tmp_path / "map.png")
    with refused(ScenarioError, "5000", "16000000"):
        load_nav2_map(path)


def test_wrong_arguments_and_missing_files(tmp_path):
    with refused(ScenarioError, "unknown='wall'"):
        load_nav2_map(write(tmp_path), unknown="wall")
    with refused(ScenarioError, "Voxels size"):
        load_nav2_map(write(tmp_path), height=0.0)
    with refused(ScenarioError, "lethal=0"):
        load_nav2_map(write(tmp_path), lethal=0)
    with refused(ScenarioError, "gone.yaml:"):
        load_nav2_map(tmp_path / "gone.yaml")


@pytest.mark.parametrize("name", ["nav2_depot", "nav2_warehouse"])
def test_the_true_maps_load(name):
    """Few boxes for many cells, and every occupied cell is covered."""
    scene = load_nav2_map(shared_data("nav2_maps", f"{name}.yaml"))
    obstacle = scene.obstacle("map")
    centers = obstacle.spec["centers"]
    boxes = sum(len(part.boxes) for part in obstacle.parts)
    assert boxes < 0.4 * len(centers)
    rng = np.random.default_rng(0)
    for at in centers[rng.choice(len(centers), 20, replace=False)]:
        assert covered(scene, obstacle.pose[:3, :3] @ at + obstacle.pose[:3, 3])
