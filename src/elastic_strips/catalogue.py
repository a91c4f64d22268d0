"""The catalogue: every robot, scenario, preset and fault that has a name, with a line about each; robots' files.

It neither makes nor reads any of them, so that they can be listed at once.
"""

from __future__ import annotations

import difflib
import sys
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

from elastic_strips.errors import RobotError, nearest_name

SCENARIOS = {
    "case-1": "two obstacles 2.1 m apart, slow turning: pass between",
    "case-2": "as case 1, fast turning",
    "case-3": "two obstacles 1.0 m apart, safe distance 1.5 m: the paper's strip is blocked",
    "case-4": "as case 3 with safe distance 0.8 m: pass between",
    "case-5": "two obstacles 0.1 m apart: go around both",
    "case-6": "scattered obstacles",
    "case-7": "the whole robot in 3D: a shelf that the base passes and the arm must avoid",
    "corridor": "8 m of clutter, 32 obstacles of mixed shapes and heights (seeded generator)",
    "clutter": "a room with pillars, tables, shelves and beams; the arm ends above a table (seeded generator)",
    "closing-side": "a box to pass on either side; a cabinet slides into the wider one",
    "bottleneck": "a wall with a door of 0.75 m, a little beside the line",
    "dead-end": "a dead end, 1.2 m deep and 1.8 m wide, on the line",
    "moving-corridor": "the corridor with 1 to 8 moving obstacles that appear, cross and come head-on (seeded)",
    "courteous-corridor": "the corridor with 1 to 8 moving obstacles that appear, cross and come head-on, and stop for "
    "a robot that stands (seeded)",
}

PRESETS = {
    "default": "forces at witness points, implicit update, exact rolling constraint",
    "paper": "Eqs. 2-9 of the paper at its control points; the base moves as if omnidirectional",
}

PLANTS = {
    "kinematic": "wheels with slip and lag",
    "mujoco": "the physics of MuJoCo (extra sim)",
}
"""Simulated machines that can be driven."""

FAULTS = {
    "slip": "the wheels lose this fraction of their travel",
    "slip_left": "the left wheel loses this fraction of its travel",
    "slip_right": "the right wheel loses this fraction of its travel",
    "spin": "the wheels spin: they lose this fraction of their travel, by default all of it",
    "amplifier_holds": "the motors keep their last speeds and ignore commands; a safe stop still works",
    "amplifier_dead": "the motors have no power, and the robot rolls on; a safe stop still works",
    "localization_lost": "no localization fixes arrive",
    "localization_jump": "localization fixes are this far [m] from the truth",
    "localization_coarse": "fixes of 20 mm and 10 mrad (times this) at 10 Hz, 0.1 s late, one in 50 off by 0.3 m",
    "fix_drift": "localization fixes drift sideways from the truth at this speed [m/s]",
    "lost_odometry": "neither wheel travel nor fixes are measured",
    "nan_fix": "localization fixes are not numbers",
    "nan_odometry": "wheel travel is not a number",
    "nan_joints": "joint readings are not numbers",
    "nan_obstacle": "an obstacle's pose is not a number",
    "driver_exception": "reading the measurements raises an exception",
    "sensing_exception": "sensing the scene raises an exception",
    "planning_exception": "the planning tick raises an exception",
    "slow_tick": "the planning tick takes ten times its budget",
    "scene_frozen": "the scene is no longer updated",
    "scene_late": "the scene arrives this much [s] late",
    "scene_future": "the scene's time stamp is this much [s] ahead",
    "scene_empty": "the scene holds no obstacle",
    "scene_without_motion": "obstacles move, but the scene says that they stand still",
    "scene_reversed": "the velocities of the obstacles have the wrong sign",
    "camera_dead": "no depth or range images arrive",
    "camera_frozen": "the same depth and range images arrive again and again, with new time stamps",
    "camera_tilted": "cameras and 3-D lidars look this much [rad] further down than stated",
    "camera_late": "depth and range images are this much [s] older than their time stamps",
    "fog": "cameras and 3-D lidars are in fog, in which light travels this far [m] on average",
    "glass": "this part of the obstacles that rest is of glass: lasers, infrared sensors and cameras see through it",
    "viewer_killed": "the viewer's process dies",
}
"""Faults that can be injected into a drive, and their effects; "this" and "so" stand for the size of a fault."""


@dataclass(frozen=True, slots=True)
class KnownRobot:
    """A robot that can be loaded by its name.

    Attributes:
        name: its name.
        summary: one line about it.
        base: how its root moves, unless told otherwise: ``"diff_drive"``, ``"omni"`` or ``"fixed"``.
        urdf, srdf: its files.
        package_dirs: folders that its meshes are named from.
        planned: joints that are planned unless told otherwise; None: those that ``load_robot`` plans of a file.
        home: joint → value [rad or m] of a home posture of its own.
        hand_frame: frame of its last control point.
    """

    name: str
    summary: str
    base: str
    urdf: Path
    srdf: Path | None = None
    package_dirs: tuple[Path, ...] = ()
    planned: tuple[str, ...] | None = None
    home: Mapping[str, float] = field(default_factory=dict)
    hand_frame: str | None = None


