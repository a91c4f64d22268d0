"""Viewer: on the loopback only, cheap for the caller, and never in the way of planning."""

from __future__ import annotations

import asyncio
import logging
import os
import signal
import socket
import subprocess
import sys
import textwrap
import threading
import time
import urllib.error
import urllib.request
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import umsgpack
from cases import refused
from pictured import pictured
from tornado.websocket import websocket_connect

import elastic_strips as es
from elastic_strips.errors import InputError, ParameterError
from elastic_strips.scene import Twist
from elastic_strips.viewer import Viewer, commands, geometry
from elastic_strips.viewer.path_report import PathReport

linux = pytest.mark.skipif(not Path("/proc/net/tcp").exists(), reason="needs /proc")


def eventually(condition, timeout=60.0):
    end = time.monotonic() + timeout
    while not condition():
        if time.monotonic() > end:
            return False
        time.sleep(0.02)
    return True


def listening(pid):
    """Addresses (hexadecimal, as in /proc/net/tcp) at which a process listens."""
    inodes = set()
    for descriptor in Path(f"/proc/{pid}/fd").iterdir():
        try:
            target = os.readlink(descriptor)
        except OSError:
            continue
        if target.startswith("socket:["):
            inodes.add(target[8:-1])
    found = []
    for table in ("tcp", "tcp6"):
        for line in Path(f"/proc/{pid}/net/{table}").read_text().splitlines()[1:]:
            fields = line.split()
            if fields[3] == "0A" and fields[9] in inodes:
                found.append(fields[1].split(":")[0])
    return found


def received(url, count=1):
    async def read():
        client = await websocket_connect(url.replace("http", "ws") + "ws", max_message_size=1 << 28)
        messages = []
        for _ in range(count):
            data = await asyncio.wait_for(client.read_message(), 60.0)
            assert isinstance(data, bytes)
            messages.append(umsgpack.unpackb(data))
        client.close()
        return messages

    return asyncio.run(read())


@pytest.fixture
def served():
    with Viewer() as viewer:
        assert viewer.alive
        yield viewer


@linux
def test_listens_on_the_loopback_only(served, robot, scene, make_report):
    served.show(robot, scene, make_report())
    assert listening(served.server_pid) == ["0100007F"]
    assert "0100007F" not in listening(os.getpid())  # nothing in our own process
    assert served.url.startswith("http://127.0.0.1:")


def test_serves_the_page_and_refuses_foreign_names(served):
    with urllib.request.urlopen(served.url, timeout=60) as answer:
        assert "MeshCat.Viewer" in answer.read().decode()
    request = urllib.request.Request(served.url, headers={"Host": "evil.example"})
    with refused(urllib.error.HTTPError, "403"):
        urllib.request.urlopen(request, timeout=60)


def test_no_page_of_others_may_frame_it_but_a_notebooks(served):
    """By its plain address nobody may; by the one with the program's own number, whatever is of this machine."""

    def ancestors(address):
        with urllib.request.urlopen(address, timeout=60) as answer:
            policy = dict(part.split(" ", 1) for part in answer.headers["Content-Security-Policy"].split("; "))
            return policy["frame-ancestors"].split(), answer.headers["X-Frame-Options"]

    assert ancestors(served.url) == (["'none'"], "DENY")
    allowed, older = ancestors(served.own_url)
    assert older is None, "it would forbid a notebook on another port"
    assert {"'self'", "http://localhost:*", "http://127.0.0.1:*"} <= set(allowed)
    assert not {"*", "http:", "https:", "http://*", "https://*"} & set(allowed)


def test_a_late_browser_gets_the_whole_picture(served, robot, scene, make_report):
    served.show(robot, scene, make_report())
    whole = len(pictured(served))
    assert eventually(lambda: len(received(served.url)[0]) == whole)
    (batch,) = received(served.url)
    paths = {command.get("path") for command in batch if command["type"] == "set_object"}
    assert {"/forces", "/hulls", "/strip/threads", "/strip/base", "/markers/start"} <= paths
    assert len(paths) < 150
    card = next(command for command in batch if command["type"] == "hud")
    assert ["clearance", "0.123 m"] in card["rows"]
    assert ["certified", "38 of 39 segments"] in card["rows"]
    assert card["chip"][0] == "deforming"


