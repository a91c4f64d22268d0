"""A robot's card: what is known about it, what is assumed, and what is not checked, on one page."""

from __future__ import annotations

import html
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pinocchio as pin

from elastic_strips.coal_shapes import ShapeKind, shape_of, vertices
from elastic_strips.errors import RobotError, plural
from elastic_strips.summary import Summary, shortened

from .blocked_joints import BlockedJoint, blocked_joints
from .collada import meant_turned, said_of_turned
from .cover import sticks_out
from .free_posture import free_posture
from .kinematics import find_frame
from .reduced import LONGEST_SLIDE
from .second_reader import differences, shape_differences
from .space import UNLIMITED_SPEED
from .unchecked_pairs import counted
from .urdf import pinocchio_geometry, pinocchio_model
from .value import RobotValue

_ENDLESS_SLIDE = 0.999 * LONGEST_SLIDE  # [m] a joint that may slide as far has no limits of its own
_ROWS_SHOWN, _CELL_WIDTH = 25, 60  # rows of a table in a terminal, and characters of a cell


@dataclass(frozen=True, slots=True)
class CardSection:
    """A table of a card.

    Attributes:
        title: its headline.
        columns: names of the columns.
        rows: the cells, as texts.
        note: a sentence about the table; empty where there is none.
    """

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    note: str = ""

    @property
    def headline(self) -> str:
        """The title, how many rows there are, and the note."""
        return f"{self.title}: {len(self.rows)}" + (f" ({self.note})" if self.note else "")

    @property
    def shown(self) -> tuple[tuple[str, ...], ...]:
        """As much of the rows as a terminal takes."""
        return tuple(tuple(shortened(cell, _CELL_WIDTH) for cell in row) for row in self.rows[:_ROWS_SHOWN])

    @property
    def more(self) -> str:
        """A line about the rows that are left out there; empty where there are none."""
        left = len(self.rows) - _ROWS_SHOWN
        return f"  … and {left} more (--json and --html have all)" if left > 0 else ""

    def text(self) -> str:
        """The table as aligned lines."""
        rows = (self.columns, *self.shown) if self.rows else ()
        widths = [max((len(row[k]) for row in rows), default=0) for k in range(len(self.columns))]
        lines = ["  ".join(("", *(c.ljust(w) for c, w in zip(row, widths, strict=True)))).rstrip() for row in rows]
        return "\n".join(["", self.headline, *lines, *([self.more] if self.more else [])])


@dataclass(frozen=True, slots=True, repr=False)
class RobotCard(Summary):
    """What is known about a robot, what is assumed, and what is not checked.

    A notebook shows it as tables; ``text()`` is for a terminal, ``document()`` for JSON.

    Attributes:
        name: the robot's name.
        base: how it moves.
        troubles: one sentence for each thing that its owner should know.
        sections: tables: joints, shapes, meshes, pairs that are not checked, frames, states, groups.
    """

    name: str
    base: str
    troubles: tuple[str, ...]
    sections: tuple[CardSection, ...]

    def section(self, title: str) -> CardSection:
        """The table of this title.

        Raises:
            KeyError: no table has this title.
        """
        if title not in self.titles:
            raise KeyError(f"no table {title!r}; there are {', '.join(self.titles)}")
        return self.sections[self.titles.index(title)]

    @property
    def titles(self) -> tuple[str, ...]:
        """Titles of the tables."""
        return tuple(section.title for section in self.sections)

    def with_section(self, section: CardSection, after: str) -> RobotCard:
        """The card with another table after that of a title."""
        at = self.titles.index(after) + 1
        return replace(self, sections=(*self.sections[:at], section, *self.sections[at:]))

    def text(self) -> str:
        """All of it as plain text; long tables are cut."""
        troubles = [f"  note: {trouble}" for trouble in self.troubles]
        return "\n".join([f"{self.name}: {self.base}", *troubles, *(section.text() for section in self.sections)])

    def document(self) -> dict[str, object]:
        """All of it, as plain values for JSON."""
        return {
            "format": "elastic-strips-robot",
            "version": 1,
            "robot": self.name,
            "base": self.base,
            "troubles": list(self.troubles),
            "tables": [
                {"title": s.title, "note": s.note, "rows": [dict(zip(s.columns, row, strict=True)) for row in s.rows]}
                for s in self.sections
            ],
        }

    def html(self) -> str:
        """All of it as the body of a page."""
        parts = [f"<h1>{html.escape(self.name)}</h1><p>{html.escape(self.base)}</p>"]
        if self.troubles:
            items = "".join(f"<li>{html.escape(trouble)}</li>" for trouble in self.troubles)
            parts.append(f'<ul class="troubles">{items}</ul>')
        for section in self.sections:
            head = "".join(f"<th>{html.escape(column)}</th>" for column in section.columns)
            rows = "".join(
                "<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in row) + "</tr>" for row in section.rows
            )
            note = f"<p>{html.escape(section.note)}</p>" if section.note else ""
            table = f"<table><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table>" if rows else ""
            opened = " open" if len(section.rows) <= _ROWS_SHOWN else ""
            parts.append(
                f"<details{opened}><summary>{html.escape(section.title)}: {len(section.rows)}</summary>{note}{table}"
                "</details>"
            )
        return "\n".join(parts)

    def _summary(self) -> dict[str, object]:
        return {"name": self.name, "base": self.base, "troubles": len(self.troubles), "tables": len(self.sections)}

    def _repr_html_(self) -> str:
        return self.html()


