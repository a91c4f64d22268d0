"""Any URDF: here one of a few lines, with a base on two driven wheels and a mast of two joints."""

import tempfile
from pathlib import Path

import elastic_strips as es

URDF = """<robot name="forklift">
  <link name="base"><collision><origin xyz="0 0 0.2"/><geometry><box size="0.8 0.5 0.4"/></geometry></collision></link>
  <link name="mast"><collision><origin xyz="0 0 0.4"/><geometry><box size="0.1 0.4 0.8"/></geometry></collision></link>
  <link name="fork"><collision><origin xyz="0.3 0 0"/><geometry><box size="0.5 0.3 0.05"/></geometry></collision></link>
  <joint name="tilt" type="revolute"><parent link="base"/><child link="mast"/><origin xyz="0.4 0 0.42"/>
    <axis xyz="0 1 0"/><limit lower="-0.1" upper="0.2" effort="1" velocity="0.5"/></joint>
  <joint name="lift" type="prismatic"><parent link="mast"/><child link="fork"/><origin xyz="0.08 0 0.1"/>
    <axis xyz="0 0 1"/><limit lower="0" upper="0.6" effort="1" velocity="0.3"/></joint>
</robot>"""

with tempfile.TemporaryDirectory() as folder:
    file = Path(folder, "forklift.urdf")
    file.write_text(URDF)
    robot = es.load_robot(file, base="diff_drive")
low, high = robot.home(), robot.home(x=4.0, y=1.0, lift=0.5)
scene = es.Scene([es.Box((0.4, 1.2, 0.5), at=(2.0, 0.0, 0.25), name="pallet")])
report = es.plan_report(robot, scene, low, high)
print(f"{robot.name}: {', '.join(robot.joint_names)}; certified {report.certified} by {report.method}")