def test_update_leaves_the_drawing_to_the_viewers_thread(served, robot, scene, make_report):
    reports = [make_report(shift=0.01 * k) for k in range(50)]
    scenes = [scene.at(0.02 * k) for k in range(50)]
    served.show(robot, scene, reports[0]).html()
    draws, draw = [], served._drawing.draw
    served._drawing.draw = lambda job: (draws.append(threading.get_ident()), draw(job))[1]
    k, end = 0, time.perf_counter() + 1.0
    while time.perf_counter() < end or (not draws and k < 30_000):  # a busy machine draws late
        served.update(reports[k % 50], scenes[k % 50])
        time.sleep(0.002)
        k += 1
    assert served.alive
    assert threading.get_ident() not in draws
    assert 1 <= len(draws) < k  # the newest won


def test_an_update_sends_transforms_not_meshes(robot, scene, make_report):
    with Viewer(server=False) as viewer:
        before = pictured(viewer.show(robot, scene, make_report()))
        viewer.update(make_report(shift=0.1), scene.at(1.0))
        after = pictured(viewer)
    changed = {path for (path, kind), one in after.items() if kind == "set_object" and one != before.get((path, kind))}
    assert changed == {"/strip/base"}
    capsule = next(key for key in after if "capsule" in key[0] and key[1] == "transforms")
    assert after[capsule] != before[capsule]


def test_obstacles_come_and_go(robot, scene, make_report):
    with Viewer(server=False) as viewer:
        paths = {path for path, _ in pictured(viewer.show(robot, scene, make_report()))}
        cloud = "/sensed/<\N{DIVISION SLASH}script><b>cloud<\N{DIVISION SLASH}b>\N{DIVISION SLASH}1"
        assert cloud in paths
        smaller = scene.without("</script><b>cloud</b>/1").without("sphere-1")
        viewer.update(make_report(), smaller)
        after = pictured(viewer)
    assert (cloud, "set_object") not in after
    assert after["/obstacles/all sphere", "instances"]["matrices"].data == b""
    assert len(after["/obstacles/all box", "instances"]["matrices"].data) == 64


def test_what_moves_shows_where_it_will_be_and_everything_has_a_name(robot, scene, make_report):
    with Viewer(server=False) as viewer:
        page = pictured(viewer.show(robot, scene, make_report()))
        legend = dict(page["", "hud"]["legend"])
        assert {"obstacle", "moving obstacle", "voxel map", "start", "goal", "robot along the strip"} <= set(legend)
        assert len(set(legend.values())) == len(legend)  # no colour means two things
        for k, ahead in ((0, 0.5), (1, 1.0)):
            T = page[f"/predictions/{k}/capsule-4", "transforms"]["matrices"].data
            there = np.frombuffer(T, dtype="<f4").reshape(4, 4).T[:3, 3]
            np.testing.assert_allclose(
                there, scene.at(ahead).obstacle("capsule-4").pose[:3, 3], atol=2e-5
            )  # sent to 15 µm
        assert page["/obstacles/all sphere", "instances"]["names"] == ["sphere-1"]
        assert page["/map/voxels-7", "names"]["names"] == ["voxels-7"]
        viewer.update(make_report(), scene.without("capsule-4"))
        assert not any(path.startswith("/predictions") for path, _ in pictured(viewer))


def test_a_plain_strip_is_shown_as_not_checked(robot, scene, make_report):
    with Viewer(server=False) as viewer:
        card = pictured(viewer.show(robot, scene, make_report().strip))["", "hud"]
        assert viewer.alive
    assert card["chip"] is None
    assert any("not checked" in name for name, _ in card["legend"])


def test_a_motion_is_shown_as_certified_and_its_goal_where_it_is(silvermate):
    q = np.stack([silvermate.home(), silvermate.home(x=1.0)])
    with Viewer(server=False) as viewer:
        strip = es.Strip(silvermate, q)
        viewer.show(silvermate, es.Scene(), strip).update(strip, motion=True, goal=silvermate.home(x=1.5, y=-0.25))
        page = pictured(viewer)
    assert not any("not checked" in name for name, _ in page["", "hud"]["legend"])
    places = np.frombuffer(page["/markers/start", "transforms"]["matrices"].data, "<f4").reshape(2, 16)
    np.testing.assert_allclose(places[:, 12:14], [[0.0, 0.0], [1.5, -0.25]], atol=2e-5)


