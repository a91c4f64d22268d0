"""Commands for browsers, as (key, MessagePack bytes), and the HTML page that executes them.

A key is ``path + NUL + kind``. A later command with the same key replaces an earlier one, so that a slow
receiver (a browser, a pipe) may skip to the newest. Kinds ``object``, ``property …``, ``delete`` and ``animation`` are
meshcat's own commands; ``transforms``, ``instances``, ``hud``, ``captions``, ``camera``, ``names``, ``labels``,
``draggable`` and ``steerable`` are read by the scripts in ``web``.

The page is meshcat's script plus those: ``page.js`` adds a better background, lights and camera, objects that are drawn
many times at once, a card with numbers and legend, and buttons for playing; ``controls.js`` adds buttons that show and
hide things, names and labels; ``drag.js`` makes things draggable in a live page, and ``steer.js`` is for driving in it.
"""

from __future__ import annotations

import base64
import html
import importlib.util
import itertools
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from umsgpack import Ext, packb

from elastic_strips.arrays import Array, ArrayLike, Document, Indices, Mask

from .geometry import Floats, MeshData
from .server import Command, CommandLog

_WEB = Path(__file__).parent / "web"
_UINT8, _UINT16, _FLOAT32 = 0x12, 0x14, 0x17
_STEPS_PER_METRE = 2.0**16  # steps in a metre
_LARGE_MESH = 20.0  # [m]: places in a larger mesh are sent as they are
_serial = itertools.count()


def key(path: str, kind: str) -> str:
    """Return the key of a command."""
    return f"{path}\0{kind}"


def _floats(array: ArrayLike) -> Ext:
    """Pack numbers as a Float32Array, rounded to 15 µm: invisible digits are not worth their bytes."""
    rounded = np.rint(np.asarray(array, dtype=float) * _STEPS_PER_METRE) / _STEPS_PER_METRE
    return Ext(_FLOAT32, np.ascontiguousarray(rounded, dtype="<f4").tobytes())


def material(
    color: ArrayLike = (1.0, 1.0, 1.0),
    *,
    opacity: float = 1.0,
    lit: bool = True,
    roughness: float = 0.62,
    hides: bool = True,
    hidden: bool = True,
) -> Document:
    """Describe a three.js material.

    Args:
        color: Linear RGB in [0, 1].
        opacity: 1 is solid.
        lit: Whether light shades it.
        roughness: From 0, a mirror, to 1; where it is lit.
        hides: Whether it hides things behind it; a translucent one need not.
        hidden: Whether what stands before it hides it; where not, it has to be translucent, which is drawn last.
    """
    r, g, b = (round(255 * float(c)) for c in np.asarray(color))
    data: Document = {
        "type": "MeshStandardMaterial" if lit else "MeshBasicMaterial",
        "color": r << 16 | g << 8 | b,
        "opacity": float(opacity),
        "transparent": opacity < 1.0,
        "side": 2,
        "depthWrite": hides,
        **({} if hidden else {"depthTest": False}),
    }
    return data | {"roughness": roughness, "metalness": 0.05} if lit else data


def mesh(
    path: str,
    data: MeshData,
    look: Document,
    *,
    instances: int | None = None,
    cast: bool = True,
    veiled: bool = False,
    steps: int = 65535,
) -> Command:
    """Put a mesh at a path, in the place of what was there before.

    Args:
        path: Place in the tree of the scene.
        data: The triangles.
        look: A return value of ``material``.
        instances: If given, the mesh is drawn at the poses of an ``instances`` command, with room for this many at
            first.
        cast: Whether it casts and receives shadows.
        veiled: Whether a translucent mesh hides its own inside (with ``instances`` only).
        steps: How finely places are sent, as a share of the mesh's size.
    """
    order, index = _in_order(data.faces)
    attributes = {"position": _places(data.vertices[order], steps)}
    if data.colors is not None:
        colors = np.rint(255 * np.clip(data.colors[order], 0, 1))
        attributes["color"] = _attribute(colors, _UINT8, "u1", normalized=True)
    identity = f"es-{next(_serial)}"
    buffers = {"attributes": attributes, "index": index}
    geometry = {"uuid": identity + "-g", "type": "BufferGeometry", "data": buffers}
    look = {**look, "uuid": identity + "-m", "vertexColors": data.colors is not None}
    body: Document = {
        "uuid": identity,
        "type": "Mesh",
        "geometry": geometry["uuid"],
        "material": look["uuid"],
        "matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1],
        "userData": {"shadow": cast, "veiled": veiled},
    }
    if instances is not None:
        none = {"itemSize": 16, "type": "Float32Array", "array": _floats(np.zeros(16 * max(instances, 1)))}
        body |= {"type": "InstancedMesh", "count": max(instances, 1), "instanceMatrix": none, "frustumCulled": False}
    content = {
        "metadata": {"version": 4.5, "type": "Object"},
        "geometries": [geometry],
        "materials": [look],
        "object": body,
    }
    return key(path, "object"), packb({"type": "set_object", "path": path, "object": content})


