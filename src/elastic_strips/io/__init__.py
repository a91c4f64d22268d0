"""IO room: scene and scenario files in and out; every complaint names file and place."""

from typing import TYPE_CHECKING

from elastic_strips._late import late_names

if TYPE_CHECKING:
    from .laser_log import LaserLogError, LoggedScan, read_laser_log
    from .nav2_map import load_nav2_map
    from .obstacle_document import obstacle_documents
    from .point_cloud import PointCloud, cloud_scene, read_point_cloud
    from .record_file import (
        check_record_file,
        read_record,
        record_columns,
        record_csv,
        record_frame,
        record_robot,
        write_record,
    )
    from .scenario_file import PoseSpec, ScenarioSpec, read_scenario
    from .scene_file import read_scene, read_world, write_scene, write_world

_MODULES = {  # a scene file needs nothing of what records need
    "laser_log": ("LaserLogError", "LoggedScan", "read_laser_log"),
    "nav2_map": ("load_nav2_map",),
    "obstacle_document": ("obstacle_documents",),
    "point_cloud": ("PointCloud", "cloud_scene", "read_point_cloud"),
    "record_file": (
        "check_record_file",
        "read_record",
        "record_columns",
        "record_csv",
        "record_frame",
        "record_robot",
        "write_record",
    ),
    "scenario_file": ("PoseSpec", "ScenarioSpec", "read_scenario"),
    "scene_file": ("read_scene", "read_world", "write_scene", "write_world"),
}
__all__ = [
    "LaserLogError",
    "LoggedScan",
    "PointCloud",
    "PoseSpec",
    "ScenarioSpec",
    "check_record_file",
    "cloud_scene",
    "load_nav2_map",
    "obstacle_documents",
    "read_laser_log",
    "read_point_cloud",
    "read_record",
    "read_scenario",
    "read_scene",
    "read_world",
    "record_columns",
    "record_csv",
    "record_frame",
    "record_robot",
    "write_record",
    "write_scene",
    "write_world",
]

__getattr__ = late_names(__name__, _MODULES)