def test_a_path_that_is_refuted_is_shown_where_it_is(silvermate):
    path = np.stack([silvermate.home(x=0.5 * k) for k in range(8)])
    scene = es.Scene([es.Box((0.3, 0.3, 1.0), at=(2.0, 0.3, 0.5), name="post")])
    found = es.certify(silvermate, scene, path)
    with Viewer(server=False) as viewer:
        page = pictured(viewer.show(silvermate, scene, PathReport.of(silvermate, path, found)))
    assert page["", "hud"]["chip"][0] == "refuted"
    assert page["", "hud"]["note"] == found.reason
    at = next(
        command for (branch, kind), command in page.items() if kind == "transforms" and branch.startswith("/robot")
    )
    places = np.frombuffer(at["matrices"].data, "<f4").reshape(-1, 16)
    assert places[at["paths"].index("/robot/1"), 12] == pytest.approx(found.q[0], abs=1e-4)
    assert len(page["/trouble/spot", "instances"]["matrices"].data) == 64, "a pin"
    assert "where the path is refuted" in [name for name, _ in page["", "hud"]["legend"]]
    free = es.Scene([es.Box((0.3, 0.3, 1.0), at=(2.0, 2.0, 0.5))])
    report = PathReport.of(silvermate, path, es.certify(silvermate, free, path))
    with Viewer(server=False) as viewer:
        assert pictured(viewer.animate(silvermate, free, report))["", "hud"]["chip"][0] == "certified"
    assert report.certificate.segments.all()


def test_a_card_says_of_which_moment_its_certificate_is(silvermate):
    """Somebody walks towards a certified strip: it is certified while they stand where they were."""
    walker = es.Box((0.4, 0.4, 1.6), at=(2.0, 2.5, 0.8), motion=Twist((0.0, -0.8, 0.0)), name="walker")
    strip = es.Strip(silvermate, [silvermate.home(x=0.1 * k) for k in range(41)])
    for scene, name in ((es.World(es.Scene([walker])).at(0.5), "walker"), (es.Scene(), "")):
        report = es.Deformer(silvermate).settle(strip, scene)
        assert report.certified
        assert report.as_it_stands == ((name,) if name else ())
        assert name in str(report)
        for show in ("show", "animate"):
            with Viewer(server=False) as viewer:
                card = pictured(getattr(viewer, show)(silvermate, scene, report))["", "hud"]
            assert [value for _, value in card["rows"] if value.endswith("0.5 s")] == (["as at 0.5 s"] if name else [])
    with Viewer(server=False) as viewer:
        card = pictured(viewer.animate(silvermate, es.Scene(), strip, notes=[("door", "opens")]))["", "hud"]
    assert ["door", "opens"] in card["rows"]


def test_a_pin_is_as_large_as_its_robot_and_in_the_picture(silvermate):
    panda = es.load_robot("panda")
    heights = []
    for robot, size in ((silvermate, 2.0), (panda, 0.7)):
        low, high = robot.home(), robot.home()
        low[0], high[0] = (0.0, 3.0) if robot.space.planar else (-1.0, 1.0)
        scene = es.Scene([es.Box((size, 0.02, 1.2), at=(1.5 if robot is silvermate else 0.55, 0.0, 0.6), name="wall")])
        path = np.stack([low, high])
        with Viewer(server=False) as viewer:
            page = pictured(viewer.show(robot, scene, PathReport.of(robot, path, es.certify(robot, scene, path))))
        head = np.frombuffer(page["/trouble/head", "instances"]["matrices"].data, "<f4").reshape(4, 4)[3, :3]
        spot = np.frombuffer(page["/trouble/spot", "instances"]["matrices"].data, "<f4").reshape(4, 4)[3, :3]
        framed = np.frombuffer(page["", "camera"]["points"].data, "<f4").reshape(-1, 3)
        assert spot[2] < head[2] < framed[:, 2].max()
        heights.append(head[2])
    assert heights[1] < 0.8 * heights[0]


