"""Commands: what the browser is told, as (key, MessagePack bytes).

A key is ``path + NUL + kind``. A later command with the same key makes an earlier one superfluous, so that whoever is
slow (a browser, a pipe) may skip to the newest. Kinds ``object``, ``property …``, ``delete`` and ``animation`` are
meshcat's own commands; ``transforms``, ``instances``, ``hud``, ``captions`` and ``camera`` are read by the script in
``page``.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import umsgpack
from numpy.typing import ArrayLike, NDArray

from elastic_strips.viewer.meshes import MeshData

Command = tuple[str, bytes]
_FLOAT32, _UINT32 = 0x17, 0x16
_serial = itertools.count()


def key(path: str, kind: str) -> str:
    """Return the key of a command."""
    return f"{path}\0{kind}"


def floats(array: ArrayLike) -> umsgpack.Ext:
    """Pack numbers as a Float32Array."""
    return umsgpack.Ext(_FLOAT32, np.ascontiguousarray(array, dtype="<f4").tobytes())


def material(color: ArrayLike = (1.0, 1.0, 1.0), *, opacity: float = 1.0, lit: bool = True, **more: Any) -> dict:
    """Describe a three.js material.

    Args:
        color: Linear RGB in [0, 1].
        opacity: 1 is solid.
        lit: Whether light shades it.
        **more: Further three.js material properties.
    """
    r, g, b = (round(255 * float(c)) for c in np.asarray(color))
    data: dict[str, Any] = {
        "type": "MeshStandardMaterial" if lit else "MeshBasicMaterial",
        "color": r << 16 | g << 8 | b,
        "opacity": float(opacity),
        "transparent": opacity < 1.0,
        "side": 2,
    }
    if lit:
        data |= {"roughness": 0.62, "metalness": 0.05}
    return data | more


def mesh(
    path: str,
    data: MeshData,
    look: Mapping[str, Any],
    *,
    instances: int | None = None,
    cast: bool = True,
    veiled: bool = False,
) -> Command:
    """Put a mesh at a path, in the place of what was there.

    Args:
        path: Where in the tree of the scene.
        data: The triangles.
        look: What ``material`` returned.
        instances: If given, the mesh is drawn where an ``instances`` command says; room for so many at first.
        cast: Whether it casts and receives shadows.
        veiled: Whether a translucent mesh hides its own inside (with ``instances`` only).
    """
    attributes = {"position": _attribute(data.vertices), "normal": _attribute(data.normals)}
    if data.colors is not None:
        attributes["color"] = _attribute(data.colors)
    identity = f"es-{next(_serial)}"
    geometry = {
        "uuid": identity + "-g",
        "type": "BufferGeometry",
        "data": {
            "attributes": attributes,
            "index": {
                "itemSize": 1,
                "type": "Uint32Array",
                "array": umsgpack.Ext(_UINT32, np.ascontiguousarray(data.faces, dtype="<u4").tobytes()),
                "normalized": False,
            },
        },
    }
    look = {**look, "uuid": identity + "-m", "vertexColors": data.colors is not None}
    body: dict[str, Any] = {
        "uuid": identity,
        "type": "Mesh",
        "geometry": geometry["uuid"],
        "material": look["uuid"],
        "matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1],
        "userData": {"shadow": cast, "veiled": veiled},
    }
    if instances is not None:
        none = {"itemSize": 16, "type": "Float32Array", "array": floats(np.zeros(16 * max(instances, 1)))}
        body |= {"type": "InstancedMesh", "count": max(instances, 1), "instanceMatrix": none, "frustumCulled": False}
    content = {
        "metadata": {"version": 4.5, "type": "Object"},
        "geometries": [geometry],
        "materials": [look],
        "object": body,
    }
    return key(path, "object"), _pack({"type": "set_object", "path": path, "object": content})


def instances(path: str, matrices: ArrayLike, colors: ArrayLike | None = None) -> Command:
    """Say where the instances of a mesh are: (K, 16) column-major matrices, and (K, 3) linear colours."""
    data: dict[str, Any] = {"type": "instances", "path": path, "matrices": floats(matrices)}
    if colors is not None:
        data["colors"] = floats(colors)
    return key(path, "instances"), _pack(data)


def transforms(group: str, paths: Sequence[str], matrices: ArrayLike) -> Command:
    """Move many objects at once: (K, 16) column-major matrices."""
    return key(group, "transforms"), _pack({"type": "transforms", "paths": list(paths), "matrices": floats(matrices)})


def visible(path: str, value: bool) -> Command:
    """Show or hide everything at and below a path."""
    return key(path, "property visible"), _pack(
        {"type": "set_property", "path": path, "property": "visible", "value": bool(value)}
    )


def delete(path: str) -> Command:
    """Remove everything at and below a path."""
    return key(path, "delete"), _pack({"type": "delete", "path": path})


def hud(content: Mapping[str, Any]) -> Command:
    """Fill the card in the corner: title, chip, rows, a note (optional), legend."""
    return key("", "hud"), _pack({"type": "hud", **content})


def captions(times: ArrayLike, cards: Sequence[Mapping[str, Any]], common: Mapping[str, Any]) -> Command:
    """Fill the card with what is ``common`` to all of ``cards`` (K) and each of them from its time (K,) [s] on."""
    data = {"type": "captions", "times": floats(times), "cards": [dict(c) for c in cards], "common": dict(common)}
    return key("", "captions"), _pack(data)


def camera(points: ArrayLike, direction: ArrayLike) -> Command:
    """Look against ``direction`` so that all ``points`` (K, 3) [m] are in the picture."""
    return key("", "camera"), _pack({"type": "camera", "points": floats(points), "direction": floats(direction)})


def animation(tracks: Sequence[Mapping[str, Any]], fps: float) -> Command:
    """Play tracks: each has a path, a property, a three.js type, ``times`` (in frames) and flat ``values``."""
    clips = []
    for track in tracks:
        values = np.asarray(track["values"])
        packed = values.tolist() if values.dtype == bool else floats(values)  # three.js wants true, not 1
        one = {
            "name": "." + track["property"],
            "type": track["type"],
            "times": floats(track["times"]),
            "values": packed,
        }
        clips.append(
            {"path": track["path"], "clip": {"fps": fps, "name": track["path"] + track["property"], "tracks": [one]}}
        )
    options = {"play": True, "repetitions": 1_000_000}
    return key("", "animation"), _pack({"type": "set_animation", "animations": clips, "options": options, "path": ""})


def no_animation() -> Command:
    """Stop what plays and take its controls away."""
    return key("", "animation"), _pack({"type": "no_animation"})


def columns(T: ArrayLike) -> NDArray[np.float32]:
    """Turn (…, 4, 4) matrices into (…, 16) column-major rows."""
    T = np.asarray(T, dtype=np.float32)
    return np.swapaxes(T, -1, -2).reshape(*T.shape[:-2], 16)


def _attribute(values: NDArray) -> dict[str, Any]:
    return {"itemSize": values.shape[1], "type": "Float32Array", "array": floats(values), "normalized": False}


def _pack(data: Mapping[str, Any]) -> bytes:
    return umsgpack.packb(data)