_TIAGO_HOME = {
    "torso_lift_joint": 0.15, "arm_1_joint": 0.2, "arm_2_joint": -1.34, "arm_3_joint": -0.2,
    "arm_4_joint": 1.94, "arm_5_joint": -1.57, "arm_6_joint": 0.6, "arm_7_joint": 0.0,
}  # fmt: skip

_OWN = (
    ("silvermate", "silvermate", "hand_frame", "the paper's robot: round differential-drive base, 7-DOF arm"),
    ("jackal-box", "jackal_box", None, "a Jackal-sized box on two wheels, 0.508 x 0.43 m, no arm: differential drive"),
    (
        "bridge-arm",
        "bridge_arm",
        "tool_frame",
        "a box on two wheels, 0.5 x 0.5 m, with a 6-DOF arm of the UR5's proportions: differential drive",
    ),
)

_MAKERS = {
    "a1": "Unitree A1, quadruped",
    "alex": "Boardwalk Robotics Alex, humanoid upper body",
    "alexander": "IHMC Alexander, humanoid",
    "allegro_hand": "Wonik Allegro, four-fingered hand",
    "anymal_b_simple": "ANYbotics ANYmal B, quadruped",
    "anymal_c_simple": "ANYbotics ANYmal C, quadruped",
    "asr_twodof": "qbrobotics, two-joint demonstrator",
    "b1": "Unitree B1, quadruped",
    "baxter": "Rethink Baxter, two 7-DOF arms",
    "bolt": "ODRI Bolt, biped",
    "borinot": "Borinot, hexacopter with an arm",
    "centauro": "IIT Centauro, four wheeled legs and two arms",
    "double_pendulum": "double pendulum",
    "finger_edu": "ODRI FingerEdu, three-joint finger",
    "g1": "Unitree G1, humanoid",
    "go1": "Unitree Go1, quadruped",
    "go2": "Unitree Go2, quadruped",
    "hector": "Hector, quadrotor",
    "hextilt": "Hextilt, hexacopter with an arm",
    "human": "human body",
    "hyq": "IIT HyQ, quadruped",
    "icub": "IIT iCub, humanoid",
    "iris": "3DR Iris, quadrotor",
    "kinova": "Kinova Jaco 2, 6-DOF arm",
    "laikago": "Unitree Laikago, quadruped",
    "panda": "Franka Emika Panda, 7-DOF arm and gripper",
    "pr2": "Willow Garage PR2, two 7-DOF arms on an omnidirectional base",
    "quadruped": "small quadruped",
    "romeo": "Aldebaran Romeo, humanoid",
    "simple_humanoid": "simple humanoid",
    "so_arm": "TheRobotStudio SO-ARM, 5-DOF arm and gripper",
    "solo": "ODRI Solo, quadruped",
    "talos": "PAL Robotics Talos, humanoid",
    "tiago": "PAL Robotics TIAGo",
    "tiago_pro": "PAL Robotics TIAGo Pro, two 7-DOF arms on an omnidirectional base",
    "ur": "Universal Robots, 6-DOF arm",
    "xarm": "UFACTORY xArm 7, 7-DOF arm",
    "z1": "Unitree Z1, 6-DOF arm and gripper",
}
_BASES = {"tiago": "diff_drive", "tiago_pro": "omni", "pr2": "omni"}  # the others stand, or walk or fly: fixed

_OTHER_LINKS = ("romeo_laas_small",)  # its links are called otherwise than in the SRDF beside it


def robot_names() -> tuple[str, ...]:
    """Names that ``load_robot`` knows: the package's own robots, TIAGo, and all others of example-robot-data."""
    return tuple(_catalogue())


def own_robots() -> tuple[str, ...]:
    """Names of the robots that the scenarios are made for: with a home posture and a hand of their own."""
    return tuple(name for name, robot in _catalogue().items() if robot.hand_frame or robot.urdf.parent == _urdf_dir())


def find_robot(name: str) -> KnownRobot:
    """A robot by its name, or by that of its folder in example-robot-data if it is alone there.

    Raises:
        RobotError: an unknown name, or a name that several robots share; the message lists them.
    """
    known = _catalogue()
    if name in known:
        return known[name]
    sharing = _shared().get(name, ())
    if len(sharing) == 1:
        return known[sharing[0]]
    if sharing:
        raise RobotError(f"robot {name!r} is ambiguous; give one of {', '.join(sharing)}")
    close = difflib.get_close_matches(name, [*known, *_shared()], n=3, cutoff=0.5)
    missing = "" if _example_robot_data() is not None else " The package example-robot-data is not installed."
    raise RobotError(
        f"unknown robot {name!r}{nearest_name(name, {*own_robots(), *close})} 'elastic-strips list --robots' shows "
        f"all; or give the path of a URDF file.{missing}"
    )