def robot_card(robot: RobotValue) -> RobotCard:
    """The card of a robot; see :meth:`.RobotModel.card`.

    A robot that comes from another process, or was made of Pinocchio's models, has no meshes or no file to read again:
    these parts are left out.
    """
    grown, blocked = _pieces(robot), blocked_joints(robot)
    read, other = _read_again(robot)
    sections = (
        _planned(robot, {each.joint: each.free for each in blocked}),
        _held(robot),
        grown,
        _bare(robot),
        _unchecked(robot),
        _meshes(robot),
        other,
        _frames(robot),
        _states(robot),
        _groups(robot),
    )
    files = [Path(f).name for f in (robot.urdf_path, robot.srdf_path) if f is not None]
    base = f"base {robot.base_kind.value}; {', '.join(files) or 'made of models'}"
    return RobotCard(robot.name, base, (*_troubles(robot, blocked), *read), sections)


def _troubles(robot: RobotValue, blocked: Sequence[BlockedJoint]) -> list[str]:
    found = []
    if robot.bare_links:
        found.append(
            f"{plural(len(robot.bare_links), 'link')} drawn without a collision shape, about which nothing is proven: "
            f"{', '.join(robot.bare_links)}"
        )
    found += [f"joint {joint} is {why}" for joint, why in robot.narrowed.items()]
    found += [f"joint {each.joint} is {each}" for each in blocked]
    hit = robot.self_collision(robot.home_q)
    if hit is not None:
        touching = free_posture(robot)[1]
        found.append(
            f"home collides: {hit[0]!r} and {hit[1]!r}"
            + (f"; no posture without collision was found: at best {touching} are in each other" if touching else "")
        )
    if len(robot.joint_names) > 20:
        found.append(f"{len(robot.joint_names)} joints are planned, which is many")
    return found


def _planned(robot: RobotValue, free: Mapping[str, tuple[float, float]]) -> CardSection:
    """The joints; ``free``: those of which much is blocked by their own links, and what is free [rad]."""
    rows = []
    space, model = robot.space, robot.model
    for k, name in enumerate(robot.joint_names):
        i = space.base_nv + k
        joint = model.joints[model.getJointId(name)]
        slides = joint.shortname().startswith("JointModelP")
        low, high, unit = float(space.lower[i]), float(space.upper[i]), "m" if slides else "rad"
        if not (math.isfinite(low) and math.isfinite(high)):
            limits, source = "none", "continuous"
        elif slides and low < -_ENDLESS_SLIDE and high > _ENDLESS_SLIDE:
            limits, source = f"{low:g} … {high:g} m", "assumed: none stated"
        else:
            limits, source = f"{low:.4g} … {high:.4g} {unit}", "URDF" if robot.urdf_path else "model"
            source = "its links' shapes" if name in robot.narrowed else source
            source += f"; free from {free[name][0]:.2g} to {free[name][1]:.2g}" if name in free else ""
        speed = float(model.velocityLimit[joint.idx_v])
        stated = 0.0 < speed < UNLIMITED_SPEED
        rows.append(
            (
                name,
                f"{float(space.to_coordinates(robot.home_q)[i]):.4g} {unit}",
                limits,
                source,
                f"{speed:.4g} {unit}/s" if stated else "not stated: --joint-speed gives it",
            )
        )
    return CardSection("Joints that are planned", ("joint", "home", "limits", "limits by", "speed"), tuple(rows))


def _held(robot: RobotValue) -> CardSection:
    rows = [(name, f"{value:.4g}", robot.held.get(name, "locked")) for name, value in robot.locked.items()]
    return CardSection("Joints that are held still", ("joint", "value", "why"), tuple(rows))


