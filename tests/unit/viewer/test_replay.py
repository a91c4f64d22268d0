"""Replay: every moment of what plays is that moment of the record."""

from __future__ import annotations

import numpy as np
import pytest
import umsgpack
from cases import refused
from synthetic_run import moving_world, straight_run

from elastic_strips.control.interfaces import RunState
from elastic_strips.control.record import Recorder, RecordError
from elastic_strips.control.seen_rows import SeenLog
from elastic_strips.errors import InputError
from elastic_strips.io.record_file import read_record, record_robot, write_record
from elastic_strips.scene import Box, Capsule, Cylinder, Scene, Twist, Voxels, World
from elastic_strips.strip import Strip
from elastic_strips.viewer import Viewer, seen_replay
from elastic_strips.viewer.animation import STATE_COLORS
from elastic_strips.viewer.drawing import ObstacleDrawing
from elastic_strips.viewer.seen_replay import PATH


@pytest.fixture(scope="module")
def record(silvermate):
    return straight_run(silvermate, moving_world(), wave=0.3)


class Played:
    """What a viewer plays, taken apart."""

    def __init__(self, viewer: Viewer) -> None:
        viewer._flush()
        assert viewer.alive
        items = dict(viewer._log.items())
        self.objects = {key.split("\0")[0] for key in items if key.endswith("object")}
        self.commands = {key: umsgpack.unpackb(payload) for key, payload in items.items()}
        self.last = list(items)[-1]
        self.tracks = {}
        self.ends = set()
        for animation in self.commands["\0animation"]["animations"]:
            clip, (track,) = animation["clip"], animation["clip"]["tracks"]
            times = np.frombuffer(track["times"].data, "<f4") / clip["fps"]
            values = track["values"]
            values = np.array(values) if isinstance(values, list) else np.frombuffer(values.data, "<f4")
            self.tracks[animation["path"], track["name"][1:]] = times, values.reshape(len(times), -1)
            self.ends.add(round(float(times[-1]), 4))
        self.captions = self.commands["\0captions"]
        self.card_times = np.frombuffer(self.captions["times"].data, "<f4")

    def at(self, path: str, name: str, time: float) -> np.ndarray:
        """A track at a time: between frames as three.js does it."""
        times, values = self.tracks[path, name]
        if values.dtype == bool:
            return values[np.searchsorted(times, time + 1e-4, side="right") - 1, 0]
        return np.array([np.interp(time, times, column) for column in values.T])

    def card(self, time: float) -> dict:
        cards = self.captions["cards"]
        return cards[np.searchsorted(self.card_times, time + 1e-3, side="right") - 1]


@pytest.fixture(scope="module")
def played(silvermate, record):
    with Viewer(server=False) as viewer:
        viewer.replay(silvermate, record)
        return Played(viewer)


def test_the_robot_is_where_it_truly_was(played, record):
    assert played.ends == {round(record.duration, 4)}
    assert played.last == "\0animation"  # after the objects that it moves
    for k in (0, 333, 800, len(record.control) - 1):
        x, y, z = played.at("/robot/1", "position", record.control.time[k])
        assert [x, y] == pytest.approx(record.control.coordinates[k, :2], abs=2e-3)
        assert z == pytest.approx(0.0, abs=1e-6)


def test_where_the_hand_is_to_be_is_marked(silvermate, played, record):
    goal = record.control.coordinates[-1] if record.goal is None else record.goal
    ball = np.frombuffer(played.commands["/markers/hand\0transforms"]["matrices"].data, "<f4").reshape(4, 4)[3, :3]
    hand = silvermate.control_points(silvermate.space.from_coordinates(goal))[-1]
    assert ball == pytest.approx(hand, abs=1e-3)