def test_a_report_that_proves_nothing_is_shown_as_its_strip(robot, scene, make_report):
    planned = SimpleNamespace(strip=make_report().strip, certified=True)  # as plan_report returns it
    with Viewer(server=False) as viewer:
        viewer.show(robot, scene, planned).update(planned)
        assert pictured(viewer)["", "hud"]["chip"] is None
        assert viewer.alive


def test_the_hulls_are_drawn_where_the_report_has_one(robot, scene, make_report):
    points, radius = np.ones((4, 2, 3)), np.array([[0.1, 0.2], [0.0, 0.3], [0.1, np.nan], [0.2, 0.2]])
    report = make_report(hulls=SimpleNamespace(points=points, radius=radius))
    with Viewer(server=False) as viewer:
        first = pictured(viewer.show(robot, scene, report))["/hulls", "instances"]
        viewer.update(make_report(hulls=None))
        second = pictured(viewer)["/hulls", "instances"]
        assert viewer.alive
    assert len(first["matrices"].data) == 6 * 64
    assert second["matrices"].data == b""


def test_a_strip_of_one_node_and_of_two(robot, scene, make_report):
    with Viewer(server=False) as viewer:
        for nodes in (1, 2):
            viewer.show(robot, scene, make_report(nodes=2).strip.q[:nodes])
            viewer.animate(robot, scene, make_report(nodes=2).strip.q[:nodes], 1.0)
            viewer.html()
        assert viewer.alive


def test_a_robot_that_cannot_move_is_drawn(tmp_path):
    path, box = tmp_path / "post.urdf", '<geometry><box size="0.1 0.1 1"/></geometry>'
    path.write_text(f'<robot name="post"><link name="post"><collision>{box}</collision></link></robot>')
    post = es.load_robot(path, base="fixed")
    with Viewer(server=False) as viewer:
        viewer.show(post, es.Scene(), post.home_q[None])
        viewer.html()
        assert viewer.alive


def test_a_killed_server_is_reported_once_and_disturbs_nobody(served, robot, scene, make_report, caplog, tmp_path):
    served.show(robot, scene, make_report()).html()
    with caplog.at_level(logging.WARNING):
        os.kill(served.server_pid, signal.SIGKILL)
        assert eventually(lambda: not served.alive)
        for k in range(200):
            served.update(make_report(shift=0.01 * k))
            time.sleep(0.001)
        served.show(robot, scene, make_report())
        served.update(make_report(clearance=0.777))
        assert eventually(lambda: len(caplog.records) > 0)
        served.save_html(tmp_path / "last.html")
    assert len([r for r in caplog.records if r.name.startswith("elastic_strips.viewer")]) == 1
    assert "0.777 m" in dict(pictured(served)["", "hud"]["rows"]).values()  # the newest picture


def test_a_stopped_server_does_not_block(served, robot, scene, make_report):
    os.kill(served.server_pid, signal.SIGSTOP)
    shown = threading.Event()

    def show() -> None:
        for k in range(100):
            served.show(robot, scene, make_report(shift=0.01 * k))
            served.update(make_report())
        shown.set()

    threading.Thread(target=show, daemon=True).start()
    assert shown.wait(60.0), "it waits for a server that does not read"
    os.kill(served.server_pid, signal.SIGKILL)


def test_an_error_in_drawing_is_logged_once(robot, scene, make_report, caplog):
    with Viewer(server=False) as viewer, caplog.at_level(logging.WARNING):
        for _ in range(3):
            viewer.update(make_report(hulls="nonsense"))
            viewer.html()
        assert not viewer.alive
        assert len(caplog.records) == 1
        viewer.update(make_report())
        assert "<html" in viewer.html()


@pytest.mark.process
def test_a_taken_port_is_no_error(robot, scene, make_report, caplog):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        with caplog.at_level(logging.WARNING), Viewer(port=taken.getsockname()[1]) as viewer:
            assert not viewer.alive
            viewer.show(robot, scene, make_report())
            viewer.update(make_report(clearance=0.777))
            assert "<html" in viewer.html()
    assert len(caplog.records) == 1
    assert "0.777 m" in dict(pictured(viewer)["", "hud"]["rows"]).values()


def test_two_viewers_take_two_ports(served):
    with Viewer() as other:
        assert other.url != served.url


