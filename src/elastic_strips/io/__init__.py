"""IO room: scene and scenario files in and out; every complaint names file and place."""

from typing import TYPE_CHECKING

from elastic_strips._late import late_names

if TYPE_CHECKING:
    from elastic_strips.io.files import check_writable, write_json
    from elastic_strips.io.laser_log import LaserLogError, LoggedScan, read_laser_log
    from elastic_strips.io.nav2_map import load_nav2_map
    from elastic_strips.io.point_cloud import PointCloud, cloud_scene, read_point_cloud
    from elastic_strips.io.record_file import (
        check_record_file,
        read_record,
        record_columns,
        record_csv,
        record_frame,
        record_robot,
        write_record,
    )
    from elastic_strips.io.scenario_file import PoseSpec, ScenarioSpec, read_scenario
    from elastic_strips.io.scene_file import (
        obstacle_documents,
        read_scene,
        read_world,
        scene_from_node,
        shape_document,
        world_from_node,
        write_scene,
        write_world,
    )
    from elastic_strips.io.yaml_source import Node, load_yaml

__all__ = [
    "LaserLogError",
    "LoggedScan",
    "Node",
    "PointCloud",
    "PoseSpec",
    "ScenarioSpec",
    "check_record_file",
    "check_writable",
    "cloud_scene",
    "load_nav2_map",
    "load_yaml",
    "obstacle_documents",
    "read_laser_log",
    "read_point_cloud",
    "read_record",
    "read_scenario",
    "read_scene",
    "read_world",
    "scene_from_node",
    "record_columns",
    "record_csv",
    "record_frame",
    "record_robot",
    "shape_document",
    "world_from_node",
    "write_json",
    "write_record",
    "write_scene",
    "write_world",
]

__getattr__ = late_names(  # a scene file needs nothing of what records need
    __name__,
    {
        "files": (
            "check_writable",
            "write_json",
        ),
        "laser_log": (
            "LaserLogError",
            "LoggedScan",
            "read_laser_log",
        ),
        "nav2_map": ("load_nav2_map",),
        "point_cloud": (
            "PointCloud",
            "cloud_scene",
            "read_point_cloud",
        ),
        "record_file": (
            "record_columns",
            "record_csv",
            "record_frame",
            "check_record_file",
            "read_record",
            "record_robot",
            "write_record",
        ),
        "scenario_file": (
            "PoseSpec",
            "ScenarioSpec",
            "read_scenario",
        ),
        "scene_file": (
            "obstacle_documents",
            "shape_document",
            "write_scene",
            "write_world",
            "read_scene",
            "read_world",
            "scene_from_node",
            "world_from_node",
        ),
        "yaml_source": (
            "Node",
            "load_yaml",
        ),
    },
)