def test_obstacles_move_exist_and_leave_trails(played, record):
    world = record.world
    for t in (0.0, 3.21, 7.7):
        for name in ("person", "cart", "ball"):
            pose = world.scene.obstacle(name).at(t).pose
            np.testing.assert_allclose(played.at(f"/obstacles/{name}", "position", t), pose[:3, 3], atol=3e-2)
        for name in ("ball", "bin", "box"):
            assert played.at(f"/obstacles/{name}", "visible", t) == world.exists(name, t)
    assert ("/obstacles/person", "visible") not in played.tracks
    for k, lag in enumerate((0.4, 0.8, 1.2)):
        path = f"/playback/trails/{k}/person"
        assert path in played.objects
        behind = world.scene.obstacle("person").at(5.0 - lag).pose[:3, 3]
        np.testing.assert_allclose(played.at(path, "position", 5.0), behind, atol=1e-2)
        assert not played.at(path, "visible", lag - 0.05)
        assert played.at(path, "visible", lag + 0.05)
        assert not played.at(f"/playback/trails/{k}/ball", "visible", 3.0 + lag - 0.05)  # it came at 3 s
    look = played.commands["/playback/trails/2/person\0object"]["object"]["materials"][0]
    assert look["opacity"] < 0.2
    assert {"/obstacles/bin", "/obstacles/box", "/obstacles/all box"} <= played.objects


def test_one_strip_is_shown_at_a_time_and_it_is_that_of_the_time(played, record):
    strips = sorted(path for path in played.objects if path.endswith("/threads") and "/strips/" in path)
    assert 20 < len(strips) < 60
    for t in np.linspace(0.0, record.duration - 0.1, 23):
        shown = [p for p in strips if played.at(p.removesuffix("/threads"), "visible", t)]
        assert len(shown) == 1
        points = played.commands[shown[0] + "\0instances"]["points"].data
        first = np.frombuffer(points, "<f4")[:2]  # where the first rod begins
        row = record.planning.row_at(t)
        nearby = [record.planning.strip(k)[0, :2] for k in range(max(row - 8, 0), row + 1)]
        assert np.linalg.norm(np.array(nearby) - first, axis=1).min() < 0.02


def test_the_state_is_told_by_ring_and_card(played, record):
    for t in (0.5, 1.0, 5.4, 10.6):
        code = int(record.control.state[np.searchsorted(record.control.time, t + 1e-9) - 1])
        shown = [k for k in range(5) if ("/playback/state/" + str(k), "visible") in played.tracks]
        assert [k for k in shown if played.at(f"/playback/state/{k}", "visible", t)] == [code]
        base = [np.interp(t, record.control.time, column) for column in record.control.coordinates[:, :2].T]
        np.testing.assert_allclose(played.at("/playback/state", "position", t)[:2], base, atol=2e-3)
        card = played.card(t)
        name = record.states[code]
        assert card["chip"] == [name, STATE_COLORS[name]]
        rows = dict(card["rows"])
        assert rows["time"] == f"{t:.1f} s"
        assert float(rows["clearance at the nodes"].split()[0]) == pytest.approx(
            record.planning.clearance[record.planning.row_at(t)], abs=1e-3
        )
    assert played.card(0.5)["note"] == "start: the goal is ahead"
    assert played.card(3.5)["note"] == ""
    assert played.card(4.6)["note"] == "slow: the person crosses"
    assert played.card(10.2)["note"] == "waits for the person"
    legend = dict(played.captions["common"]["legend"])
    assert {"moving", "slowing", "reached", "reference", "strip certified"} <= set(legend)
    assert "stopped" not in legend


def test_the_traces_grow_to_where_the_robot_is(played, record):
    for name in ("base", "hand"):
        path = f"/playback/trace/{name}"
        rods = np.frombuffer(played.commands[path + "\0instances"]["matrices"].data, "<f4").reshape(-1, 4, 4)
        ends = rods[:, 3, :3] + rods[:, 2, :3]
        assert played.at(path + "/<object>", "count", 0.0)[0] == 0
        assert played.at(path + "/<object>", "count", record.duration)[0] == len(rods)
        count = int(played.at(path + "/<object>", "count", 5.0)[0])
        if name == "base":
            assert ends[count - 1, 0] == pytest.approx(
                np.interp(5.0, record.control.time, record.control.coordinates[:, 0]), abs=0.03
            )
    assert "/playback/trace/reference" in played.objects