def instances(
    path: str, matrices: ArrayLike, colors: ArrayLike | None = None, *, names: Sequence[str] | None = None
) -> Command:
    """Place the instances of a mesh: (K, 16) column-major matrices, (K, 3) linear colours, and their names."""
    data: Document = {"type": "instances", "path": path, "matrices": _floats(matrices)}
    if colors is not None:
        data["colors"] = _floats(colors)
    if names is not None:
        data["names"] = list(names)
    return key(path, "instances"), packb(data)


def rods(path: str, points: Array, colors: ArrayLike, radius: float) -> Command:
    """Place a rod's instances between neighbouring points (N, C, 3) [m] of C lines, of colours (C, 3).

    The page makes the matrices: there are many lines, and a point is a fifth of a matrix.
    """
    lines = np.swapaxes(points, 0, 1)
    data: Document = {"type": "rods", "path": path, "points": _floats(lines), "nodes": len(points), "radius": radius}
    return key(path, "instances"), packb({**data, "colors": _floats(colors)})


def points(path: str, places: ArrayLike, color: ArrayLike) -> Command:
    """Draw points (n, 3) [m] of one linear colour, in the place of those that were there."""
    return _plain("points", path, places, color)


def lines(path: str, ends: ArrayLike, color: ArrayLike) -> Command:
    """Draw lines (n, 2, 3) [m] of one linear colour, in the place of those that were there."""
    return _plain("lines", path, ends, color)


def _plain(kind: str, path: str, places: ArrayLike, color: ArrayLike) -> Command:
    look = [float(c) for c in np.asarray(color)]
    return key(path, "object"), packb({"type": kind, "path": path, "places": _floats(places), "color": look})


def depth(sensor: str, levels: NDArray[np.uint8], near: float, far: float) -> Command:
    """Show a picture (H, W) of bytes in the page: from 1, ``near`` [m], to 254, ``far``; 0 is no answer, 255 nothing.

    One of no pixels takes the sensor's picture away.
    """
    pixels = Ext(_UINT8, np.ascontiguousarray(levels, dtype=np.uint8).tobytes())
    data = {"type": "depth", "sensor": sensor, "columns": levels.shape[1], "pixels": pixels, "near": near, "far": far}
    return key("", f"depth {sensor}"), packb(data)


def transforms(group: str, paths: Sequence[str], matrices: ArrayLike) -> Command:
    """Move many objects at once: (K, 16) column-major matrices."""
    return key(group, "transforms"), packb({"type": "transforms", "paths": list(paths), "matrices": _floats(matrices)})


def names(group: str, paths: Sequence[str], texts: Sequence[str]) -> Command:
    """Name objects; the page shows the names where the mouse rests on them."""
    return key(group, "names"), packb({"type": "names", "paths": list(paths), "names": list(texts)})


def labels(group: str, texts: Sequence[str], points: ArrayLike) -> Command:
    """Write texts at points (K, 3) [m], in the place of the group's earlier ones."""
    return key(group, "labels"), packb(
        {"type": "labels", "group": group, "texts": list(texts), "points": _floats(points)}
    )


def draggable(*, obstacles: bool, goal: bool, hand: bool) -> Command:
    """Whether obstacles, the ring at the goal, and the ball at its hand can be dragged."""
    return key("", "draggable"), packb({"type": "draggable", "obstacles": obstacles, "goal": goal, "hand": hand})


def steerable(*, on: bool, slides: bool) -> Command:
    """Whether somebody can steer with keys and a stick, and whether the base can move sideways."""
    return key("", "steerable"), packb({"type": "steerable", "on": on, "slides": slides})


def visible(path: str, value: bool) -> Command:
    """Show or hide everything at and below a path."""
    return key(path, "property visible"), packb(
        {"type": "set_property", "path": path, "property": "visible", "value": bool(value)}
    )