def is_known(name: str) -> bool:
    """Whether a name means a robot, or several."""
    return name in _catalogue() or name in _shared()


def is_ours(urdf: Path) -> bool:
    """Whether a URDF file comes with this package."""
    return urdf.parent == _urdf_dir()


def recorded_robot(name: str, urdf: str | None) -> str | None:
    """The name or URDF by which to load a recorded robot; the URDF if another robot has that name now."""
    if name not in _catalogue():
        return urdf
    own = find_robot(name).urdf
    if urdf is None:
        return name
    same = own.samefile(urdf) if Path(urdf).is_file() else own.name == Path(urdf).name  # the latter: another machine's
    return name if same else urdf


@cache
def _catalogue() -> dict[str, KnownRobot]:
    folder = _urdf_dir()
    known = {}
    for name, file, hand, summary in _OWN:
        srdf = folder / f"{file}.srdf"
        known[name] = KnownRobot(
            name,
            summary,
            "diff_drive",
            folder / f"{file}.urdf",
            srdf if srdf.is_file() else None,
            (folder,),
            hand_frame=hand,
        )
    share = _example_robot_data()
    if share is None:
        return known
    root = share / "example-robot-data/robots"
    tiago = root / "tiago_description/robots/tiago.urdf"
    known["tiago"] = KnownRobot(
        "tiago",
        "PAL Robotics TIAGo of example-robot-data: differential drive, lift, 7-DOF arm",
        "diff_drive",
        tiago,
        None,
        (share,),
        tuple(_TIAGO_HOME),
        _TIAGO_HOME,
        "hand_palm_link",
    )
    files = sorted(root.glob("*/*/*.urdf"))
    stems = Counter(urdf.stem for urdf in files)
    for urdf in files:
        if urdf == tiago:
            continue
        maker = _folder(urdf, root)
        name = urdf.stem if stems[urdf.stem] == 1 else maker  # the folder where two files have one name
        summary = f"{_MAKERS.get(maker, maker)}: {urdf.relative_to(root)}"
        known[name] = KnownRobot(name, summary, _BASES.get(maker, "fixed"), urdf, _srdf_of(urdf), (share,))
    return known


@cache
def _shared() -> dict[str, tuple[str, ...]]:
    """Names that do not belong to a single robot: those of folders, and of files where several have the same."""
    share = _example_robot_data()
    shared: dict[str, list[str]] = {}
    for robot in _catalogue().values():
        if share is not None and share in robot.urdf.parents:
            folder = _folder(robot.urdf, share / "example-robot-data/robots")
            for name in {folder, folder.removesuffix("_simple"), robot.urdf.stem}:
                shared.setdefault(name, []).append(robot.name)
    return {name: tuple(sorted(names)) for name, names in shared.items()}


def _folder(urdf: Path, root: Path) -> str:
    """The name in the robot's folder."""
    return urdf.relative_to(root).parts[0].removesuffix("_description").removesuffix("_data")


def _srdf_of(urdf: Path) -> Path | None:
    """The SRDF of a URDF: of the same name, or of the longest name that the URDF's begins with, or the only one."""
    if urdf.stem in _OTHER_LINKS:
        return None
    files = sorted((urdf.parents[1] / "srdf").glob("*.srdf"))
    fitting = [f for f in files if urdf.stem == f.stem or urdf.stem.startswith((f.stem + "_", f.stem + "-"))]
    if fitting:
        return max(fitting, key=lambda f: len(f.stem))
    return files[0] if len(files) == 1 else None


def _urdf_dir() -> Path:
    """Return the directory that holds the URDFs that come with elastic_strips.

    A wheel carries a copy inside the package; an editable install reads the checkout's top-level ``urdf/``.

    Raises:
        RobotError: Neither directory exists.
    """
    package = Path(__file__).resolve().parent
    tried = (package / "urdf", package.parents[1] / "urdf")
    for directory in tried:
        if directory.is_dir():
            return directory
    raise RobotError(
        f"the robot descriptions are missing: neither {tried[0]} (installed) nor {tried[1]} (checkout) is a directory; "
        "install the package again, or give the path of a URDF."
    )


@cache
def _example_robot_data() -> Path | None:
    """Return the ``share`` folder that holds example-robot-data; None where the package is not installed."""
    try:
        import cmeel
    except ImportError:  # Pinocchio came otherwise than by pip
        return None
    places = [Path(p) / "cmeel.prefix/share" for p in (*cmeel.__path__, *sys.path)]
    places += [Path(p).parent / "cmeel.prefix/share" for p in cmeel.__path__]
    return next((place for place in places if (place / "example-robot-data/robots").is_dir()), None)