def test_what_was_seen_is_shown_while_it_was_there(silvermate):
    recorder = Recorder(silvermate, Scene())
    coordinates = silvermate.space.to_coordinates(silvermate.home_q)
    wall = Box((2.0, 0.1, 1.0), at=(1.0, 2.0, 0.5), name="wall")
    for k in range(400):
        t = 0.01 * k
        recorder.control(t, coordinates=coordinates, v=0.0 * coordinates)
        seen = [wall] if t < 2.0 else [wall, Cylinder(0.25, 1.6, at=(0.0, t, 0.8), name="person")]
        recorder.seen(t, Scene(seen, time=t))
    with Viewer(server=False) as viewer:
        played = Played(viewer.replay(silvermate, recorder.finish()))
        shown = {path for path in played.objects if path.startswith(PATH)}

        def there(t: float) -> list[np.ndarray]:
            """(4, 4), transposed, of what is shown at a time."""
            paths = [path for path in shown if played.at(path, "visible", t)]
            all_of = [np.frombuffer(played.commands[p + "\0instances"]["matrices"].data, "<f4") for p in paths]
            return [T for each in all_of for T in each.reshape(-1, 4, 4)]

        (only,) = there(1.0)
        np.testing.assert_allclose(np.diag(only), (2.0, 0.1, 1.0, 1.0), rtol=1e-3)
        np.testing.assert_allclose(only[3, :3], (1.0, 2.0, 0.5), rtol=1e-3)
        for t in (2.4, 3.1, 3.9):
            (who,) = [T for T in there(t) if T[3, 0] == 0.0]
            np.testing.assert_allclose(np.diag(who)[:3], (0.25, 0.25, 1.6), rtol=1e-3)
            assert who[3, 1] == pytest.approx(t, abs=0.3)
        viewer.show(silvermate, Scene(), Strip(silvermate, np.tile(silvermate.home_q, (2, 1))))
        viewer._flush()
        assert not [key for key in dict(viewer._log.items()) if key.startswith(PATH) and key.endswith("object")]


