"""``elastic-strips certify``: prove that a path of any planner is free of collisions, or show where it is not."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Literal

import click

from elastic_strips.errors import listed, plural

from . import options, output
from .robot_options import robot_options, say_assumed_base
from .scene_options import SCENE_FILES, Pose, scene_options

if TYPE_CHECKING:
    from elastic_strips.arrays import Array
    from elastic_strips.collision import PathCertificate
    from elastic_strips.io.path_file import PathFile
    from elastic_strips.io.scene_source import SceneFile, SceneOptions
    from elastic_strips.robot import LoadOptions, RobotModel
    from elastic_strips.scene import Scene
    from elastic_strips.strip import Strip
    from elastic_strips.viewer import Viewer

_FAR_OFF = 50.0  # [m] from a path, a scene in which all is large may be in millimetres
_JOINTS_LISTED = 12  # joints in a note


@click.command()
@click.argument("path", metavar="PATH", type=options.FILE)
@click.option("--robot", required=True, metavar=options.ROBOT_FILES, type=options.ROBOT, help="The robot of the path.")
@click.option(
    "--scene",
    "scene_files",
    required=True,
    multiple=True,
    metavar="FILE",
    type=options.FILE,
    help=SCENE_FILES,
)
@scene_options
@options.base_option()
@robot_options
@click.option(
    "--clearance",
    type=options.Finite(0.0, 10.0),
    default=0.0,
    show_default=True,
    help="Distance from obstacles that is to be proved [m].",
)
@click.option(
    "--self-clearance",
    type=options.Finite(0.0, 1.0),
    default=0.0,
    show_default=True,
    help="Distance between the robot's own links that is to be proved [m].",
)
@click.option(
    "--interpolation",
    default="line",
    type=options.LateChoice("elastic_strips.collision.path_certificate", "INTERPOLATIONS"),
    show_default=True,
    help="How the robot moves between two configurations. line: base and joints move linearly; arc: the base drives an "
    "arc, as wheels do. Where an angle changes by more than half a turn, these two do not say which way it turns; "
    "values (linear in the numbers as given) and shortest do.",
)
@click.option(
    "--scene-time",
    "moment",
    metavar="SECONDS",
    type=options.Finite(-1e9, 1e9),
    help="Take the scene as it is at this time [s], whatever times the path has.",
)
@click.option(
    "--base-at",
    type=Pose(3),
    metavar="X,Y,YAW",
    help="Where the base stands, if the path does not say [m, m, rad].",
)
@click.option(
    "--angles",
    type=click.Choice(["rad", "deg"]),
    help="Unit of the path's angles where it names none; radians by default.",
)
@click.option(
    "--ignore",
    multiple=True,
    metavar="NAME",
    help="A column, array or key of the file that does not matter. May be repeated.",
)
@click.option(
    "--starts-at",
    type=options.Finite(-1e9, 1e9),
    metavar="SECONDS",
    help="When the first configuration is reached [s], in the scene's time; by default as the path says.",
)
@click.option(
    "--repair",
    "repaired",
    metavar="FILE",
    type=options.OutputFile(),
    help="Write the path. If it is not certified, it is first pushed away from what is too near; the answer says "
    "whether it is certified then.",
)
@click.option(
    "--proof",
    metavar="FILE.npz",
    type=options.OutputFile(),
    help="Write a proof that others can check, by python -m elastic_strips.proof_checker or a copy of that file.",
)
@options.json_option("Write the answer.")
@options.html_option("Write a standalone 3D page of the path, and of where it is refuted.")
@options.picture_options
@click.option("--view", is_flag=True, help="Show the path in the browser, on this machine only, until Ctrl-C.")
@options.browser_option
def certify(
    path: str,
    robot: str,
    scene_files: tuple[str, ...],
    reading: SceneOptions,
    base: str | None,
    described: LoadOptions,
    clearance: float,
    self_clearance: float,
    interpolation: str,
    moment: float | None,
    base_at: tuple[float, float, float] | None,
    angles: Literal["rad", "deg"] | None,
    ignore: tuple[str, ...],
    starts_at: float | None,
    repaired: str | None,
    proof: str | None,
    json_file: str | None,
    html_file: str | None,
    png_file: str | None,
    film_file: str | None,
    view: bool,
    no_browser: bool,
) -> int:
    """Prove that PATH is free of collisions all along, or show a configuration on it that is not.

    PATH is a JointTrajectory (JSON or YAML, also as MoveIt prints it), CSV, NPZ, or what OMPL prints. Where obstacles
    of the scene move, appear or vanish, a path with times is certified against them as they are at those times; a path
    without times needs --scene-time.

    Where the path that is looked at differs from its file, for instance because a gripper moves there and is held still
    here, it is not certified: the answer is unknown, and says what would settle it.

    Exit code 0: certified (with --repair: the repaired path). 2: wrong input. 3: refuted or unknown; the answer says
    where.
    """
    from elastic_strips.catalogue import is_known
    from elastic_strips.collision import Verdict
    from elastic_strips.collision import certify as certify_path
    from elastic_strips.io import load_path, read_scene_file
    from elastic_strips.robot import load_robot
    from elastic_strips.robot.unchecked_pairs import counted
    from elastic_strips.strip import Strip

    options.check_outputs(path, repaired, proof, json_file, html_file, png_file, film_file)
    model = load_robot(robot, base=base, **described)
    given = load_path(path, model, base_at=base_at, angles=angles, ignore=ignore, starts_at=starts_at)
    scene_file = read_scene_file(scene_files, robot=model, q=given.q[0], options=reading)
    model = _holding(model, scene_file)
    timed = _depends_on_time(path, given, scene_file, moment, writes=bool(repaired or proof))
    world = scene_file.world
    scene = world.at(world.scene.time if moment is None else moment)
    found = certify_path(
        model,
        world if timed else scene,
        given,
        clearance=clearance,
        self_clearance=self_clearance,
        interpolation=interpolation,
        times=given.times if timed else None,
    )
    if found.certified and (left := _left_map(model, scene_file, given.q) or _far_off(world.scene, found.least)):
        found = replace(found, verdict=Verdict.UNKNOWN, reason=left)
    doubts = (*given.doubts, *(given.time_doubts if timed else ()))
    _say_notes(given)
    asked = f"{'; '.join(doubts)}; as it is read, " if doubts and found.broken else ""  # else they are the reason
    output.say(f"{path}: ", output.verdict(found.verdict.value, found.certified), f": {asked}{found.reason}")
    if model.space.planar and given.q.shape[0] > 1 and _base_moves(model, given.q):
        say_assumed_base(model, named=is_known(robot) or base is not None)
    document = _document(model, found, doubts, interpolation)
    document |= {
        "path": path,
        "configurations": len(given.q),
        "scene": list(scene_files),
        "obstacles": len(world.scene),
        "held_still": dict(model.locked),
        "held_and_not_in_path": sorted(given.held),
        "at_home_and_not_in_path": sorted(given.at_home),
        "carried": list(scene_file.held_names),
        "not_kept_apart": [{"links": list(pair.links), "why": pair.why.value} for pair in model.unchecked_pairs],
        "times_s": [float(given.times[0]), float(given.times[-1])] if timed and given.times is not None else None,
    }
    done, outcome = found.certified, _Outcome(given, interpolation)
    if doubts and (repaired or proof):
        output.say(("neither repaired nor proven", output.BAD), ": ", "; ".join(doubts))
    else:
        margins = _Clearances(clearance, self_clearance)
        if repaired is not None:
            if not done:
                outcome, done, document["repair"] = _repair(model, scene, scene_file, given, margins)
            if done:
                untimed = ", without times" if given.times is not None and isinstance(outcome.path, Strip) else ""
                output.say(f"path    {outcome.write(repaired, model)}{untimed}")
        if proof is not None:
            about = "the repaired path" if isinstance(outcome.path, Strip) else path
            document |= _prove(proof, model, scene, outcome, margins, about) if done else _no_proof("")
            done = "proof" in document
    if (found.certified or done) and model.unchecked_pairs:
        pairs = plural(len(model.unchecked_pairs), "pair")
        said = f"{pairs} of its own links are not kept apart ({counted(model.unchecked_pairs)})"
        output.say(("note:", output.NOTE), f" {said}; 'elastic-strips robot' names them")
    output.write_document("answer", json_file, document)
    shown = world.at(found.time) if timed and found.time is not None else scene  # what it touches is there then
    drawn, about, title = _Outcome(given, interpolation), found, os.path.basename(path)
    if repaired is not None and done and isinstance(outcome.path, Strip):  # what was written is shown
        drawn, title = outcome, f"{os.path.basename(repaired)}, repaired"
        about = certify_path(
            model,
            scene,
            outcome.path,
            clearance=clearance,
            self_clearance=self_clearance,
            interpolation=outcome.interpolation,
        )
    draw = partial(_draw, model, shown, drawn, about)
    options.write_pictures(draw, html_file, png_file, film_file, title=title)
    if view:
        options.serve(draw, no_browser=no_browser, title=title)
    return options.EXIT_DONE if done else options.EXIT_NOT_DONE


def _draw(robot: RobotModel, scene: Scene, drawn: _Outcome, found: PathCertificate, viewer: Viewer) -> None:
    """The path that was given, or repaired: the robot goes along it where it is certified, else it is where it touches
    something."""
    from elastic_strips.viewer.path_report import PathReport

    report = PathReport.of(robot, drawn.path, found, interpolation=drawn.interpolation)
    if found.certified and len(drawn.path.q) > 1:
        viewer.animate(robot, scene, report)
    else:
        viewer.show(robot, scene, report)


@dataclass(frozen=True)
class _Clearances:
    """What is to be proven, from obstacles and between the robot's own links [m]."""

    from_obstacles: float
    from_itself: float