def _pieces(robot: RobotValue) -> CardSection:
    rows = []
    for piece in robot.geometries:
        far = None if robot.shapes is None else sticks_out(robot.model, robot.shapes, piece)
        carried = _carrier(robot, piece.joint)
        out = "not known" if far is None else f"{1e3 * far:.0f} mm"
        rows.append((piece.name, shape_of(piece.geometry)[0].value, ", ".join(piece.links), carried, out))
    rows.sort(key=lambda row: -float(row[4].split()[0]) if row[4] != "not known" else 0.0)
    return CardSection(
        "Convex pieces",
        ("piece", "kind", "links", "moved by", "reaches out of its shapes by"),
        tuple(rows),
        "the pieces that are kept apart; a piece that reaches far out of its mesh refuses more than necessary",
    )


def _carrier(robot: RobotValue, joint: int) -> str:
    """What moves the things that hang on a joint of the model."""
    return "the world" if joint == 0 else "base" if joint == 1 and robot.space.planar else str(robot.model.names[joint])


def _bare(robot: RobotValue) -> CardSection:
    return CardSection(
        "Links that are drawn and have no collision shape",
        ("link",),
        tuple((link,) for link in robot.bare_links),
        "nothing is proven about them; visual_as_collision takes their drawn shapes" if robot.bare_links else "",
    )


def _unchecked(robot: RobotValue) -> CardSection:
    rows = tuple((*pair.links, pair.why.value, pair.note) for pair in robot.unchecked_pairs)
    note = "; ".join(filter(None, (f"{len(robot.self_pairs)} are checked", counted(robot.unchecked_pairs))))
    return CardSection("Links that are not kept apart", ("one", "other", "why", "more"), rows, note)


def _meshes(robot: RobotValue) -> CardSection:
    rows: dict[tuple[str, ...], int] = {}
    for what, model in (("collision", robot.shapes), ("drawn", robot.visual_model)):
        for item in () if model is None else model.geometryObjects:
            if shape_of(item.geometry)[0] in (ShapeKind.MESH, ShapeKind.CONVEX) and "." in item.meshPath:
                points = vertices(item.geometry)
                size = np.ptp(points, axis=0) if len(points) else np.zeros(3)
                link = str(robot.model.frames[item.parentFrame].name)
                row = (
                    Path(item.meshPath).name,
                    link,
                    what,
                    " x ".join(f"{x:.3g}" for x in size),
                    f"{len(points)}",
                    " ".join(f"{x:g}" for x in item.meshScale),
                )
                rows[row] = rows.get(row, 0) + 1
    return CardSection(
        "Meshes",
        ("file", "link", "used as", "size [m]", "vertices", "scale"),
        tuple(rows),
        "sizes are those that are used, scale and the file's own unit included",
    )


def _read_again(robot: RobotValue) -> tuple[list[str], CardSection]:
    """What a second reader reads differently: as troubles, and as a table."""
    title, columns = "What another reader (yourdfpy) finds otherwise", ("difference",)
    source = robot.description
    if source is None:
        return [], CardSection(title, columns, (), "not asked: there is no URDF file")
    try:
        model = pinocchio_model(source)
        joints = differences(source, model)
        geometry = pinocchio_geometry(source, model, pin.COLLISION)
        shapes, turned = shape_differences(source, model, geometry), meant_turned(source.document, model, geometry)
    except RobotError as error:  # the files have changed since
        return [], CardSection(title, columns, (), f"not asked: {error}")
    parts = (("joints and places", joints), ("shapes", shapes))
    note = "; ".join(f"{what}: {'compared' if each is not None else 'not read by it'}" for what, each in parts)
    found = [*(joints or ()), *(shapes or ())]
    rows = tuple((each,) for each in found)
    return [*found, *([said_of_turned(turned)] if turned else ())], CardSection(title, columns, rows, note)


def _frames(robot: RobotValue) -> CardSection:
    rows = []
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, robot.home_q)
    pieces = {link for piece in robot.geometries for link in piece.links}
    for frame in robot.model.frames:
        if frame.type != pin.FrameType.BODY or find_frame(robot.model, str(frame.name)) is None:
            continue
        index = robot.model.getFrameId(frame.name, pin.FrameType.BODY)
        at = " ".join(f"{x:.3f}" for x in data.oMf[index].translation)
        joint = _carrier(robot, frame.parentJoint)
        rows.append((str(frame.name), joint, at, "" if str(frame.name) in pieces else "no collision shape"))
    return CardSection(
        "Frames", ("frame", "moved by", "at home [m]", "remark"), tuple(rows), "for sensors, hands and goals"
    )


def _states(robot: RobotValue) -> CardSection:
    rows = [(name, ", ".join(f"{j} {v:.4g}" for j, v in values.items())) for name, values in robot.states.items()]
    return CardSection("Named states", ("state", "joints"), tuple(rows))


def _groups(robot: RobotValue) -> CardSection:
    rows = [(name, ", ".join(joints)) for name, joints in robot.groups.items()]
    return CardSection("Groups", ("group", "joints"), tuple(rows))
