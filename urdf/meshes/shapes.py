"""Solids of the visual meshes: revolved profiles, lofts, plates on a surface, and the OBJ writer."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

CREASE = np.cos(np.deg2rad(38.0))  # edges sharper than this stay sharp

Mesh = tuple[np.ndarray, np.ndarray]  # vertices (V, 3) [m], triangles (F, 3), outward
Surface = Callable[[np.ndarray, np.ndarray], np.ndarray]  # (u, v) -> points (..., 3) [m]


def merge(*meshes: Mesh) -> Mesh:
    """One mesh out of several."""
    offsets = np.cumsum([0] + [len(v) for v, _ in meshes[:-1]])
    faces = [f + o for (_, f), o in zip(meshes, offsets, strict=True)]
    return np.vstack([v for v, _ in meshes]), np.vstack(faces)


def moved(mesh: Mesh, at: tuple[float, float, float] = (0, 0, 0), axes: np.ndarray | None = None) -> Mesh:
    """The mesh rotated by `axes` (columns: images of x, y, z) and shifted to `at`."""
    v, f = mesh
    return (v if axes is None else v @ axes.T) + np.asarray(at, float), f


Z_TO_Y = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])  # revolved about z -> revolved about y
Z_TO_X = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])  # revolved about z -> revolved about x


def rings(stack: np.ndarray) -> Mesh:
    """Closed surface through horizontal rings (R, N, 3), bottom to top, counter-clockwise; both ends capped."""
    r, n, _ = stack.shape
    v = np.vstack([stack.reshape(-1, 3), stack[0].mean(0), stack[-1].mean(0)])
    i, j = np.meshgrid(np.arange(r - 1), np.arange(n), indexing="ij")
    a, b = (i * n + j).ravel(), (i * n + (j + 1) % n).ravel()
    k = np.arange(n)
    faces = [
        np.c_[a, b, b + n],
        np.c_[a, b + n, a + n],
        np.c_[(k + 1) % n, k, np.full(n, r * n)],
        np.c_[(r - 1) * n + k, (r - 1) * n + (k + 1) % n, np.full(n, r * n + 1)],
    ]
    return v, np.vstack(faces)


def revolve(profile: list[tuple[float, float]], n: int = 32) -> Mesh:
    """Solid of revolution about z; profile of (radius, z) from bottom to top."""
    t = np.arange(n) * 2 * np.pi / n
    return rings(np.array([np.c_[r * np.cos(t), r * np.sin(t), np.full(n, z)] for r, z in profile]))


def fillet(profile: list[tuple[float, float, float]], steps: int = 5) -> list[tuple[float, float]]:
    """Rounds a polyline of (radius, z, fillet radius) with arcs."""
    p = np.array(profile, float)
    out: list[tuple[float, float]] = []
    for i, (r, z, rad) in enumerate(p):
        if rad == 0.0 or i in (0, len(p) - 1):
            out.append((r, z))
            continue
        c = p[i, :2]
        u, w = p[i - 1, :2] - c, p[i + 1, :2] - c
        lu, lw = np.linalg.norm(u), np.linalg.norm(w)
        u, w = u / lu, w / lw
        half = 0.5 * np.arccos(np.clip(u @ w, -1, 1))
        cut = min(rad / np.tan(half), 0.49 * lu, 0.49 * lw)
        a, b = c + cut * u, c + cut * w
        # a quadratic Bézier is indistinguishable from an arc at this size
        out += [tuple((1 - s) ** 2 * a + 2 * s * (1 - s) * c + s**2 * b) for s in np.linspace(0, 1, steps)]
    return out


def sphere(radius: float, n: int = 28) -> Mesh:
    """Sphere about the origin."""
    t = np.linspace(-np.pi / 2, np.pi / 2, n // 2 + 1)
    return revolve([(max(radius * np.cos(s), 1e-5), radius * np.sin(s)) for s in t], n)


def box(size: tuple[float, float, float], bevel: float, at: tuple[float, float, float] = (0, 0, 0)) -> Mesh:
    """Box with rounded vertical edges and bevelled top and bottom."""
    x, y, z = (0.5 * s for s in size)
    t = np.linspace(0, np.pi / 2, 5)
    corners = [
        (x - bevel, y - bevel, 0),
        (bevel - x, y - bevel, 1),
        (bevel - x, bevel - y, 2),
        (x - bevel, bevel - y, 3),
    ]
    outline = np.array(
        [
            [cx + bevel * np.cos(s + k * np.pi / 2), cy + bevel * np.sin(s + k * np.pi / 2)]
            for cx, cy, k in corners
            for s in t
        ]
    )
    inner = outline * (1 - bevel / np.array([x, y]) * 0.9)
    levels = [(inner, -z), (outline, bevel - z), (outline, z - bevel), (inner, z)]
    return moved(rings(np.array([np.c_[o, np.full(len(o), h)] for o, h in levels])), at)


def patch(
    surface: Surface,
    at: tuple[float, float],
    half: tuple[float, float],
    lift: float,
    power: float = 4.0,
    n: int = 32,
    r: int = 5,
) -> Mesh:
    """Plate with a superelliptic outline on a surface around (u, v) = `at`, raised by `lift` [m] and with a rim."""
    t = np.arange(n) * 2 * np.pi / n
    c, s = np.cos(t), np.sin(t)
    rim = np.c_[np.sign(c) * np.abs(c) ** (2 / power), np.sign(s) * np.abs(s) ** (2 / power)]
    # the last ring is the rim, sunk below the surface
    scale = np.r_[0.0, np.linspace(0, 1, r + 1)[1:], 1.0]
    height = np.r_[np.full(r + 1, lift), -0.003]
    u = at[0] + half[0] * scale[:, None] * rim[None, :, 0]
    v = at[1] + half[1] * scale[:, None] * rim[None, :, 1]
    e = 1e-4
    du = surface(u + e, v) - surface(u - e, v)
    dv = surface(u, v + e) - surface(u, v - e)
    normal = np.cross(du, dv)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    points = surface(u, v) + height[:, None, None] * normal
    verts = np.vstack([points[0, :1], points[1:].reshape(-1, 3)])
    k = np.arange(n)
    nxt = (k + 1) % n
    faces = [np.c_[np.zeros(n, int), 1 + k, 1 + nxt]]
    for i in range(r):
        a = 1 + i * n
        faces += [np.c_[a + k, a + n + k, a + n + nxt], np.c_[a + k, a + n + nxt, a + nxt]]
    return verts, np.vstack(faces)


def band(surface: Surface, at: tuple[float, float], half: tuple[float, float], lift: float, n: int = 40) -> Mesh:
    """Long strip with round ends on a surface, raised by `lift` [m], its rim sunk below the surface."""
    s = np.sin(np.linspace(-np.pi / 2, np.pi / 2, n))
    e = 1e-4
    u = at[0] + half[0] * s
    end = (
        half[1]
        / np.linalg.norm(surface(np.array(at[0] + e), np.array(at[1])) - surface(np.array(at[0] - e), np.array(at[1])))
        * 2
        * e
        / half[0]
    )
    w = half[1] * np.sqrt(np.clip(1 - (np.clip(np.abs(s) - (1 - end), 0, None) / end) ** 2, 0.0, 1))
    rows = []
    for k, h in [(-1, -0.003), (-1, lift), (0, lift), (1, lift), (1, -0.003)]:
        v = at[1] + k * w
        normal = np.cross(surface(u + e, v) - surface(u - e, v), surface(u, v + e) - surface(u, v - e))
        rows.append(surface(u, v) + h * normal / np.linalg.norm(normal, axis=-1, keepdims=True))
    i, j = np.meshgrid(np.arange(4), np.arange(n - 1), indexing="ij")
    a = (i * n + j).ravel()
    return np.vstack(rows), np.vstack([np.c_[a, a + 1, a + n + 1], np.c_[a, a + n + 1, a + n]])


def superellipse(t: np.ndarray, a: np.ndarray, b: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Point at parameter angle t of |x/a|^p + |y/b|^p = 1."""
    c, s = np.cos(t), np.sin(t)
    return a * np.sign(c) * np.abs(c) ** (2 / p), b * np.sign(s) * np.abs(s) ** (2 / p)