@dataclass(frozen=True)
class _Outcome:
    """The path that is written and proven: the given one, or the repaired one, and the way between configurations."""

    path: PathFile | Strip
    interpolation: str

    def write(self, file: str, robot: RobotModel) -> str:
        from elastic_strips.io import write_path

        return str(write_path(file, robot, self.path.q if self.interpolation == "shortest" else self.path))


def _holding(robot: RobotModel, scene: SceneFile) -> RobotModel:
    """The robot with what the scene's file says that it holds."""
    if not scene.held:
        return robot
    output.say(("note:", output.NOTE), f" {robot.name} holds {', '.join(scene.held_names)}")
    return scene.held_by(robot)


def _depends_on_time(path: str, given: PathFile, scene: SceneFile, moment: float | None, *, writes: bool) -> bool:
    """Whether the answer is about a world that changes; a usage error where that cannot be answered.

    ``writes``: a repaired path or a proof is asked for, which are of obstacles that stand still.
    """
    from elastic_strips.collision.path_certificate import changes

    moving = changes(scene.world)
    if not moving or moment is not None:
        return False
    said = f"the scene changes with time ({listed(moving)}); "
    if given.times is None:
        raise click.UsageError(
            f"{said}{path} has no times: add times, or give --scene-time SECONDS to take the scene as it is then"
        )
    if writes:
        raise click.UsageError(
            f"{said}--repair and --proof need obstacles that stand still: --scene-time SECONDS takes them as they are "
            "then, and the answer is about that alone"
        )
    return True


