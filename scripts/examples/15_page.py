"""A page that anybody can open, without a server: the robot, the obstacles and the strip in 3D."""

import tempfile
from pathlib import Path

import elastic_strips as es
from elastic_strips.sim.scenarios import get_scenario, run_scenario

result = run_scenario(get_scenario("case-1"))
with tempfile.TemporaryDirectory() as folder, es.Viewer(server=False) as viewer:
    page = viewer.show(result.robot, result.report.scene, result.report).save_html(Path(folder, "case-1.html"))
    print(f"{page.name}: {page.stat().st_size / 1e6:.1f} MB")  # es.Viewer().show(…).wait() opens it live