def test_the_server_ends_with_its_parent():
    script = """
        import os, sys
        from elastic_strips.viewer import Viewer
        viewer = Viewer()
        print(viewer.server_pid, flush=True)
        os.kill(os.getpid(), 9)
    """
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(script)], capture_output=True, text=True, env=environment, timeout=240
    )
    pid = int(done.stdout)

    def gone():
        try:
            os.kill(pid, 0)
        except ProcessLookupError:
            return True
        status = Path(f"/proc/{pid}/stat")
        return status.exists() and status.read_text().split(") ")[1][0] == "Z"

    assert eventually(gone)


@pytest.mark.process
def test_close_ends_the_server_and_can_be_repeated(robot, scene, make_report):
    viewer = Viewer()
    viewer.show(robot, scene, make_report())
    viewer.close()
    viewer.close()
    assert not viewer.alive
    with pytest.raises(urllib.error.URLError):
        urllib.request.urlopen(viewer.url, timeout=60)
    viewer.show(robot, scene, make_report())
    viewer.update(make_report())
    assert "<html" in viewer.html()


def test_save_html_is_standalone_and_whole_or_not_there(robot, scene, make_report, tmp_path, monkeypatch):
    with Viewer(server=False, title="<a & b>") as viewer:
        assert viewer.url is None
        viewer.show(robot, scene, make_report())
        target = viewer.save_html(tmp_path / "strip.html")
        text = target.read_text(encoding="utf-8")
        assert "<title>&lt;a &amp; b&gt;</title>" in text
        assert "WebSocket(`" not in text
        assert "src=" not in text.split("</style>")[0]
        before = target.read_bytes()
        monkeypatch.setattr(os, "replace", lambda *_: (_ for _ in ()).throw(OSError("disk full")))
        with refused(InputError, "disk full"):
            viewer.save_html(target)
        assert target.read_bytes() == before
        assert list(tmp_path.iterdir()) == [target]
        with refused(InputError, "nowhere"):
            viewer.save_html(tmp_path / "nowhere" / "x.html")


def test_notebooks_get_an_inline_frame(robot, scene, make_report):
    with Viewer(server=False) as viewer:
        viewer.show(robot, scene, make_report())
        frame = viewer._repr_html_()
    assert frame.startswith('<iframe srcdoc="<!DOCTYPE html>')
    source = frame.split('srcdoc="')[1].split('" style')[0]
    assert '"' not in source
    assert source.replace("&quot;", '"').replace("&amp;", "&").startswith("<!DOCTYPE html>")
    assert len(frame) <= 500_000 < len(viewer.html())  # a notebook has many


def test_pages_of_a_notebook_stay_small_with_many_strips_and_with_long_ones(robot, scene, make_report):
    with Viewer(server=False) as viewer:
        viewer.animate(robot, scene, [make_report(shift=0.02 * k) for k in range(40)], 8.0)
        assert len(viewer._repr_html_()) <= 500_000
        assert any(
            path.startswith("/ghosts") for path, _ in pictured(viewer)
        )  # a page of its own has them, for when it stops
        coarse = viewer._drawing.hidden
        viewer.show(robot, scene, make_report())
        viewer.html()
        assert "/ghosts" in coarse
        assert viewer._drawing.hidden == ()


def test_threads_are_lines_of_points_however_long_the_strip(robot, scene, make_report):
    strip = make_report().strip
    q = robot.space.from_coordinates(np.repeat(strip.coordinates, 20, axis=0))
    with Viewer(server=False) as viewer:
        rods = pictured(viewer.show(robot, scene, q))["/strip/threads", "rods"]
    assert len(q) > 100 >= rods["nodes"]
    points = np.frombuffer(rods["points"].data, "<f4").reshape(-1, rods["nodes"], 3)
    poses = geometry.RobotPoses(robot)
    poses.update(robot.space.to_coordinates(q[[0, -1]]))
    assert len(rods["colors"].data) == 12 * len(points)
    np.testing.assert_allclose(points[:, [0, -1]], np.swapaxes(poses.points(), 0, 1), atol=1e-4)


