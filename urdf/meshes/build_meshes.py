"""Builds the Silvermate's visual meshes (OBJ with vertex normals, metres) next to this file.

Run `python urdf/meshes/build_meshes.py`; needs numpy and scipy. The output is deterministic. Every mesh is
expressed in the frame of the URDF link that shows it and has one colour, which the URDF assigns.
"""

from pathlib import Path

import numpy as np
from scipy.interpolate import PchipInterpolator
from shapes import (
    Z_TO_X,
    Z_TO_Y,
    Mesh,
    band,
    box,
    fillet,
    limb,
    merge,
    moved,
    patch,
    revolve,
    rings,
    sphere,
    superellipse,
    write_obj,
)

OUT = Path(__file__).resolve().parent


def write(name: str, mesh: Mesh) -> None:
    write_obj(OUT / f"{name}.obj", mesh)


# --- the base: origin on the floor between the wheels -------------------------------------------------------

SHELL = fillet(
    [
        (0.150, 0.172, 0),
        (0.262, 0.172, 0.004),
        (0.262, 0.262, 0.0),
        (0.262, 0.300, 0.045),
        (0.200, 0.338, 0.06),
        (0.118, 0.344, 0),
    ],
    6,
)


def base_radius(z: np.ndarray) -> np.ndarray:
    """Radius of the upper shell's outside at height z."""
    p = np.array([q for q in SHELL if q[1] >= 0.1735])
    return np.interp(z, p[:, 1], p[:, 0])