def test_of_much_that_was_seen_fewer_moments_are_shown(silvermate, rng, monkeypatch):
    monkeypatch.setattr(seen_replay, "_MOST_SHAPES", 200)
    log = SeenLog()
    for k in range(60):
        log.look(0.5 * k, Scene([Voxels(rng.integers(0, 9, (12, 3)) * 0.1, 0.1, name="map")], time=0.5 * k))
    tracks, times = [], np.linspace(0.0, 30.0, 301)
    drawn = seen_replay.draw_seen(log.rows(30.0), times, tracks)
    sent = [umsgpack.unpackb(payload) for key, payload in drawn if key.endswith("instances")]
    assert sum(len(command["matrices"].data) // 64 for command in sent) <= 200
    assert 3 < len(tracks) < 30


def test_speed_begin_and_end(silvermate, record):
    with Viewer(server=False) as viewer:
        played = Played(viewer.replay(silvermate, record, speed=2.0, begin=3.0, end=7.0))
    assert played.ends == {2.0}
    assert played.at("/robot/1", "position", 0.0)[0] == pytest.approx(
        np.interp(3.0, record.control.time, record.control.coordinates[:, 0]), abs=2e-3
    )
    assert dict(played.card(0.0)["rows"])["time"] == "3.0 s"
    assert dict(played.card(1.0)["rows"])["time"] == "5.0 s"
    assert not played.at("/obstacles/bin", "visible", 0.45)  # it comes at 4 s
    assert played.at("/obstacles/bin", "visible", 0.55)
    paths = [p.removesuffix("/threads") for p in played.objects if p.endswith("/threads") and "/strips/" in p]
    assert sum(bool(played.at(p, "visible", 0.0)) for p in paths) == 1


def test_what_a_replay_hid_comes_back(silvermate, record):
    strip = record.planning.strip(0)
    with Viewer(server=False) as viewer:
        viewer.show(silvermate, record.world.at(0.0), silvermate.space.from_coordinates(strip))
        played = Played(viewer.replay(silvermate, record))
        for path in ("/ghosts", "/strip", "/forces"):
            assert played.commands[path + "\0property visible"]["value"] is False
        viewer.show(silvermate, record.world.at(0.0), silvermate.space.from_coordinates(strip))
        viewer._flush()
        items = {key: umsgpack.unpackb(payload) for key, payload in viewer._log.items()}
        assert not any(key.startswith("/playback") for key in items)
        assert not any(key.startswith(("/obstacles/bin", "/obstacles/ball")) for key in items)  # not there yet
        assert "/obstacles/box\0object" not in items  # one of many still boxes again
        assert items["\0animation"]["type"] == "no_animation"
        assert items["\0captions"]["cards"] == []  # or a browser that comes late would show the first of them
        assert items["\0hud"]["rows"] == [["nodes", str(len(strip))]]
        hidden = [key for key, command in items.items() if key.endswith("property visible") and not command["value"]]
        assert hidden in ([], ["/hulls\0property visible"])
        Played(viewer.replay(silvermate, record))  # and once more


def test_a_record_from_a_file_plays(record, played, tmp_path):
    again = read_record(write_record(record, tmp_path / "run.npz"))
    with Viewer(server=False) as viewer:
        other = Played(viewer.replay(record_robot(again), again))
    assert other.objects == played.objects
    for key, (times, values) in played.tracks.items():
        np.testing.assert_array_equal(other.tracks[key][0], times, err_msg=str(key))
        np.testing.assert_allclose(other.tracks[key][1], values, atol=1e-5, err_msg=str(key))


@pytest.mark.parametrize("name", ["gantry", "rover"])
def test_other_bases_and_runs_of_which_little_is_known(name, request, tmp_path):
    robot = request.getfixturevalue(name)
    row = robot.space.to_coordinates(robot.home_q)
    person = Capsule(0.2, 1.0, at=(2, 0, 1), motion=Twist((0.1, 0, 0)), name="a/b")
    recorder = Recorder(robot, World(Scene([person]), vanishes={"a/b": 0.05}))
    for k in range(12):
        recorder.control(0.01 * k, coordinates=row + 0.001 * k, v=0 * row, state=RunState.FAILED)
    with Viewer(server=False) as viewer:
        played = Played(viewer.replay(robot, recorder.finish()))
        assert viewer.save_html(tmp_path / "x.html").stat().st_size > 300_000  # the script and the picture
    assert played.card(0.0)["chip"][0] == "failed"
    assert not any("strips" in path for path in played.objects)
    (path,) = [p for p, what in played.tracks if what == "visible" and p.startswith("/obstacles")]
    assert played.at(path, "visible", 0.04)
    assert not played.at(path, "visible", 0.09)


def test_many_movers_do_not_stall_a_browser(silvermate):
    crowd = [Capsule(0.2, 1.0, at=(k, 3, 0.7), motion=Twist((0, -0.2, 0))) for k in range(20)]
    with Viewer(server=False) as viewer:
        played = Played(viewer.replay(silvermate, straight_run(silvermate, Scene(crowd), length=1.0)))
    trails = [path for path in played.objects if path.startswith("/playback/trails")]
    assert 20 <= len(trails) <= 48


def test_wrong_input_is_refused(silvermate, tiago, record):
    with Viewer(server=False) as viewer:
        with refused(RecordError, "record", "'silvermate'"):
            viewer.replay(tiago, record)
        for speed in (0.0, -1.0, np.nan, np.inf):
            with refused(InputError, "speed="):
                viewer.replay(silvermate, record, speed=speed)
        for cut in ({"begin": 5.0, "end": 5.0}, {"begin": 100.0}, {"end": -1.0}):
            with refused(InputError, "play"):
                viewer.replay(silvermate, record, **cut)
        assert viewer.alive


def test_a_live_scene_sends_where_obstacles_are_and_nothing_else(silvermate, record):
    """At 20 pictures a second: a transform for each obstacle that moves, a mesh only for one that appears."""
    strip = Strip(silvermate, silvermate.space.from_coordinates(record.planning.strip(0)))
    with Viewer(server=False) as viewer:
        viewer.show(silvermate, record.world.at(0.0), strip)
        viewer._flush()
        drawing, sent = viewer._drawing, {}
        for k in range(1, 100):
            t = 0.05 * k
            sent[t] = drawing.obstacles.draw(record.world.at(t))
    moving = {"/obstacles/person", "/obstacles/cart", "/obstacles/ball"}
    for t, out in sent.items():
        kinds = {key.split("\0")[1] for key, _ in out}
        ordinary = t not in (2.0, 3.0, 4.0)  # the box goes, the ball and the bin come
        if ordinary:
            assert kinds == {"transforms"}
            assert {key.split("\0")[0] for key, _ in out} <= moving
            assert sum(len(payload) for _, payload in out) < 500
        else:
            assert kinds - {"transforms"}


def test_an_obstacle_of_a_scene_that_is_shown_already_can_get_an_object_of_its_own(record):
    scene, obstacles = record.world.scene, ObstacleDrawing()
    assert "/obstacles/bin" not in {key.split("\0")[0] for key, _ in obstacles.draw(scene)}
    assert obstacles.draw(scene) == []
    own = {key.split("\0")[0] for key, _ in obstacles.draw(scene, alone=frozenset({"bin"}))}
    assert {"/obstacles/bin", "/obstacles/all cylinder"} <= own
    assert "/obstacles/bin\0delete" in dict(obstacles.draw(scene))


def test_the_robot_is_shown_where_it_is(silvermate, record):
    strip = Strip(silvermate, silvermate.space.from_coordinates(record.planning.strip(0)))
    where = silvermate.home(x=1.25, y=-0.5)
    with Viewer(server=False) as viewer:
        for q, x in ((None, strip.q[0, 0]), (where, 1.25)):
            viewer.update(strip, Scene(), q=q)
            viewer._flush()
            command = umsgpack.unpackb(dict(viewer._log.items())["/robot\0transforms"])
            matrices = np.frombuffer(command["matrices"].data, "<f4").reshape(-1, 16)
            assert matrices[command["paths"].index("/robot/1"), 12] == pytest.approx(x)


STATE = """new Promise((done) => {
  fold(false); animator.pause(); animator.seek(6.0); animator.display_progress(6.0);
  found = 0;
  find_robot();  // before anything is drawn
  const looked = viewer.scene.worldToLocal(sight.esRobot.value.clone()).x;
  const at = (path) => viewer.scene_tree.find(path.split("/").filter((x) => x)).object;
  setTimeout(() => done({
    card: document.getElementById("es-card").innerText,
    looked, robot: at("/robot/1").position.x, person: at("/obstacles/person").position.y,
    box: at("/obstacles/box").visible, bin: at("/obstacles/bin").visible,
    hand: at("/playback/trace/hand/<object>").count,
    strips: at("/playback/strips").children.filter((c) => c.visible).length,
    duration: animator.duration, calls: viewer.renderer.info.render.calls,
  }), 1500);
})"""


def test_a_browser_plays_it(silvermate, record, tmp_path, look):
    with Viewer(server=False) as viewer:
        page = viewer.replay(silvermate, record).save_html(tmp_path / "replay.html")
    state, picture = look(page, STATE)
    picture = picture[150:]
    row = int(np.searchsorted(record.control.time, 6.0))
    assert state["robot"] == pytest.approx(record.control.coordinates[row, 0], abs=0.02)
    assert state["looked"] == pytest.approx(state["robot"], abs=0.3), "what stands before the robot is looked through"
    assert state["person"] == pytest.approx(-2.4 + 0.55 * 6.0, abs=0.02)
    assert (state["box"], state["bin"], state["strips"]) == (False, True, 1)
    assert 10 < state["hand"] < 400
    assert state["duration"] == pytest.approx(record.duration, abs=0.05)
    assert state["calls"] < 250
    assert "6.0 s" in state["card"]
    assert record.states[record.control.state[row]] in state["card"]
    assert ((picture[..., 0] - picture[..., 2]) > 90).sum() > 500  # what moves is orange