def delete(path: str) -> Command:
    """Remove everything at and below a path."""
    return key(path, "delete"), packb({"type": "delete", "path": path})


def hud(content: Mapping[str, object]) -> Command:
    """Fill the card in the corner: title, chip, rows, a note (optional), legend."""
    return key("", "hud"), packb({"type": "hud", **content})


def captions(times: ArrayLike, cards: Sequence[Document], common: Document) -> Command:
    """Fill the card with what is ``common`` to all of ``cards`` (K) and each of them from its time (K,) [s] on."""
    data = {"type": "captions", "times": _floats(times), "cards": list(cards), "common": common}
    return key("", "captions"), packb(data)


def camera(points: ArrayLike, direction: ArrayLike) -> Command:
    """Look against ``direction`` so that all ``points`` (K, 3) [m] are in the picture."""
    return key("", "camera"), packb({"type": "camera", "points": _floats(points), "direction": _floats(direction)})


@dataclass(frozen=True, slots=True)
class Track:
    """How one property of an object changes: ``values`` at ``times`` (in frames), of a three.js type."""

    path: str
    property: str
    type: str
    times: ArrayLike
    values: NDArray[np.generic]


def motion_tracks(path: str, matrices: Floats) -> list[Track]:
    """Position and orientation of an object in every frame: (F, 16) column-major matrices."""
    from scipy.spatial.transform import Rotation  # late: slow to import

    times, T = np.arange(len(matrices)), np.swapaxes(matrices.reshape(-1, 4, 4), -1, -2)
    quaternion = Rotation.from_matrix(T[:, :3, :3]).as_quat()
    flips = np.cumprod(np.where(np.einsum("ij,ij->i", quaternion[1:], quaternion[:-1]) < 0.0, -1.0, 1.0))
    quaternion[1:] *= flips[:, None]
    return [
        Track(path, "position", "vector3", times, T[:, :3, 3]),
        Track(path, "quaternion", "quaternion", times, quaternion),
    ]


def visible_track(path: str, there: Mask) -> Track:
    """Show an object in the frames (F,) in which it is ``there``, and hide it in the others.

    The track is as long as the others that have F frames, because each repeats by itself.
    """
    times = np.union1d(np.flatnonzero(np.diff(there)) + 1, [0, len(there) - 1])
    return Track(path, "visible", "bool", times, there[times])


def count_track(path: str, count: NDArray[np.intp]) -> Track:
    """Draw the first ``count`` (F,) instances of an object in each frame."""
    return Track(path + "/<object>", "count", "number", np.arange(len(count)), count)


def animation(tracks: Sequence[Track], fps: float) -> Command:
    """Play tracks, again and again."""
    clips = []
    for track in tracks:
        values = track.values.tolist() if track.values.dtype == bool else _floats(track.values)  # three.js: true, not 1
        one = {"name": "." + track.property, "type": track.type, "times": _floats(track.times), "values": values}
        clip = {"fps": fps, "name": track.path + track.property, "tracks": [one]}
        clips.append({"path": track.path, "clip": clip})
    options = {"play": True, "repetitions": 1_000_000}
    return key("", "animation"), packb({"type": "set_animation", "animations": clips, "options": options, "path": ""})


def no_animation() -> Command:
    """Stop what plays and take its controls away."""
    return key("", "animation"), packb({"type": "no_animation"})


def columns(T: ArrayLike) -> Floats:
    """Turn (…, 4, 4) matrices into (…, 16) column-major rows."""
    T = np.asarray(T, dtype=np.float32)
    return np.swapaxes(T, -1, -2).reshape(*T.shape[:-2], 16)


_ARRAYS = {_UINT8: "Uint8Array", _UINT16: "Uint16Array", _FLOAT32: "Float32Array"}


def _attribute(values: NDArray[np.generic], code: int, dtype: str, *, normalized: bool = False) -> Document:
    packed = Ext(code, np.ascontiguousarray(values).astype(dtype).tobytes())
    return {"itemSize": values.shape[1], "type": _ARRAYS[code], "array": packed, "normalized": normalized}