def base_surface(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    r = base_radius(v)
    return np.stack([r * np.cos(u), r * np.sin(u), v], -1)


def skirt_surface(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    return np.stack([0.250 * np.cos(u), 0.250 * np.sin(u), v], -1)


def build_base() -> None:
    write("base_shell", revolve(SHELL, 56))
    # dark skirt under the shell, cut flat at both sides so that the wheels show
    t = np.arange(72) * 2 * np.pi / 72
    levels = []
    for r, z in [(0.225, 0.034), (0.246, 0.045), (0.250, 0.060), (0.250, 0.150), (0.240, 0.1725)]:
        y = r * np.sin(t)
        levels.append(np.c_[r * np.cos(t), np.clip(y, -0.172, 0.172), np.full(72, z)])
    write("base_skirt", rings(np.array(levels)))
    # light ring above the bumper line, laser slot in front, sonar and infrared windows
    write(
        "base_trim",
        revolve(
            fillet([(0.24, 0.1765, 0), (0.2645, 0.1765, 0.001), (0.2645, 0.1845, 0.001), (0.24, 0.1845, 0)], 2), 56
        ),
    )
    write("base_laser", band(base_surface, (0.0, 0.250), (1.35, 0.018), 0.0025, 56))
    sonars = [
        patch(base_surface, (k * np.pi / 6, 0.2105), (0.013 / 0.262, 0.013), 0.0030, 2.0, 14, 1) for k in range(12)
    ]
    write("base_sonars", merge(*sonars))
    low = [patch(skirt_surface, (a, 0.105), (0.020 / 0.25, 0.010), 0.002, 3.0, 16, 1) for a in IR_ANGLES]
    write("base_ir", merge(*low))


IR_ANGLES = np.deg2rad([40.0, -40.0, 140.0, -140.0])


def build_wheel() -> None:
    tyre = fillet(
        [
            (0.058, -0.019, 0),
            (0.073, -0.019, 0.0),
            (0.0797, -0.011, 0.006),
            (0.0797, 0.011, 0.006),
            (0.073, 0.019, 0),
            (0.058, 0.019, 0),
        ],
        4,
    )
    write("wheel_tyre", moved(revolve(tyre, 36), axes=Z_TO_Y))
    disc = revolve([(0.0605, -0.0175), (0.0605, 0.0175)], 40)
    hub = revolve(fillet([(0.020, -0.020, 0), (0.020, 0.020, 0.003), (0.001, 0.020, 0)], 3), 18)
    spokes = []
    for a in np.arange(5) * 2 * np.pi / 5:
        turn = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
        spokes.append(moved(box((0.040, 0.014, 0.0385), 0.002, (0.036, 0, 0)), axes=turn))
    write("wheel_rim", moved(disc, axes=Z_TO_Y))
    write("wheel_hub", moved(merge(hub, *spokes), axes=Z_TO_Y))


# --- body: origin on the base's top --------------------------------------------------------------------------

BODY = np.array(  # z, half depth x, half width y, exponent
    [
        [0.000, 0.120, 0.120, 2.0],
        [0.030, 0.108, 0.110, 2.0],
        [0.120, 0.096, 0.100, 2.1],
        [0.300, 0.096, 0.103, 2.3],
        [0.420, 0.103, 0.113, 2.6],
        [0.540, 0.111, 0.124, 3.0],
        [0.650, 0.112, 0.127, 3.2],
        [0.710, 0.107, 0.122, 3.1],
        [0.750, 0.095, 0.110, 2.8],
        [0.776, 0.074, 0.086, 2.5],
        [0.787, 0.052, 0.058, 2.2],
    ]
)
_body = PchipInterpolator(BODY[:, 0], BODY[:, 1:], axis=0)


def body_surface(u: np.ndarray, v: np.ndarray, grow: float = 0.0) -> np.ndarray:
    a, b, p = np.moveaxis(_body(v), -1, 0)
    x, y = superellipse(u, a + grow, b + grow, p)
    return np.stack([x, y, v + 0.0 * u], -1)


def loft(z: np.ndarray, n: int, grow: float = 0.0) -> Mesh:
    t = np.arange(n) * 2 * np.pi / n
    return rings(np.array([body_surface(t, np.full(n, h), grow) for h in z]))


def build_body() -> None:
    z = np.r_[0, 0.015, 0.03, 0.06, np.linspace(0.12, 0.60, 8), np.linspace(0.65, 0.787, 12)]
    write("body_shell", loft(z, 52))
    belt = merge(*(loft(np.array([h, h + w]), 52, g) for h, w, g in [(0.372, 0.010, 0.0018)]))
    base_collar = loft(np.array([0.004, 0.016]), 52, 0.0020)
    back = patch(body_surface, (np.pi, 0.20), (0.55, 0.13), 0.0025, 6.0, 32, 4)
    write("body_trim", merge(belt, base_collar))
    screen = patch(body_surface, (0.0, 0.590), (0.86, 0.098), 0.003, 5.0, 44, 6)
    front_ir = patch(body_surface, (0.0, 0.16), (0.26, 0.010), 0.002, 3.0, 24, 3)
    rear_ir = patch(body_surface, (np.pi, 0.44), (0.26, 0.010), 0.002, 3.0, 24, 3)
    write("body_glass", merge(screen, back, front_ir, rear_ir))
    # something friendly on the screen: three bars of a status display
    bars = [
        band(body_surface, (0.0, h), (w, 0.0045), 0.0045, 24) for h, w in [(0.615, 0.50), (0.590, 0.34), (0.565, 0.20)]
    ]
    write("body_display", merge(*bars))
    # shoulder flange on the right, closed cover where a second arm would sit on the left
    flange = revolve(fillet([(0.060, 0.104, 0), (0.060, 0.134, 0.006), (0.02, 0.134, 0)], 4), 32)
    flip = Z_TO_Y @ np.diag([1.0, -1.0, -1.0])
    right = moved(flange, (0.06, 0, 0.64), flip)
    neck_ring = moved(revolve(fillet([(0.052, 0.770, 0), (0.052, 0.789, 0.004), (0.02, 0.789, 0)], 3), 28))
    write("body_metal", merge(right, neck_ring))
    cap = revolve(fillet([(0.050, 0.10, 0), (0.050, 0.1335, 0.008), (0.001, 0.137, 0)], 4), 32)
    write("body_cap", moved(cap, (0.03, 0, 0.64), Z_TO_Y))


# --- head: origin at the foot of the neck ---------------------------------------------------------------------

HEAD_C, HEAD_H = np.array([0.004, 0.0, 0.200]), np.array([0.102, 0.110, 0.120])
P_XY, P_Z = 2.35, 2.5


def head_surface(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Superellipsoid; u azimuth, v elevation [rad]."""
    cv, sv = np.cos(v), np.sin(v)
    ring = np.abs(cv) ** (2 / P_Z)
    x, y = superellipse(u, HEAD_H[0] * ring, HEAD_H[1] * ring, np.full_like(ring, P_XY))
    z = HEAD_H[2] * np.sign(sv) * np.abs(sv) ** (2 / P_Z)
    return np.stack([x, y, z], -1) + HEAD_C


def build_head() -> None:
    n = 40
    t = np.arange(n) * 2 * np.pi / n
    # denser towards the poles, where the superellipsoid bends
    lat = np.pi / 2 * np.sin(np.linspace(-np.pi / 2, np.pi / 2, 23) * 0.985)
    write("head_shell", rings(np.array([head_surface(t, np.full(n, h)) for h in lat])))
    neck = revolve([(0.042, -0.004), (0.038, 0.02), (0.038, 0.05), (0.046, 0.085), (0.05, 0.10)], 32)
    write("head_neck", neck)
    write("head_visor", patch(head_surface, (0.0, 0.10), (0.95, 0.50), 0.0025, 3.6, 44, 7))
    eyes = [patch(head_surface, (s * 0.40, 0.17), (0.130, 0.155), 0.0042, 2.2, 22, 3) for s in (-1, 1)]
    mouth = smile(0.0, -0.16, 0.26, 0.10, 0.020)
    write("head_eyes", merge(*eyes, mouth))
    ear = revolve(
        fillet(
            [(0.034, 0.088, 0), (0.034, 0.1125, 0.005), (0.018, 0.1125, 0.002), (0.016, 0.110, 0), (0.001, 0.110, 0)], 3
        ),
        26,
    )
    flip = Z_TO_Y @ np.diag([1.0, -1.0, -1.0])
    write("head_ears", merge(moved(ear, (0.0, 0, 0.205), Z_TO_Y), moved(ear, (0.0, 0, 0.205), flip)))


def smile(u0: float, v0: float, half: float, sag: float, width: float) -> Mesh:
    """Curved strip on the head's front."""
    s = np.linspace(-1, 1, 17)
    u = u0 + half * s
    mid = v0 + sag * (s**2 - 0.5)
    w = width * np.sqrt(np.clip(1.02 - s**2, 0, 1))
    rows = []
    for v in (mid + w, mid - w):
        p = head_surface(u, v)
        d = p - HEAD_C
        rows.append(p + 0.0045 * d / np.linalg.norm(d, axis=1, keepdims=True))
    v = np.vstack(rows)
    k = np.arange(16)
    return v, np.vstack([np.c_[k, k + 17, k + 18], np.c_[k, k + 18, k + 1]])


# --- arm: link origins at the joints, the arm hangs along -z at zero ----------------------------------------


def build_arm() -> None:
    # 1: shoulder motor beside the body, and the ball of the shoulder
    drum = fillet([(0.050, 0.0, 0), (0.056, 0.006, 0.003), (0.056, 0.050, 0.012), (0.040, 0.066, 0)], 5)
    # along -y from the flange (y = +0.084) towards the ball
    flip = Z_TO_Y @ np.diag([1.0, -1.0, -1.0])
    write("arm_1_shell", moved(revolve(drum, 32), (0, 0.084, 0), flip))
    ring = fillet([(0.05, 0.020, 0), (0.0574, 0.020, 0.001), (0.0574, 0.027, 0.001), (0.05, 0.027, 0)], 2)
    write("arm_1_trim", moved(revolve(ring, 32), (0, 0.084, 0), flip))
    write("arm_1_ball", sphere(0.052, 30))
    # 2: shoulder cap under the ball, with the roll bearing's collar
    write("arm_2_collar", revolve([(0.047, -0.121), (0.047, -0.113)], 30))
    write(
        "arm_2_shell",
        revolve(
            fillet(
                [
                    (0.040, -0.114, 0),
                    (0.050, -0.114, 0.004),
                    (0.0535, -0.060, 0.02),
                    (0.050, -0.030, 0.01),
                    (0.036, -0.022, 0),
                ],
                4,
            ),
            32,
        ),
    )
    # 3: upper arm, tapering to the elbow
    write(
        "arm_3_shell",
        revolve(
            fillet(
                [
                    (0.034, -0.300, 0),
                    (0.0425, -0.288, 0.008),
                    (0.0435, -0.250, 0.05),
                    (0.0488, -0.160, 0.06),
                    (0.0485, -0.126, 0.004),
                    (0.030, -0.1225, 0),
                ],
                4,
            ),
            32,
        ),
    )
    write(
        "arm_3_trim",
        revolve(
            fillet([(0.04, -0.150, 0), (0.0497, -0.150, 0.001), (0.0497, -0.141, 0.001), (0.04, -0.141, 0)], 2), 32
        ),
    )
    # 4: elbow ball with side caps, forearm's upper half
    write("arm_4_ball", merge(sphere(0.046, 28), revolve([(0.041, -0.139), (0.041, -0.130)], 28)))
    cap = revolve(fillet([(0.024, 0.03, 0), (0.024, 0.0475, 0.004), (0.001, 0.0475, 0)], 3), 22)
    write("arm_4_trim", merge(moved(cap, axes=Z_TO_Y), moved(cap, axes=flip)))
    write(
        "arm_4_shell",
        revolve(
            fillet(
                [
                    (0.036, -0.132, 0),
                    (0.0445, -0.132, 0.004),
                    (0.048, -0.080, 0.04),
                    (0.042, -0.030, 0.01),
                    (0.030, -0.024, 0),
                ],
                4,
            ),
            32,
        ),
    )
    # 5: forearm's lower half, tapering to the wrist
    write(
        "arm_5_shell",
        revolve(
            fillet(
                [
                    (0.024, -0.098, 0),
                    (0.034, -0.090, 0.006),
                    (0.0365, -0.060, 0.04),
                    (0.0435, -0.016, 0.03),
                    (0.0430, -0.006, 0.003),
                    (0.030, -0.005, 0),
                ],
                4,
            ),
            32,
        ),
    )
    write(
        "arm_5_trim",
        revolve(
            fillet([(0.03, -0.083, 0), (0.0375, -0.083, 0.001), (0.0368, -0.075, 0.001), (0.03, -0.075, 0)], 2), 32
        ),
    )
    # 6: wrist ball; 7: cuff
    write("arm_6_ball", sphere(0.037, 24))
    write(
        "arm_7_cuff",
        revolve(
            fillet([(0.030, -0.058, 0), (0.037, -0.056, 0.003), (0.036, -0.034, 0.006), (0.026, -0.027, 0)], 4), 26
        ),
    )
    build_hand()


def build_hand() -> None:
    """Palm link: origin at the palm's back, x forward towards the fingertips, z towards the thumb."""
    t = np.arange(36) * 2 * np.pi / 36
    levels = []
    for x, a, b in [
        (0.000, 0.030, 0.030),
        (0.006, 0.036, 0.036),
        (0.030, 0.039, 0.042),
        (0.052, 0.040, 0.044),
        (0.062, 0.037, 0.041),
        (0.066, 0.030, 0.034),
    ]:
        z, y = superellipse(t, np.full(36, a), np.full(36, b), np.full(36, 2.6))
        levels.append(np.c_[z, y, np.full(36, x)])
    write("palm_shell", moved(rings(np.array(levels)), axes=Z_TO_X))
    fingers, pads = [], []
    for y, side in [(0.021, -1.0), (-0.021, -1.0), (0.0, 1.0)]:
        root = np.array([0.060, y, side * 0.022])
        knee = np.array([0.098, y * 1.05, side * 0.036])
        tip = np.array([0.139, y, side * 0.025])
        fingers += [limb(root, knee, 0.0105, 0.0098), limb(knee, tip, 0.0098, 0.0082)]
        pads.append(
            limb(knee + np.array([0.012, 0, -side * 0.006]), tip + np.array([-0.002, 0, -side * 0.004]), 0.0062, 0.0060)
        )
    write("palm_fingers", merge(*fingers))
    write("palm_pads", merge(*pads))


if __name__ == "__main__":
    for stale in OUT.glob("*.obj"):
        stale.unlink()
    build_base()
    build_wheel()
    build_body()
    build_head()
    build_arm()
