"""Random robots as URDF files: every planned kind of joint, branches, mimics, and shapes up to mirrored meshes.

``random_robot`` plans what others mimic: any joint of the tree may lead, before its followers or after them.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt
import trimesh
from lxml import etree

from elastic_strips.robot import RobotModel, load_robot

SHAPES = ("box", "sphere", "cylinder", "mesh")


def _text(values: npt.ArrayLike) -> str:
    return " ".join(f"{v:.9g}" for v in np.asarray(values, dtype=float).ravel())


def _origin(rng: np.random.Generator, far: float) -> str:
    return f'<origin xyz="{_text(rng.uniform(-far, far, 3))}" rpy="{_text(rng.uniform(-np.pi, np.pi, 3))}"/>'


def _wedge() -> trimesh.Trimesh:
    """A body that is its own mirror image in no plane, so that a mirrored mesh is another body."""
    corners = [[0.0, 0, 0], [1.0, 0, 0], [0, 0.8, 0], [0, 0, 0.6], [0.7, 0.4, 0.5]]
    return trimesh.Trimesh(corners).convex_hull


def _shape(rng: np.random.Generator, folder: Path, kinds: tuple[str, ...]) -> str:
    size = rng.uniform(0.03, 0.15, 3)
    kind = str(rng.choice(kinds))
    if kind == "box":
        return f'<box size="{_text(size)}"/>'
    if kind == "sphere":
        return f'<sphere radius="{size[0] / 2:.9g}"/>'
    if kind == "mesh":
        mesh = folder / "wedge.stl"
        if not mesh.exists():
            _wedge().export(mesh)
        scale = rng.uniform(0.1, 0.3, 3) * rng.choice([-1.0, 1.0], 3)
        return f'<mesh filename="{mesh.name}" scale="{_text(scale)}"/>'
    return f'<{kind} radius="{size[0] / 3:.9g}" length="{2 * size[1]:.9g}"/>'


def _limit(rng: np.random.Generator, kind: str) -> str:
    if kind == "continuous":
        return ""
    low = rng.uniform(-2.5, 0.0) if kind == "revolute" else rng.uniform(-0.3, 0.0)
    span = rng.uniform(0.3, 3.5) if kind == "revolute" else rng.uniform(0.05, 0.5)
    return f'<limit lower="{low:.9g}" upper="{low + span:.9g}" velocity="1" effort="10"/>'


def random_urdf(
    rng: np.random.Generator, folder: Path, joints: int, *, shapes: tuple[str, ...] = SHAPES, name: str = "random"
) -> Path:
    """Write a robot with ``joints`` joints to plan, besides fixed and mimicking ones and the one that those mimic (what
    looks like a wheel is not planned); returns the URDF file.

    Every third joint or so branches off further down the tree; axes are oblique; links have up to two shapes.
    """
    links = [f'<link name="link_0"><collision>{_origin(rng, 0.05)}<geometry>{_shape(rng, folder, shapes)}</geometry>'
             "</collision></link>"]  # fmt: skip
    text: list[str] = []
    moving: list[str] = []
    count = 0
    parent = 0
    while len(moving) < joints:
        count += 1
        kind = str(rng.choice(["revolute", "revolute", "continuous", "prismatic", "fixed", "mimic"]))
        if kind == "mimic" and not moving:
            kind = "revolute"
        if count > 1 and rng.random() < 0.35:
            parent = int(rng.integers(0, count))
        bodies = "".join(
            f"<collision>{_origin(rng, 0.08)}<geometry>{_shape(rng, folder, shapes)}</geometry></collision>"
            for _ in range(int(rng.choice([0, 1, 1, 1, 2])))
        )
        links.append(f'<link name="link_{count}">{bodies}</link>')
        axis = rng.normal(size=3)
        axis /= np.linalg.norm(axis)
        if rng.random() < 0.3:
            axis = np.eye(3)[rng.integers(3)] * rng.choice([-1.0, 1.0])
        made = "revolute" if kind == "mimic" else kind
        mimic = '<mimic joint="leader" multiplier="0.5" offset="0.1"/>' if kind == "mimic" else ""
        limit = _limit(rng, made) if made != "fixed" else ""
        text.append(
            f'<joint name="joint_{count}" type="{made}"><parent link="link_{parent}"/><child link="link_{count}"/>'
            f'{_origin(rng, 0.4)}<axis xyz="{_text(axis)}"/>{limit}{mimic}</joint>'
        )
        if kind not in ("fixed", "mimic"):
            moving.append(f"joint_{count}")
        parent = count
    if any("<mimic" in joint for joint in text):
        links.append('<link name="leader_link"/>')
        text.append('<joint name="leader" type="continuous"><parent link="link_0"/><child link="leader_link"/>'
                    '<axis xyz="0 0 1"/></joint>')  # fmt: skip
    path = folder / f"{name}.urdf"
    path.write_text(f'<robot name="{name}">\n' + "\n".join(links + text) + "\n</robot>\n")
    return path


def random_robot(rng: np.random.Generator, folder: Path, joints: int, base: str, *, followers: bool) -> RobotModel:
    """A robot with ``joints`` planned joints; with ``followers`` some follow one of these, where there is any."""
    if not followers or not joints:
        return load_robot(random_urdf(rng, folder, joints), base=base)
    path = random_urdf(rng, folder, joints, name="followed")
    planned = _followed(rng, path)
    return load_robot(path, base=base, joints=planned)


def _followed(rng: np.random.Generator, path: Path) -> list[str]:
    """Give a file more joints that mimic, and all of them leaders that are planned; returns the joints to plan."""
    root = etree.parse(str(path)).getroot()
    joints = {j.get("name"): j for j in root.findall("joint")}
    planned = [n for n, j in joints.items() if j.get("type") != "fixed" and j.find("mimic") is None and n != "leader"]
    mimics = [name for name, joint in joints.items() if joint.find("mimic") is not None]
    for k in range(int(rng.integers(1, 4))):  # anywhere on the way, of any place in the alphabet
        name = f"{rng.choice(['a', 'z'])}_follower_{k}"
        mimics.append(name)
        joints[name] = _inserted(root, rng, name, joints[str(rng.choice(planned))])
    done: dict[str, tuple[str, float, float]] = {}
    for name in mimics:
        joint, leader = joints[name], str(rng.choice(planned))
        for old in joint.findall("mimic") + joint.findall("limit"):
            joint.remove(old)
        around = joints[leader].get("type") == "continuous"
        kind = "continuous" if around else str(rng.choice(["revolute", "prismatic", "continuous"]))
        size = 10.0 ** rng.uniform(-1.0, 0.5) * (0.2 if kind == "prismatic" else 1.0)
        multiplier = float(rng.choice([-1, 1]) * (rng.integers(1, 3) if around else size))
        constant = float(rng.uniform(-0.3, 0.3))
        before = [n for n, (first, _, _) in done.items() if first == leader]
        direct = str(rng.choice(before)) if before and rng.random() < 0.5 else leader  # or along a chain
        _, factor, offset = done.get(direct, (leader, 1.0, 0.0))
        done[name] = leader, multiplier * factor, multiplier * offset + constant
        joint.set("type", kind)
        if kind != "continuous":  # limits that cut off some of the leader's range, or none
            own = joints[leader].find("limit")
            ends = [done[name][1] * float(own.get(end)) + done[name][2] for end in ("lower", "upper")]
            off = rng.uniform(-0.3, 0.1, 2) * abs(ends[1] - ends[0])
            limits = {"lower": min(ends) + off[0], "upper": max(ends) - off[1]}
            limits = {key: f"{value:.17g}" for key, value in limits.items()}
            etree.SubElement(joint, "limit", velocity="1", effort="10", **limits)
        etree.SubElement(joint, "mimic", joint=direct, multiplier=f"{multiplier:.17g}", offset=f"{constant:.17g}")
    path.write_bytes(etree.tostring(root))
    return planned


def _inserted(root: etree._Element, rng: np.random.Generator, name: str, joint: etree._Element) -> etree._Element:
    """A new joint, and a link with a shape before it, behind a joint."""
    child = joint.find("child")
    box = f'<collision><geometry><box size="{_text(rng.uniform(0.03, 0.1, 3))}"/></geometry></collision>'
    root.append(etree.fromstring(f'<link name="{name}_link">{box}</link>'))
    made = etree.fromstring(
        f'<joint name="{name}" type="revolute"><parent link="{name}_link"/><child link="{child.get("link")}"/>'
        f'{_origin(rng, 0.2)}<axis xyz="{_text(rng.normal(size=3))}"/></joint>'
    )
    child.set("link", f"{name}_link")
    root.append(made)
    return made
