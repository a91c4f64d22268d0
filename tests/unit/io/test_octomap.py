"""OctoMap's files: cells by a recursive writer and Coal's octree, both formats, unknown space, what is damaged."""

from __future__ import annotations

import logging
import math
import struct

import coal
import numpy as np
import pytest
from cases import each, refused

import elastic_strips as es
from elastic_strips.errors import ParameterError, SceneError
from elastic_strips.io import read_octomap

LEVELS = 16


def grow(leaves: dict[tuple[int, int, int, int], float]) -> dict:
    """A tree of leaves: (depth, x, y, z of the key at that depth) → log-odds; a node is a dict or a number."""
    root: dict = {}
    for (depth, *key), value in leaves.items():
        node = root
        for level in range(depth - 1, -1, -1):
            child = sum((k >> level & 1) << axis for axis, k in enumerate(key))
            if level:
                node = node.setdefault(child, {})
            else:
                node[child] = value
    return root


def count(node: dict | float) -> int:
    return 1 + (sum(count(child) for child in node.values()) if isinstance(node, dict) else 0)


def bt(node: dict) -> bytes:
    def bits(child):
        return 0 if child is None else 3 if isinstance(child, dict) else 2 if child >= 0.0 else 1

    word = sum(bits(node.get(k)) << 2 * k for k in range(8))
    return struct.pack("<H", word) + b"".join(bt(node[k]) for k in range(8) if isinstance(node.get(k), dict))


def ot(node: dict | float, colour: bytes = b"") -> bytes:
    if not isinstance(node, dict):
        return struct.pack("<f", node) + colour + b"\0"
    mask = sum(1 << k for k in node)
    return struct.pack("<f", 0.1) + colour + bytes([mask]) + b"".join(ot(node[k], colour) for k in sorted(node))


def octree_file(leaves: dict, resolution: float, *, binary: bool, colour: bytes = b"") -> bytes:
    tree = grow(leaves)
    kind = "ColorOcTree" if colour else "OcTree"
    what = "OcTree binary file" if binary else "OcTree file"
    head = f"# Octomap {what}\n# made\n#\nid {kind}\nsize {count(tree)}\nres {resolution}\ndata\n"
    return head.encode() + (bt(tree) if binary else ot(tree, colour))


def some_leaves(seed: int = 1) -> tuple[dict, np.ndarray]:
    """Leaves at the finest level around the origin, two thirds of them occupied, and the keys of the occupied ones."""
    rng = np.random.default_rng(seed)
    keys = np.unique(rng.integers(-6, 6, (150, 3)), axis=0)
    values = np.where(rng.random(len(keys)) < 0.66, 0.85, -0.4)
    leaves = {(LEVELS, *(k + 2 ** (LEVELS - 1) for k in key)): v for key, v in zip(keys.tolist(), values, strict=True)}
    return leaves, keys[values > 0]


def covered(scene: es.Scene) -> set[tuple[int, int, int]]:
    return {tuple(np.floor(c / 0.1).astype(int).tolist()) for o in scene for c in o.spec["centers"]}


@pytest.mark.parametrize("binary", [True, False])
def test_the_occupied_cells_come_back_and_no_others(tmp_path, binary):
    leaves, keys = some_leaves()
    file = tmp_path / ("m.bt" if binary else "m.ot")
    file.write_bytes(octree_file(leaves, 0.1, binary=binary))
    scene = es.read_scene(file)
    assert scene.names == ("octomap",)
    assert covered(scene) == set(map(tuple, keys.tolist()))


def test_cells_are_where_coal_has_them(tmp_path):
    """Octomap's own code, which is in Coal, puts the same points into the same cells."""
    leaves, keys = some_leaves(2)
    file = tmp_path / "m.bt"
    file.write_bytes(octree_file(leaves, 0.1, binary=True))
    tree = coal.makeOctree((keys + 0.5) * 0.1, 0.1)
    boxes = np.array([list(box) for box in tree.toBoxes()])[:, :3]
    theirs = {tuple(np.floor(box / 0.1).astype(int).tolist()) for box in boxes}
    assert covered(read_octomap(file)) == theirs


