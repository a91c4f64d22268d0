"""What is imported when: the package and the command line load what is heavy where it is used, and Ctrl-C ends imports
quietly."""

from __future__ import annotations

import importlib
import pkgutil
import subprocess
import sys
from types import ModuleType

import pytest
from cases import each, refused

import elastic_strips as es
from elastic_strips.catalogue import SCENARIOS

HEAVY = ("coal", "pinocchio", "scipy", "trimesh", "yourdfpy", "networkx", "matplotlib", "mujoco", "meshcat", "tornado")


def python(program: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    call = [sys.executable, "-c", program, *arguments]
    return subprocess.run(call, capture_output=True, text=True, timeout=120)


def loaded(program: str, *arguments: str) -> set[str]:
    """Top-level packages, and ``scipy``'s own, that are there after a program."""
    tail = "\nsys.stdout = sys.__stdout__; print('LOADED', *sorted({m for m in sys.modules if m.count('.') < 3}))"
    done = python("import sys\n" + program + tail, *arguments)
    assert done.returncode == 0, done.stderr
    return set(done.stdout.split("LOADED", 1)[1].split())


COMMAND = """
from elastic_strips.cli import main
try:
    main()
except SystemExit as end:
    assert not end.code, end.code
"""


def test_importing_the_package_loads_nothing_heavy():
    assert not loaded("import elastic_strips") & {*HEAVY, "numpy"}


def test_planning_loads_nothing_that_it_does_not_use():
    """The names of the ten-line program, asked for; loading a robot is another matter: its meshes have to be read."""
    names = loaded("import elastic_strips as es; es.plan, es.Deformer, es.read_scene, es.sim.scenarios.run_scenario")
    unused = {"matplotlib", "mujoco", "meshcat", "tornado", "ompl", "toppra", "py_trees", "rich"}
    unused |= {
        f"elastic_strips.{room}" for room in ("trajectory", "perception", "control", "viewer", "sim.closed_loop")
    }
    assert not names & unused


def test_what_runs_on_a_robot_loads_nothing_that_simulates():
    rooms = ("control", "control.tasks", "trajectory", "perception", "planning", "strip", "io", "viewer")
    names = loaded("\n".join(f"import elastic_strips.{room}" for room in rooms))
    assert "elastic_strips.trajectory" in names
    assert not {name for name in names if name.startswith("elastic_strips.sim")}
    assert "mujoco" not in names


@pytest.mark.parametrize("arguments", [["--version"], ["--help"]])
def test_the_command_line_says_who_it_is_without_numpy(arguments):
    assert not loaded(COMMAND, *arguments) & {*HEAVY, "numpy"}


def test_the_list_makes_no_scene_and_reads_no_mesh():
    names = loaded(COMMAND, "list")
    assert not names & {"matplotlib", "mujoco", "meshcat", "tornado", "elastic_strips.scene", "elastic_strips.strip"}


def test_what_is_listed_is_what_there_is():
    assert tuple(SCENARIOS) == es.sim.scenarios.scenario_names()
    assert all(es.sim.scenarios.get_scenario(name).summary == summary for name, summary in SCENARIOS.items())


@each("package", ["elastic_strips", "elastic_strips.io", "elastic_strips.sim", "elastic_strips.sim.scenarios"])
def test_names_that_load_late_are_all_there(package):
    """... and stay what they are after every module of the package has been imported."""
    module = importlib.import_module(package)
    for found in pkgutil.iter_modules(module.__path__):
        if not found.name.startswith("__"):
            importlib.import_module(f"{package}.{found.name}")
    for name in module.__all__:
        assert not isinstance(getattr(module, name), ModuleType), name
    with refused(AttributeError, "nonsense"):
        _ = module.nonsense


def test_names_can_be_completed_before_they_are_loaded():
    assert set(es.__all__) <= set(dir(es))
    done = python("import elastic_strips as es; assert {*es.__all__} <= {*dir(es)}; from elastic_strips import *; Box")
    assert done.returncode == 0, done.stderr


def test_python_m_is_the_command_line():
    done = subprocess.run([sys.executable, "-m", "elastic_strips", "--version"], capture_output=True, text=True)
    assert done.returncode == 0
    assert done.stdout.strip() == f"elastic-strips, version {es.__version__}"


ORDER = """
import sys
class Finder:
    def find_spec(self, name, path=None, target=None):
        assert name not in ("coal", "pinocchio") or "numpy" in sys.modules, name
sys.meta_path.insert(0, Finder())
import importlib
importlib.import_module(sys.argv[1])
"""


@each("package", ["collision", "robot", "scene", "strip", "planning", "control"])
def test_numpy_is_loaded_before_what_would_crash_where_that_is_interrupted(package):
    """Coal and Pinocchio load NumPy from C++, and a KeyboardInterrupt there is a segmentation fault."""
    done = python(ORDER, f"elastic_strips.{package}")
    assert done.returncode == 0, done.stderr


HOOK = """
import signal, sys
class Finder:
    def find_spec(self, name, path=None, target=None):
        if name == {module!r}:
            {act}
class Dying:
    def __del__(self):
        signal.raise_signal(signal.SIGINT)
signal.signal(signal.SIGINT, signal.default_int_handler)  # a job in the background ignores it
sys.meta_path.insert(0, Finder())
from elastic_strips.cli import main
main()
print("went on")
"""


@pytest.mark.parametrize("module", ["click", "numpy", "elastic_strips.sim.scenarios", "pinocchio"])
@pytest.mark.parametrize(
    "act",
    [
        "raise KeyboardInterrupt",
        "signal.raise_signal(signal.SIGINT)",
        "Dying()",  # there, Python prints and forgets a KeyboardInterrupt
    ],
)
def test_ctrl_c_while_it_imports_ends_quietly(module, act, tmp_path):
    done = python(HOOK.format(module=module, act=act), "run", "case-1", "--json", str(tmp_path / "r.json"))
    assert done.returncode == 130, done.stderr
    assert done.stderr.strip() == "interrupted"
    assert done.stdout == ""
    assert not list(tmp_path.iterdir())