def _base_moves(robot: RobotModel, q: Array) -> bool:
    base = robot.space.to_coordinates(q)[:, :3]
    return bool((base != base[0]).any())


def _say_notes(given: PathFile) -> None:
    """Say what was noticed while the path was read."""
    notes = list(given.notes)
    if given.held:
        still = [f"{joint} at {at:.6g}" for joint, at in given.held.items()]
        notes.append(f"held still, and missing from the file: {listed(still, _JOINTS_LISTED)}")
    for note in notes:
        output.say(("note:", output.NOTE), f" {note}")


def _repair(
    robot: RobotModel, scene: Scene, scene_file: SceneFile, given: PathFile, clearances: _Clearances
) -> tuple[_Outcome, bool, dict[str, object]]:
    """The path pushed free, whether it is certified, and the document's lines about it."""
    from elastic_strips.collision import certify as certify_path
    from elastic_strips.strip import DeformParams, repair

    params = DeformParams(clearance=clearances.from_obstacles, self_clearance=clearances.from_itself)
    mended = repair(robot, scene, given, params=params)
    left = _left_map(robot, scene_file, mended.strip.q)
    done = mended.certified and left is None
    least = certify_path(robot, scene, mended.strip, interpolation="arc").least if done else None
    if done:
        near = "" if least is None or not len(scene) else f", {least:.3f} m at the nearest place"
        output.say(
            "repaired: ",
            output.verdict("certified", done),
            f"; moved by at most {mended.moved:.3f} m, {len(mended.strip)} configurations{near}"
            f"{', which turns the shorter way' * bool(robot.space.turning.any())}",
        )
        if mended.relaxed:
            output.say(
                ("note:", output.NOTE),
                " it had to be pushed far, and was relaxed: between its ends it may go, and bend the arm, in other "
                "ways than yours; 'elastic-strips run' plans another",
            )
    else:
        output.say(
            output.verdict("not repaired", done),
            f": {left or f'{mended.reason}; it was cut into {len(mended.strip) - 1} segments'}. Nothing is written; "
            "another way may be found between its ends: 'elastic-strips run'",
        )
    said = {
        "certified": done,
        "moved_m": mended.moved,
        "least_m": least,
        "relaxed": mended.relaxed,
        "reason": mended.reason,
    }
    return _Outcome(mended.strip, "arc"), done, said


