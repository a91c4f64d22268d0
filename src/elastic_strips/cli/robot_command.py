"""``elastic-strips robot``: a robot's card, on the terminal, as a page, as a picture and as JSON."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from elastic_strips.catalogue import is_known
from elastic_strips.errors import ParameterError
from elastic_strips.files import atomic_write, check_writable

from . import options, output
from .robot_options import robot_options, say_assumed_base

if TYPE_CHECKING:
    from elastic_strips.robot import LoadOptions, RobotModel
    from elastic_strips.robot.card import CardSection, RobotCard


@click.command()
@click.argument("name", metavar=options.ROBOT_FILES, type=options.ROBOT)
@options.base_option()
@robot_options
@options.limit_options
@options.html_option("Write a page: the tables, and a picture that can be turned.")
@click.option(
    "--png", "png_file", metavar="FILE.png", type=options.PictureFile(".png"), help="Write a picture (needs Chromium)."
)
@options.json_option("Write the card.")
def robot(
    name: str,
    base: str | None,
    described: LoadOptions,
    limits: options.GivenLimits,
    html_file: str | None,
    png_file: str | None,
    json_file: str | None,
) -> int:
    """What is known of a robot, what is assumed and what is not looked at: joints, limits, shapes, pairs, meshes and
    frames.

    Its URDF is read a second time, by yourdfpy; differences are reported.

    Exit code 0: there is a card, whatever it says. 2: wrong input.
    """
    from elastic_strips.robot import load_robot

    options.check_outputs(name, html_file, png_file, json_file)
    model = load_robot(name, base=base, **described)
    card = model.card()
    card = card.with_section(_motion(model, limits), after=card.titles[1])
    output.say((card.name, output.NAME), f": {card.base}")
    say_assumed_base(model, named=is_known(name) or base is not None)
    for trouble in card.troubles:
        output.say(("  note: ", output.NOTE), trouble)
    for section in card.sections:
        title, rows, more = section.headline, section.shown, section.more
        output.show(
            lambda title=title, rows=rows, columns=section.columns: output.table(columns, rows, title=title),
            section.text(),
            more,
        )
    if html_file is not None or png_file is not None:
        _draw(model, card, html_file, png_file)
    output.write_document("card", json_file, card.document())
    return options.EXIT_DONE


def _draw(model: RobotModel, card: RobotCard, html_file: str | None, png_file: str | None) -> None:
    from elastic_strips.scene import Scene
    from elastic_strips.viewer import Viewer
    from elastic_strips.viewer.card_page import card_page

    with Viewer(server=False, title=card.name) as viewer:
        viewer.show(model, Scene(), model.home_q[None])
        picture = viewer.html()
        if not viewer.alive:
            raise options.ViewerFailure("the picture could not be drawn (elastic-strips -v says why)")
        if html_file is not None:
            output.say(f"page    {atomic_write(check_writable(html_file), card_page(card, picture).encode())}")
        if png_file is not None:
            output.say(f"picture {viewer.save_png(png_file)}")


def _motion(model: RobotModel, given: options.GivenLimits) -> CardSection:
    """How fast the robot may move, and where that is stated."""
    from elastic_strips.robot.card import CardSection
    from elastic_strips.trajectory import MotionLimits
    from elastic_strips.trajectory.limits import BASE_SPEED, sliding_joints

    title, columns = "Speeds and accelerations", ("what", "value", "by")
    rows: list[tuple[str, str, str]] = []
    stated = model.model.velocityLimit[model.space.base_nv :]
    unstated = {n: 1.0 for n, v in zip(model.joint_names, stated, strict=True) if not 0.0 < float(v) < 1e6}
    try:
        found = MotionLimits.for_robot(
            model,
            joint_speed={**unstated, **given.joint_speed},
            wheel_speed=given.wheel_speed,
            track=given.track,
            wheel_radius=given.wheel_radius,
            base_speed=given.base_speed or BASE_SPEED,
        )
    except ParameterError as error:
        return CardSection(title, columns, (("wheels", "not known", "see above"),), str(error))
    if model.base_kind.value == "diff_drive":
        for what, value, unit, option in (
            ("track", found.track, "m", given.track),
            ("wheel radius", found.wheel_radius, "m", given.wheel_radius),
            ("speed of a wheel's rim", float(found.drive_speed[0]), "m/s", given.wheel_speed),
        ):
            rows.append((what, f"{value:.4g} {unit}", "URDF" if option is None else "option"))
        rows.append(("acceleration of a wheel's rim", f"{found.drive_acceleration[0]:g} m/s²", "assumed"))
    elif model.base_kind.value == "omni":
        by = "assumed: --base-speed gives it" if given.base_speed is None else "option"
        rows.append(("speed x, y, yaw", " ".join(f"{v:g}" for v in found.drive_speed) + " m/s, rad/s", by))
        rows.append(("acceleration x, y, yaw", " ".join(f"{v:g}" for v in found.drive_acceleration), "assumed"))
    slides = sliding_joints(model)
    for k, name in enumerate(model.joint_names):
        unit = "m" if slides[k] else "rad"
        if name in unstated and name not in given.joint_speed:
            rows.append((f"speed of {name}", "not known", "stated nowhere: --joint-speed gives it"))
        else:
            by = "option" if name in given.joint_speed else "URDF"
            rows.append((f"speed of {name}", f"{found.joint_speed[k]:.4g} {unit}/s", by))
        rows.append((f"acceleration of {name}", f"{found.joint_acceleration[k]:g} {unit}/s²", "assumed"))
    return CardSection(title, columns, tuple(rows), "what drives and trajectories are timed by")
