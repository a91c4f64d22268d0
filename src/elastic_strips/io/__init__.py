"""IO room: scene and scenario files in and out; every complaint names file, line and key."""

from elastic_strips.io.files import check_writable, write_json
from elastic_strips.io.obstacle_document import obstacle_documents, shape_document
from elastic_strips.io.scenario_file import PoseSpec, ScenarioSpec, read_scenario
from elastic_strips.io.scene_file import read_scene, scene_from_node
from elastic_strips.io.scene_writer import write_scene
from elastic_strips.io.yaml_source import Node, load_yaml

__all__ = [
    "Node",
    "PoseSpec",
    "ScenarioSpec",
    "check_writable",
    "load_yaml",
    "obstacle_documents",
    "read_scenario",
    "read_scene",
    "scene_from_node",
    "shape_document",
    "write_json",
    "write_scene",
]