def _prove(
    file: str, robot: RobotModel, scene: Scene, outcome: _Outcome, clearances: _Clearances, about: str
) -> dict[str, dict[str, object]]:
    """Write the proof of a certified path; the document's lines about it, none where it could not be made.

    ``about``: what the path is called.
    """
    from elastic_strips.collision import prove

    made = prove(
        robot,
        scene,
        outcome.path,
        clearance=clearances.from_obstacles,
        self_clearance=clearances.from_itself,
        interpolation=outcome.interpolation,
    )
    if made is None:
        return _no_proof(", or too narrowly")
    way = str(made.header["way"])
    called = "" if way == outcome.interpolation else f", as proofs call {outcome.interpolation}"
    output.say(f"proof   {made.save(file)} of {about}, {len(made.span)} intervals, interpolation {way}{called}")
    for what, name in made.digests.items():
        output.say(f"  {what:6} {name}")
    return {"proof": {"of": about, "intervals": len(made.span), "way": made.header["way"], **made.digests}}


def _no_proof(more: str) -> dict[str, dict[str, object]]:
    output.say(("no proof", output.BAD), f": the path is not certified{more}")
    return {}


def _left_map(robot: RobotModel, scene: SceneFile, q: Array) -> str | None:
    """A note about a path whose base stands where no map shows anything; None where it does not."""
    base = robot.space.to_coordinates(q)[:, :2].tolist() if robot.space.planar else [[0.0, 0.0]]
    beyond = scene.outside(base)
    if not len(beyond):
        return None
    x, y = base[beyond[0]]
    return f"configuration {beyond[0]} at ({x:.3g}, {y:.3g}) is outside the map, where nothing is known"


def _far_off(scene: Scene, least: float | None) -> str | None:
    """Why a scene that is far from all of a path may be meant in another unit; None where it may not."""
    from elastic_strips.io.scene_file import seem_millimetres

    doubt = seem_millimetres(scene) if least is not None and least > _FAR_OFF else ""
    return f"the path is {least:.0f} m or more from all of the scene, and {doubt}" if doubt else None


def _document(
    robot: RobotModel, found: PathCertificate, doubts: tuple[str, ...], interpolation: str
) -> dict[str, object]:
    """The answer as plain values for JSON."""
    broken = found.broken
    least = found.least if found.least is None or math.isfinite(found.least) else None
    return {
        "verdict": found.verdict.value,
        "reason": found.reason,
        "robot": robot.name,
        "notes": list(found.notes),
        "interpolation": interpolation,
        "links_without_shape": list(robot.bare_links),
        "doubts": list(doubts),
        "clearance_m": found.clearance,
        "self_clearance_m": found.self_clearance,
        "least_clearance_m": least,
        "segments": list(found.segments),
        "seconds": found.seconds,
        "broken": None
        if broken is None
        else {
            "segment": broken.segment,
            "place": found.place,
            "time_s": found.time,
            "link": broken.link,
            "obstacle": broken.obstacle,
            "kind": broken.kind,
            "distance_m": found.distance,
            "q": None if found.q is None else found.q.tolist(),
        },
    }