def test_animate_moves_robot_and_obstacles_and_stops_again(robot, scene, make_report):
    with Viewer(server=False) as viewer:
        viewer.animate(robot, scene, [make_report(shift=0.05 * k) for k in range(10)], 2.0)
        play = next(one for (_, kind), one in pictured(viewer).items() if kind == "set_animation")
        targets = {one["path"] for one in play["animations"]}
        assert any(path.startswith("/robot/") for path in targets)
        assert any("capsule" in path for path in targets)
        assert sum(path.startswith("/playback/") for path in targets) == 10
        ends = {np.frombuffer(c["clip"]["tracks"][0]["times"].data, "<f4")[-1] for c in play["animations"]}
        assert ends == {40.0}  # all of the same length: each repeats by itself
        shown = [c["clip"]["tracks"][0]["values"] for c in play["animations"] if c["path"].startswith("/playback")]
        assert all(value is True or value is False for values in shown for value in values)  # 0 does not hide
        viewer.update(make_report())
        assert not any(path.startswith("/playback") for path, _ in pictured(viewer))
        assert viewer.alive


def test_wrong_input_raises(robot, scene, make_report):
    with refused(ParameterError, "port=70000"):
        Viewer(port=70000)
    with refused(ParameterError, "ghosts=-1"):
        Viewer(ghosts=-1)
    with Viewer(server=False) as viewer:
        with refused(InputError, "duration"):
            viewer.animate(robot, scene, make_report(), 0.0)
        with refused(InputError, "shape"):
            viewer.animate(robot, scene, np.zeros((3, 2)))
        with refused(InputError, "strip"):
            viewer.animate(robot, scene, [])
        with refused(InputError, "shape"):
            viewer.show(robot, scene, np.zeros((3, 2)))


def test_the_page_does_not_end_its_script_early():
    assert commands._meshcat_script().lower().count("</script") == 0


def test_a_report_with_hulls_is_drawn_where_the_strip_is_in_collision(robot):
    strip = es.Strip(robot, [robot.home(x=x) for x in np.linspace(0.0, 2.0, 6)])
    scene = es.Scene([es.Box((0.4, 0.4, 1.0), at=(1.0, 0.0, 0.5))])
    report = es.Deformer(robot).step(strip, scene, detail=True)
    assert report.hulls is not None
    with Viewer(server=False) as viewer:
        viewer.show(robot, scene, report).html()
        assert viewer.alive


def test_the_robot_stays_where_it_is_when_the_strip_is_broken_elsewhere(robot, scene, make_report):
    def at(report):
        with Viewer(server=False) as viewer:
            page = pictured(viewer.show(robot, scene, report))
            return next(
                o["matrices"].data for (p, kind), o in page.items() if kind == "transforms" and p.startswith("/robot")
            )

    broken = es.collision.BrokenSegment(30, robot.geometries[0].name, "it", -0.01, "obstacle", certain=True)
    certificate = SimpleNamespace(certified=False, segments=np.arange(39) != 30, broken=broken)
    assert at(make_report(certificate=certificate, hulls=None)) == at(make_report())


@pytest.mark.parametrize("interpolation", ["line", "arc"])
def test_a_path_is_drawn_the_way_that_was_certified(tiago_omni, interpolation):
    """From one configuration to the next the base turns: on a line, or on an arc."""
    q = np.stack([tiago_omni.home(), tiago_omni.home(x=4.0, yaw=2.5)])
    scene = es.Scene([es.Box((0.3, 0.3, 0.3), at=(2.0, 0.0, 0.15), name="strut")])
    found = es.certify(tiago_omni, scene, q, interpolation=interpolation)
    report = PathReport.of(tiago_omni, q, found, interpolation=interpolation)
    dense = tiago_omni.space.to_coordinates(report.strip.q)[:, :2]
    chord = np.abs(dense[:, 1]).max()
    if interpolation == "line":
        assert chord < 0.005
        assert found.verdict.value == "refuted"
        broken = report.certificate.broken
        a, b = report.strip.coordinates[broken.segment], report.strip.coordinates[broken.segment + 1]
        shown = tiago_omni.space.interpolate(a[None], b[None], np.array([report.place]))[0]
        np.testing.assert_allclose(shown, tiago_omni.space.to_coordinates(found.q), atol=0.01)
        assert report.segments == (0, 1)
        assert not report.certificate.segments.any()
    else:
        assert chord > 1.0
        assert found.certified
        assert report.segments == (1, 1)
        assert report.certificate.segments.all()