def write_obj(path: Path, mesh: Mesh) -> None:
    """Writes a mesh with normals averaged over each vertex' faces, except across creases."""
    v, f = mesh
    # weld, drop degenerate triangles
    v, inverse = np.unique(np.round(v, 5), axis=0, return_inverse=True)
    f = inverse.ravel()[f]
    f = f[(f[:, 0] != f[:, 1]) & (f[:, 1] != f[:, 2]) & (f[:, 2] != f[:, 0])]
    fn = np.cross(v[f[:, 1]] - v[f[:, 0]], v[f[:, 2]] - v[f[:, 0]])
    area = np.linalg.norm(fn, axis=1)
    f, fn, area = f[area > 1e-12], fn[area > 1e-12], area[area > 1e-12]
    unit = fn / area[:, None]
    around: list[list[int]] = [[] for _ in v]
    for k, tri in enumerate(f):
        for i in tri:
            around[i].append(k)
    normals: dict[tuple[float, ...], int] = {}
    lines = []
    for k, tri in enumerate(f):
        corner = []
        for i in tri:
            near = [m for m in around[i] if unit[m] @ unit[k] > CREASE]
            nrm = fn[near].sum(0)
            key = tuple(float(x) + 0.0 for x in np.round(nrm / np.linalg.norm(nrm), 3))
            corner.append(f"{i + 1}//{normals.setdefault(key, len(normals) + 1)}")
        lines.append("f " + " ".join(corner))
    head = [f"# Silvermate visual, written by build_meshes.py\no {path.stem}"]
    head += [f"v {x:.5g} {y:.5g} {z:.5g}" for x, y, z in v + 0.0]
    head += [f"vn {x:.3g} {y:.3g} {z:.3g}" for x, y, z in normals]
    path.write_text("\n".join(head + lines) + "\n", newline="\n")


def limb(a: np.ndarray, b: np.ndarray, ra: float, rb: float) -> Mesh:
    """Tapered capsule from a to b."""
    d = b - a
    length = float(np.linalg.norm(d))
    s = np.linspace(-np.pi / 2, 0, 4)
    prof = [(max(ra * np.cos(x), 1e-5), ra * np.sin(x)) for x in s]
    prof += [(max(rb * np.cos(x), 1e-5), length + rb * np.sin(x)) for x in -s[::-1]]
    z = d / length
    y = np.array([0.0, 1.0, 0.0])
    x = np.cross(y, z)
    x /= np.linalg.norm(x)
    return moved(revolve(prof, 12), tuple(a), np.c_[x, np.cross(z, x), z])
