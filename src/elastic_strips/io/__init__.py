"""IO room: reads and writes scenes, records, trajectories, laser logs, clouds, maps, bags; errors name the place."""

from typing import TYPE_CHECKING

from elastic_strips._late import late_names

if TYPE_CHECKING:
    from .bag_reader import BagError, BagReader
    from .bag_writer import write_bag
    from .laser_log import LaserLogError, read_laser_log
    from .moveit_scene import read_moveit_scene
    from .nav2_map import load_nav2_map
    from .octomap import read_octomap
    from .path_file import PathFile, load_path, write_path
    from .point_cloud import PointCloud, cloud_scene, read_point_cloud, without_robot
    from .record_file import read_record, record_columns, record_frame, record_robot, write_record
    from .scene_file import (
        HandSpec,
        PoseSpec,
        read_scenario,
        read_scene,
        read_scene_file,
        read_world,
        write_scene,
        write_world,
    )
    from .trajectory_data import trajectory_columns, trajectory_document, trajectory_frame
    from .trajectory_file import write_trajectory

__all__ = [
    "BagError", "BagReader", "HandSpec", "LaserLogError", "PathFile", "PointCloud", "PoseSpec", "cloud_scene",
    "load_nav2_map", "load_path", "read_laser_log", "read_moveit_scene", "read_octomap", "read_point_cloud",
    "read_record", "read_scenario", "read_scene", "read_scene_file", "read_world", "record_columns", "record_frame",
    "record_robot", "trajectory_columns", "trajectory_document", "trajectory_frame", "without_robot", "write_bag",
    "write_path", "write_record", "write_scene", "write_trajectory", "write_world",
]  # fmt: skip

_MODULES = {  # a scene file needs nothing of what records need
    "bag_reader": ("BagError", "BagReader"),
    "bag_writer": ("write_bag",),
    "laser_log": ("LaserLogError", "read_laser_log"),
    "moveit_scene": ("read_moveit_scene",),
    "nav2_map": ("load_nav2_map",),
    "octomap": ("read_octomap",),
    "path_file": ("PathFile", "load_path", "write_path"),
    "point_cloud": ("PointCloud", "cloud_scene", "read_point_cloud", "without_robot"),
    "record_file": ("read_record", "record_columns", "record_frame", "record_robot", "write_record"),
    "scene_file": (
        *(
            "HandSpec",
            "PoseSpec",
            "read_scenario",
            "read_scene",
            "read_scene_file",
            "read_world",
            "write_scene",
            "write_world",
        ),
    ),
    "trajectory_data": ("trajectory_columns", "trajectory_document", "trajectory_frame"),
    "trajectory_file": ("write_trajectory",),
}
__getattr__ = late_names(__name__, _MODULES)