def _in_order(faces: NDArray[np.uint32]) -> tuple[Indices, Document]:
    """The vertices (V,) in the order of their first use, and the faces (F, 3) as whole numbers that compress well.

    Each says how far behind the next vertex it is that was not used yet; 0 is that one. Lowest bytes first, of all.
    """
    flat = faces.ravel()
    used, first, inverse = np.unique(flat, return_index=True, return_inverse=True)
    rank = np.argsort(first)
    place = np.empty(len(used), dtype=np.int64)
    place[rank] = np.arange(len(used))
    renamed = place[inverse.reshape(-1)]
    behind = np.maximum.accumulate(np.concatenate(([-1], renamed)))[:-1] + 1 - renamed
    planes = np.concatenate([(behind >> shift) & 255 for shift in (0, 8, 16)]).astype(np.uint8)
    data: Document = {"itemSize": 1, "type": "Uint32Array", "behind": Ext(_UINT8, planes.tobytes()), "array": []}
    return used[rank].astype(np.intp), data


def _places(vertices: Floats, steps: int) -> Document:
    """Pack places (V, 3) [m] as whole numbers, ``steps`` for the mesh's size, or as they are in a large mesh."""
    if not len(vertices) or not 0.0 < float(np.ptp(vertices, axis=0).max()) <= _LARGE_MESH:
        return _attribute(vertices, _FLOAT32, "<f4")
    low = vertices.min(axis=0)
    unit = float(np.ptp(vertices, axis=0).max()) / steps
    return _attribute(np.rint((vertices - low) / unit), _UINT16, "<u2") | {"low": low.tolist(), "unit": unit}


# The page


@cache
def _text(name: str) -> str:
    return "\n" + (_WEB / name).read_text(encoding="utf-8")


@cache
def _meshcat_script() -> str:
    """Read meshcat's bundle without importing meshcat, which would import half of Jupyter."""
    spec = importlib.util.find_spec("meshcat")
    if spec is None or not spec.submodule_search_locations:
        raise ModuleNotFoundError("meshcat is not installed; it comes with elastic-strips: pip install meshcat")
    return (Path(spec.submodule_search_locations[0]) / "viewer" / "dist" / "main.min.js").read_text(encoding="utf-8")


def _page(title: str, scripts: str) -> str:
    return f"""<!DOCTYPE html>
<html lang="en">
<head><meta charset="utf-8"><meta name="viewport" content="width=device-width"><link rel="icon" href="data:,">
<title>{html.escape(title)}</title>
<style>{_text("page.css")}</style></head>
<body>
<div id="meshcat-pane"></div>
<div id="es-card"></div>
<div id="es-bar" role="toolbar" aria-label="what is shown"></div>
<div id="es-labels"></div><div id="es-tip"></div><div id="es-toast" role="status"></div>
<div id="es-hint"></div><div id="es-depth"></div>
<div id="es-play"><button id="es-toggle" title="play or pause"></button>
<input id="es-time" type="range" min="0" max="1" step="0.01" value="0" aria-label="time"><output id="es-now"></output>
<select id="es-speed" title="speed" aria-label="speed"></select></div>
{scripts}
</body>
</html>
"""


def live_page(title: str) -> str:
    """Return the page that gets the picture from its server."""
    ours = "".join(map(_text, ("page.js", "controls.js", "sight.js", "keys.js", "drag.js", "steer.js", "live.js")))
    return _page(title, f"<script>{_meshcat_script()}</script>\n<script>{ours}</script>")


def static_page(title: str, log: CommandLog) -> str:
    """Return a standalone page with the picture inside; it needs no server and no network.

    Scripts and picture are compressed: a page is to be small enough for a notebook.
    """
    parts = {"es-meshcat": _packed_script(), "es-page": _packed_page(), "es-data": _packed(log.batch())}
    blocks = (f'<script id="{name}" type="application/octet-stream">{part}</script>' for name, part in parts.items())
    return _page(title, "\n".join((*blocks, f"<script>{_text('standalone.js')}</script>")))


def _packed(data: bytes) -> str:
    return base64.b64encode(zlib.compress(data, 9)).decode()


@cache
def _packed_script() -> str:
    return _packed(_meshcat_script().encode())


@cache
def _packed_page() -> str:
    lines = "".join(map(_text, ("page.js", "controls.js", "sight.js", "keys.js"))).splitlines()
    return _packed("\n".join(line for line in lines if not line.lstrip().startswith("//")).encode())


def inline_frame(page: str) -> str:
    """Wrap a standalone page for a notebook."""
    source = page.replace("&", "&amp;").replace('"', "&quot;")
    return f'<iframe srcdoc="{source}" style="width: 100%; height: 480px; border: 0; border-radius: 8px"></iframe>'
