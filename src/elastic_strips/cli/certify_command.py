"""``elastic-strips certify``: prove that a path of any planner is free of collisions, or show where it is not."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Literal

import click

from . import options, output
from .robot_options import robot_options
from .scene_options import SCENE_FILES, scene_options

if TYPE_CHECKING:
    from elastic_strips.arrays import Array
    from elastic_strips.collision import PathCertificate
    from elastic_strips.io.scene_source import SceneFile, SceneOptions
    from elastic_strips.robot import LoadOptions, RobotModel

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
    "--clearance", type=options.Finite(0.0, 10.0), default=0.0, show_default=True, help="From obstacles, to prove [m]."
)
@click.option(
    "--self-clearance",
    type=options.Finite(0.0, 1.0),
    default=0.0,
    show_default=True,
    help="Between the robot's own links, to prove [m].",
)
@click.option(
    "--interpolation",
    default="line",
    type=options.LateChoice("elastic_strips.collision.path_certificate", "INTERPOLATIONS"),
    show_default=True,
    help="The way between two configurations. line: base and joints go linearly; arc: a base goes on an arc, as wheels "
    "do. Neither says which way an angle goes that changes by more than half a turn: values (linearly by the numbers) "
    "and shortest do.",
)
@click.option(
    "--scene-time",
    "moment",
    metavar="SECONDS",
    type=options.Finite(-1e9, 1e9),
    help="Take the scene as it stands then, whatever times the path has.",
)
@click.option(
    "--base-at",
    type=(options.Finite(), options.Finite(), options.Finite()),
    metavar="X Y YAW",
    help="Where the base stands, if the path does not say so [m, m, rad].",
)
@click.option(
    "--angles",
    type=click.Choice(["rad", "deg"]),
    help="Unit of the path's angles where it names none; radians by default.",
)
@click.option("--ignore", multiple=True, metavar="NAME", help="A column, array or key that does not matter.")
@click.option(
    "--starts-at",
    type=options.Finite(-1e9, 1e9),
    metavar="SECONDS",
    help="When the first configuration is reached, in the scene's time; as the path has it by default.",
)
@click.option("--repair", "repaired", metavar="FILE", type=options.OutputFile(), help="Push it free; write that path.")
@click.option("--proof", metavar="FILE.npz", type=options.OutputFile(), help="Write a proof that others can check.")
@options.json_option("Write the answer.")
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
) -> int:
    """Prove that PATH is free of collisions all along, or show a configuration on it that is not.

    PATH is a JointTrajectory (JSON or YAML, also what MoveIt prints), CSV, NPZ, or what OMPL prints. A path with times
    is certified against the obstacles that move, appear and vanish, where the scene has some; a path without times
    needs --scene-time then.

    A path that differs from its file, such as one whose gripper moves and is held still here, is not certified:
    the answer is unknown, and says what settles it.

    Exit code 0: certified (with --repair: the repaired path). 2: wrong input. 3: refuted or unknown; it says where.
    """
    from elastic_strips.collision import Verdict, prove
    from elastic_strips.collision import certify as certify_path
    from elastic_strips.collision.path_certificate import changes
    from elastic_strips.io import load_path, read_scene_file, write_path
    from elastic_strips.robot import load_robot
    from elastic_strips.strip import DeformParams, repair

    options.check_outputs(path, repaired, proof, json_file)
    model = load_robot(robot, base=base, **described)
    given = load_path(path, model, base_at=base_at, angles=angles, ignore=ignore, starts_at=starts_at)
    found_scene = read_scene_file(scene_files, robot=model, q=given.q[0], options=reading)
    world = found_scene.world
    if found_scene.held:
        model = found_scene.held_by(model)
        output.say(("note:", output.NOTE), f" {model.name} holds {', '.join(found_scene.held_names)}")
    moving = changes(world)
    if moving and moment is None:
        said = f"{', '.join(moving[:3])} move, appear or vanish with the time; "
        if given.times is None:
            raise click.UsageError(
                f"{said}{path} has no times: give it some, or --scene-time SECONDS for the scene as it is then"
            )
        if repaired or proof:
            raise click.UsageError(
                f"{said}--repair and --proof need obstacles that stand still: give --scene-time SECONDS"
            )
    timed = bool(moving) and moment is None
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
    if found.certified and (left := _left_map(model, found_scene, given.q)):
        found = replace(found, verdict=Verdict.UNKNOWN, reason=left)
    for note in given.notes:
        output.say(("note:", output.NOTE), f" {note}")
    if given.held:
        still = [f"{joint} at {at:.6g}" for joint, at in given.held.items()]
        more = f" and {len(still) - _JOINTS_LISTED} more" if len(still) > _JOINTS_LISTED else ""
        output.say(
            ("note:", output.NOTE), f" held still, and not in the file: {', '.join(still[:_JOINTS_LISTED])}{more}"
        )
    doubts = (*given.doubts, *(given.time_doubts if timed else ()))
    for doubt in doubts if found.broken else ():  # else they are the reason
        output.say(("note:", output.NOTE), f" {doubt}")
    output.say(f"{path}: ", output.verdict(found.verdict.value, found.certified), f": {found.reason}")
    document = _document(model, found, given.notes, doubts, interpolation)
    document |= {
        "path": path,
        "configurations": len(given.q),
        "scene": list(scene_files),
        "obstacles": len(world.scene),
        "held_still": dict(model.locked),
        "held_and_not_in_path": sorted(given.held),
        "carried": list(found_scene.held_names),
        "times_s": [float(given.times[0]), float(given.times[-1])] if timed and given.times is not None else None,
    }
    done, mended_path = found.certified, None
    if doubts and (repaired or proof):
        output.say(("neither repaired nor proven", output.BAD), ": ", "; ".join(doubts))
    elif repaired is not None:
        if not done:
            params = DeformParams(clearance=clearance, self_clearance=self_clearance)
            mended = repair(model, scene, given.q, params=params)
            left = _left_map(model, found_scene, mended.strip.q)
            done, mended_path, interpolation = mended.certified and left is None, mended.strip, "arc"
            said = "certified" if done else f"not certified: {left or mended.reason}"
            output.say(
                "repaired: ",
                output.verdict(said, done),
                f"; moved by at most {mended.moved:.3f} m, {len(mended.strip)} configurations"
                f"{', angles the shorter way' * bool(model.space.turning.any())}",
            )
            document["repair"] = {"certified": done, "moved_m": mended.moved, "reason": mended.reason}
        short = given.q if interpolation == "shortest" else given
        output.say(f"path    {write_path(repaired, model, short if mended_path is None else mended_path)}")
    if proof is not None and not doubts:
        made = None
        if done:
            made = prove(
                model,
                scene,
                given if mended_path is None else mended_path,
                clearance=clearance,
                self_clearance=self_clearance,
                interpolation=interpolation,
            )
        if made is None:
            output.say(("no proof", output.BAD), ": the path is not certified" + (", or too narrowly" if done else ""))
            done = False
        else:
            output.say(f"proof   {made.save(proof)}, {len(made.span)} intervals, angles {made.header['way']}")
            document["proof"] = {"intervals": len(made.span), "way": made.header["way"], **made.digests}
            for what, name in made.digests.items():
                output.say(f"  {what:6} {name}")
    output.write_document("answer", json_file, document)
    return options.EXIT_DONE if done else options.EXIT_NOT_DONE


def _left_map(robot: RobotModel, scene: SceneFile, q: Array) -> str | None:
    """A note about a path whose base stands where no map shows anything; None where it does not."""
    base = robot.space.to_coordinates(q)[:, :2].tolist() if robot.space.planar else [[0.0, 0.0]]
    beyond = scene.outside(base)
    if not len(beyond):
        return None
    x, y = base[beyond[0]]
    return f"configuration {beyond[0]} at ({x:.3g}, {y:.3g}) is outside the map, where nothing is known"


def _document(
    robot: RobotModel, found: PathCertificate, notes: tuple[str, ...], doubts: tuple[str, ...], interpolation: str
) -> dict[str, object]:
    """The answer as plain values for JSON."""
    broken = found.broken
    least = found.least if found.least is None or math.isfinite(found.least) else None
    return {
        "verdict": found.verdict.value,
        "reason": found.reason,
        "robot": robot.name,
        "notes": [*notes, *found.notes],
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
