"""An environment with the wheels of ROS 2, beside that of the tests, which stays free of their start-up hook."""

from __future__ import annotations

import os
import subprocess
import sys
import sysconfig
from pathlib import Path

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "build" / f"ros2-{sys.version_info.major}.{sys.version_info.minor}"
WHEELS = ("ros-rclpy", "ros-rmw-fastrtps-cpp", "ros-common-interfaces")
_LONGEST = 300.0  # [s]


def python() -> tuple[Path, str]:
    """The interpreter with ROS 2, made where there is none yet; or why there is none."""
    found, done = FOLDER / "bin" / "python", FOLDER / "done"
    if done.exists():
        return found, ""
    if sys.platform != "linux" or os.uname().machine != "x86_64":
        return found, f"ROS 2 has no wheels for {sys.platform} on {os.uname().machine}"
    # By the pip that is there, and nothing compiled of which little is imported: that takes a third of the time.
    subprocess.run([sys.executable, "-m", "venv", "--clear", "--without-pip", FOLDER], check=True)
    pip = [sys.executable, "-m", "pip", "--python", found, "install", "--quiet", "--no-compile"]
    try:
        got = subprocess.run(
            [*pip, "--only-binary", ",".join(WHEELS), *WHEELS], capture_output=True, text=True, timeout=_LONGEST,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return found, f"the wheels of ROS 2 have not come within {_LONGEST:g} s"
    if got.returncode:
        return found, f"the wheels of ROS 2 are not to be had: {got.stderr.strip().splitlines()[-1]}"
    own = FOLDER / "lib" / f"python{sys.version_info.major}.{sys.version_info.minor}" / "site-packages"
    mine = sysconfig.get_path("purelib")
    # All else is what the tests run with, after what is of ROS.
    (own / "zz_tests.pth").write_text(f"import site; site.addsitedir({mine!r})\n{ROOT / 'src'}\n{ROOT}\n")
    done.write_text("")
    return found, ""
