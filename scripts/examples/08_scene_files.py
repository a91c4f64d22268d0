"""Scenes as files: write one, read it, and see that it holds the same."""

import tempfile
from pathlib import Path

import elastic_strips as es

scene = es.Scene(
    [
        es.Box((1.0, 0.6, 0.05), at=(2.0, 0.0, 0.75), name="table"),
        es.Capsule(0.05, 0.7, at=(2.0, 0.0, 0.4), name="leg"),
        es.Cylinder(0.25, 1.7, at=(0.0, 3.0, 0.85), name="person", motion=es.scene.UnknownMotion(0.5)),
    ]
)
with tempfile.TemporaryDirectory() as folder:
    file = Path(folder, "room.yaml")
    es.write_scene(scene, file)
    print(file.read_text())
    again = es.read_scene(file)
print("read again:", ", ".join(again.names))