@each(
    ("binary", "kind"),
    [(True, "ColorOcTree"), (True, "OcTreeStamped"), (True, "1"), (False, "OcTreeStamped"), (False, "1")],
)
def test_the_kinds_of_trees_that_octomap_writes(tmp_path, binary, kind):
    """A ``.bt`` file holds the same of every kind; stamps are in no file; 1 is an OcTree of the first versions."""
    leaves, keys = some_leaves(3)
    file = tmp_path / "m"
    file.write_bytes(octree_file(leaves, 0.1, binary=binary).replace(b"id OcTree", b"id " + kind.encode()))
    assert covered(read_octomap(file)) == set(map(tuple, keys.tolist()))


def test_a_large_leaf_is_an_obstacle_of_its_own_size(tmp_path, caplog):
    half = 2 ** (LEVELS - 1)
    leaves = {(LEVELS - 2, half // 4, half // 4, half // 4): 2.0, (LEVELS, half - 1, half, half): 2.0}
    file = tmp_path / "m.ot"
    file.write_bytes(octree_file(leaves, 0.1, binary=False))
    with caplog.at_level(logging.WARNING):
        scene = read_octomap(file)
    assert scene.names == ("octomap-0.1", "octomap-0.4")
    np.testing.assert_allclose(scene.obstacle("octomap-0.4").spec["centers"], [[0.2, 0.2, 0.2]])
    np.testing.assert_allclose(scene.obstacle("octomap-0.1").spec["centers"], [[-0.05, 0.05, 0.05]])
    assert f"{0.5 * 0.4 * 0.4 - 0.4**3 - 0.1**3:.3g} m³ of unknown space" in caplog.text  # of the box around both


def test_what_counts_as_occupied_is_chosen(tmp_path, caplog):
    half = 2 ** (LEVELS - 1)
    leaves = {(LEVELS, half + k, half, half): math.log(p / (1 - p)) for k, p in enumerate((0.3, 0.6, 0.9))}
    file = tmp_path / "m.ot"
    file.write_bytes(octree_file(leaves, 0.1, binary=False, colour=b"rgb"))
    with caplog.at_level(logging.WARNING):
        assert [len(covered(read_octomap(file, occupied=p))) for p in (0.2, 0.5, 0.8)] == [3, 2, 1]
    assert "unknown" not in caplog.text  # the three fill their box
    assert "3 colours" in caplog.text
    with refused(SceneError, "occupied"):
        read_octomap(file, occupied=0.95)
    with refused(ParameterError, "occupied=1"):
        read_octomap(file, occupied=1.0)


def test_the_floor_is_left_out_and_said(tmp_path, caplog):
    leaves, keys = some_leaves()
    file = tmp_path / "m.bt"
    file.write_bytes(octree_file(leaves, 0.1, binary=True))
    with caplog.at_level(logging.WARNING):
        scene = read_octomap(file, low=0.0)
    assert covered(scene) == {tuple(k) for k in keys.tolist() if k[2] >= 0}
    assert f"{(keys[:, 2] < 0).sum()} occupied cells outside" in caplog.text


def test_what_is_damaged_is_refused(tmp_path):
    leaves, _ = some_leaves()
    file = tmp_path / "m.bt"
    sound = octree_file(leaves, 0.1, binary=True)
    deep = b"# Octomap OcTree binary file\nid OcTree\nsize 99\nres 0.1\ndata\n" + struct.pack("<H", 3) * 40
    for content, says in [
        (b"", "octree"),
        (b"# Octomap OcTree", "octree"),
        (sound[:-2], "the file ends after"),
        (sound.replace(b"size ", b"size 1"), "its header says"),
        (sound.replace(b"res 0.1", b"res nan"), "res is 'nan'"),
        (octree_file(leaves, 0.1, binary=False).replace(b"id OcTree", b"id CountingOcTree"), "'CountingOcTree'"),
        (sound.replace(b"\ndata\n", b"\ndaten\n"), "no line 'data'"),
        (deep, "deeper than 16 levels"),
    ]:
        file.write_bytes(content)
        with refused(SceneError, "m.bt:") as caught:
            read_octomap(file)
        assert says in str(caught.value)
