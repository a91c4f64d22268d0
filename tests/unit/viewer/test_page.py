"""The live page in a real browser: dragging, toggles, reload, two pages at once, and a server that is gone."""

from __future__ import annotations

import http.client
import http.server
import threading
import time
from functools import partial

import numpy as np
import pytest

from elastic_strips.planning import plan
from elastic_strips.robot import load_robot
from elastic_strips.scene import Box, Scene, Sphere
from elastic_strips.viewer import LiveStrip, Viewer, geometry

ARGUMENTS = ("--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--disable-dev-shm-usage")
PLACE = """(name) => {
  viewer.render();
  const at = places(1000).find(([n]) => n === name)[1].clone().project(viewer.camera);
  return [(at.x + 1) / 2 * innerWidth, (1 - at.y) / 2 * innerHeight];
}"""
GOAL = """() => {
  viewer.render();
  const ring = viewer.scene_tree.find(["markers", "goal"]).object;
  const at = ring.localToWorld(new T.Vector3(0, 0.47, 0)).project(viewer.camera);
  return [(at.x + 1) / 2 * innerWidth, (1 - at.y) / 2 * innerHeight];
}"""


RARELY = "window.requestAnimationFrame = (draw) => setTimeout(() => draw(performance.now()), 200);"
"""Five pictures a second, which is enough for what these tests look at: a processor draws them."""


def wait(condition, patience=60.0):
    end = time.monotonic() + patience
    while not condition():
        assert time.monotonic() < end, "it never comes"
        time.sleep(0.05)


@pytest.fixture(scope="module")
def browser(chromium):
    """One for these tests alone: while Playwright's is open, nobody else can run an event loop in this thread."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=list(ARGUMENTS))
        context = browser.new_context(viewport={"width": 800, "height": 500})
        context.add_init_script(RARELY)
        yield context
        browser.close()


@pytest.fixture
def live():
    robot = load_robot("bridge-arm")
    scene = Scene([Box((0.5, 0.5, 1.2), at=(1.5, 1.4, 0.6), name="shelf"), Sphere(0.2, at=(3.0, 2.0, 1.0), name="<b>")])
    strip = plan(robot, scene, robot.home(x=-1.0), robot.home(x=4.0))
    with Viewer(title="page & <title>") as viewer, LiveStrip(robot, scene, strip, viewer=viewer) as live:
        live.viewer_of_test = viewer
        yield live


@pytest.fixture
def opened(browser, live):
    """Open the page; every error that it reports fails the test."""
    pages, errors = [], []

    def open_page(how=""):
        page = browser.new_page()
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.on("console", lambda message: errors.append(message.text) if message.type == "error" else None)
        page.goto(live.viewer_of_test.url + how)
        page.wait_for_function("document.body.dataset.ready === 'yes' && allowed.obstacles")
        page.wait_for_function("viewer.scene_tree.children.obstacles !== undefined && places(9).length > 1")
        pages.append(page)
        return page

    yield open_page
    for page in pages:
        page.close()
    assert not errors


def drag(page, begin, by, steps=8):
    page.mouse.move(*begin)
    page.mouse.down()
    for k in range(1, steps + 1):
        page.mouse.move(begin[0] + by[0] * k / steps, begin[1] + by[1] * k / steps)
    page.wait_for_timeout(200)


def test_an_obstacle_is_dragged_and_the_strip_gives_way(opened, live):
    page = opened()
    eye = page.evaluate("viewer.camera.position.toArray()")
    assert live.scene.obstacle("shelf").pose[1, 3] == 1.4
    drag(page, page.evaluate(PLACE, "shelf"), (-20, 120))
    wait(lambda: live.scene.obstacle("shelf").pose[1, 3] < 0.9)
    assert live.scene.obstacle("shelf").pose[2, 3] == pytest.approx(0.6)  # over the floor
    page.mouse.up()
    wait(lambda: live.report.certified and abs(live.report.strip.coordinates[:, 1]).max() > 0.1)
    assert page.evaluate("viewer.camera.position.toArray()") == pytest.approx(eye)  # the camera stays meanwhile
    assert "tick" in page.inner_text("#es-card")

    drag(page, page.evaluate(PLACE, "<b>"), (0, -40), steps=3)  # no markup of a name
    assert page.query_selector("#es-tip b, #es-labels b") is None
    page.mouse.up()

    height = live.scene.obstacle("shelf").pose[2, 3]
    page.keyboard.down("Shift")
    drag(page, page.evaluate(PLACE, "shelf"), (0, -60))
    page.mouse.up()
    page.keyboard.up("Shift")
    wait(lambda: live.scene.obstacle("shelf").pose[2, 3] > height + 0.05)


def test_the_goal_is_dragged_by_its_ring(opened, live):
    page = opened()
    page.wait_for_function("allowed.goal && viewer.scene_tree.children.markers !== undefined")
    before = live.report.strip.coordinates[-1].copy()
    drag(page, page.evaluate(GOAL), (-60, 0))
    page.mouse.up()
    wait(lambda: abs(live.report.strip.coordinates[-1, :2] - before[:2]).max() > 0.1 and live.report.certified)


def test_what_is_hidden_stays_hidden_after_a_reload(opened, live):
    page = opened()
    mesh = "viewer.scene_tree.find(['strip', 'threads', '<object>']).object.visible"
    assert page.evaluate(mesh)
    page.get_by_role("button", name="threads").click()
    assert not page.evaluate(mesh)
    page.get_by_role("button", name="names").click()
    page.wait_for_function("[...document.querySelectorAll('#es-labels div')].some((e) => e.textContent === 'shelf')")
    page.reload()
    page.wait_for_function("viewer.scene_tree.children.strip !== undefined && buttons.threads !== undefined")
    assert not page.evaluate(mesh)
    assert page.get_by_role("button", name="threads").get_attribute("aria-pressed") == "false"


LINES = """([points, colors]) => {
  rods({ path: "/strip/threads", nodes: 3, radius: 0.25, points: new Float32Array(points),
         colors: new Float32Array(colors) });
"""


def test_the_page_lays_rods_as_arrows_and_pins_are_laid(opened, live):
    page = opened("#fine")
    lines = np.array([[[0, 0, 0], [1, 0, 0], [1, 0, 2]], [[0, 1, 1], [-0.5, 1, 1.2], [-0.5, 1, 1.2]]], dtype=float)
    laid, colors = page.evaluate(  # in one go, before the next picture
        LINES
        + """
          const mesh = viewer.scene_tree.find(["strip", "threads", "<object>"]).object;
          return [[...mesh.instanceMatrix.array], [...mesh.instanceColor.array]];
        }""",
        [lines.ravel().tolist(), [1.0, 0.0, 0.0, 0.0, 1.0, 0.0]],
    )
    wanted = geometry.between(lines[:, :-1].reshape(-1, 3), lines[:, 1:].reshape(-1, 3), 0.25)
    np.testing.assert_allclose(np.reshape(laid[: 4 * 16], (4, 16)), wanted, atol=1e-6)
    np.testing.assert_array_equal(np.reshape(colors[: 4 * 3], (4, 3)), np.repeat(np.eye(3)[:2], 2, axis=0))


def test_a_processor_draws_plainer(opened, live):
    """Lines instead of rods, and fewer faces of the robot."""
    page = opened()
    lines = np.array([[[0, 0, 0], [1, 0, 0], [1, 0, 2]], [[0, 1, 1], [-0.5, 1, 1.2], [-0.5, 1, 1.2]]], dtype=float)
    laid, colors = page.evaluate(
        LINES
        + """
          const [laid] = viewer.scene_tree.find(["strip", "threads", "<object>"]).object.children;
          return ["position", "color"].map((name) => [...laid.geometry.attributes[name].array]);
        }""",
        [lines.ravel().tolist(), [1.0, 0.0, 0.0, 0.0, 1.0, 0.0]],
    )
    wanted = np.stack((lines[:, :-1], lines[:, 1:]), axis=2)
    np.testing.assert_allclose(np.reshape(laid, wanted.shape), wanted, atol=1e-6)
    np.testing.assert_array_equal(np.reshape(colors, (8, 3)), np.repeat(np.eye(3)[:2], 4, axis=0))
    assert page.evaluate("document.body.dataset.plain") >= "1"
    assert page.evaluate("""[...Array(3)].map((_, k) => {
      const geometry = new T.SphereGeometry(0.3, 60, 30), before = geometry.index.count;
      for (let again = 0; again < k; again++) fewer(geometry, 12);
      const { index, attributes: { position: p } } = geometry;
      return [index.count < before, index.array.every((i) => i < p.count)];
    })""") == [[False, True], [True, True], [True, True]]


def test_a_strip_that_moves_is_not_compiled_anew(opened, live):
    page = opened("#fine")
    page.evaluate("""() => {
      const gl = viewer.renderer.getContext(), link = gl.linkProgram.bind(gl);
      window.band = viewer.scene_tree.find(["strip", "base", "<object>"]).object;
      window.shape = band.geometry;
      viewer.render();
      window.linked = 0;
      gl.linkProgram = (program) => { linked++; link(program); };
    }""")
    live.move("shelf", (1.5, 0.6, 0.6))
    page.wait_for_function("band.geometry !== shape")
    page.evaluate("viewer.render()")
    assert page.evaluate("[linked, viewer.scene_tree.find(['strip', 'base', '<object>']).object === band]") == [0, True]


def test_one_of_two_pages_holds(opened, live):
    first, second = opened(), opened()
    begin = first.evaluate(PLACE, "shelf")
    first.bring_to_front()
    first.mouse.move(*begin)
    first.mouse.down()
    first.mouse.move(begin[0], begin[1] + 10)
    wait(lambda: live._held is not None)
    second.evaluate("say_back({ type: 'grab', name: '<b>' })")
    second.evaluate("say_back({ type: 'drag', name: '<b>', shift: [5, 5, 0], turn: 0 })")
    second.wait_for_function("document.getElementById('es-toast').textContent.includes('another page')")
    first.close()  # lets go
    wait(lambda: live._held is None)
    assert live.scene.obstacle("<b>").pose[0, 3] == 3.0
    second.evaluate("say_back({ type: 'grab', name: '<b>' })")
    second.evaluate("say_back({ type: 'drag', name: '<b>', shift: [0.2, 0, 0], turn: 0 })")
    wait(lambda: live.scene.obstacle("<b>").pose[0, 3] == pytest.approx(3.2))


def test_two_messages_are_both_read(opened):
    page = opened()
    page.evaluate("for (const text of ['the one', 'the other', 'the one']) toast(text)")
    shown = page.inner_text("#es-toast").split("\n")
    assert [text for text in shown if text.startswith("the ")] == ["the other", "the one"]


def test_what_makes_no_sense_is_passed_over(opened, live):
    page = opened()
    for text in ("", "{", "[]", '{"type": "grab"', '{"type": "open", "name": "shelf"}', "x" * 3000):
        page.evaluate("(text) => viewer.connection.send(text)", text)
    page.evaluate("say_back({ type: 'grab', name: 'no such thing' })")
    page.evaluate("say_back({ type: 'drag', name: 'no such thing', shift: [1, 0, 0] })")
    page.evaluate("say_back({ type: 'release' })")
    page.evaluate("say_back({ type: 'grab', name: 'shelf' })")
    page.evaluate("say_back({ type: 'drag', name: 'shelf', shift: [0, 0, 0.3], turn: 0 })")
    wait(lambda: live.scene.obstacle("shelf").pose[2, 3] == pytest.approx(0.9))
    assert live.alive
    assert live.viewer_of_test.alive


def test_the_picture_is_framed_again_when_the_window_changes(opened, live):
    page = opened()
    before = page.evaluate("viewer.camera.position.toArray()")
    page.set_viewport_size({"width": 420, "height": 600})
    page.wait_for_function(
        "(was) => viewer.camera.position.distanceTo(new T.Vector3(...was)) > 0.2", arg=before, timeout=30_000
    )
    assert page.evaluate("viewer.controls.maxPolarAngle") < 1.571  # the camera stays above the floor


COVERED = """() => {
  viewer.render();
  const panels = ["es-card", "es-bar", "es-hint", "es-play"].map((id) => byId(id).getBoundingClientRect());
  const at = new T.Vector3(), under = [], outside = [];
  const look_at = (object, path) => {
    if (!object.geometry || !shown(object)) return;
    const { position } = object.geometry.attributes;
    for (let i = 0; i < position.count; i += 7) {
      at.fromBufferAttribute(position, i).applyMatrix4(object.matrixWorld).project(viewer.camera);
      const x = (at.x + 1) / 2 * innerWidth, y = (1 - at.y) / 2 * innerHeight;
      if (x < 0 || y < 0 || x > innerWidth || y > innerHeight) outside.push(path.join("/"));
      if (panels.some((p) => x > p.left && x < p.right && y > p.top && y < p.bottom)) under.push(path.join("/"));
    }
  };
  viewer.scene.updateMatrixWorld(true);
  each_mesh(viewer.scene_tree.children.robot, ["robot"], look_at);
  each_mesh(viewer.scene_tree.children.strip.children.base, ["strip"], look_at);
  return [[...new Set(under)], [...new Set(outside)]];
}"""


def test_nothing_of_robot_and_strip_is_under_the_card_and_the_bars(opened, live):
    page = opened()
    for width, height in ((1280, 800), (1024, 640), (800, 480), (844, 390), (390, 844)):
        page.set_viewport_size({"width": width, "height": height})
        page.wait_for_function("(wide) => innerWidth === wide", arg=width)
        page.wait_for_timeout(300)  # the bars' sizes are heard of late
        assert page.evaluate(COVERED) == [[], []], (width, height)
    page.keyboard.press("c")  # the small one's whole card, as somebody asked for it
    page.wait_for_function("byId('es-card').querySelector('.legend').offsetHeight > 0")
    assert page.evaluate(COVERED) == [[], []]
    finger = page.evaluate(
        "[...document.querySelectorAll('#es-bar button')].map((b) => b.getBoundingClientRect().height)"
    )
    assert min(finger) >= 40


def test_keys_hide_and_show_and_frame(opened, live):
    page = opened()
    page.set_viewport_size({"width": 1280, "height": 800})
    first = page.evaluate("byId('es-bar').querySelector('button[aria-pressed]').textContent")
    page.keyboard.press("1")
    assert page.evaluate("on")[first] is False
    page.keyboard.press("1")
    assert page.evaluate("on")[first] is True
    page.wait_for_timeout(300)
    eye = page.evaluate("viewer.camera.position.toArray()")
    page.evaluate("void viewer.camera.position.set(1, 2, 3)")
    page.keyboard.press("f")
    assert page.evaluate("viewer.camera.position.toArray()") == pytest.approx(eye, abs=1e-6)
    page.keyboard.press("h")
    page.wait_for_function("byId('es-toast').textContent.includes('C  ')")
    seen = page.evaluate("""() => {  // at once, before it has gone by itself
      const box = byId("es-toast"), state = () => [box.style.display, box.textContent.split("C  ").length - 1];
      box.style.display = "none";
      return [show_keys, () => toast("the strip waits"), show_keys, show_keys].map((act) => { act(); return state(); });
    }""")
    assert seen[:2] == [["block", 1]] * 2, "something else that is said does not repeat it"
    assert seen[2][0] == "none", "a second time closes it"
    assert seen[3] == ["block", 1]


def test_an_obstacle_is_moved_by_keys(opened, live):
    page = opened()
    before = {o.name: o.pose[:3, 3].copy() for o in live.scene}
    page.keyboard.press("o")
    name = page.evaluate("chosen")
    for _ in range(4):
        page.keyboard.press("ArrowRight")
    page.keyboard.press("PageUp")
    wait(lambda: live.scene.obstacle(name).pose[2, 3] > before[name][2] + 0.04)
    wait(lambda: np.linalg.norm((live.scene.obstacle(name).pose[:3, 3] - before[name])[:2]) > 0.15)
    page.keyboard.press("Escape")
    assert page.evaluate("chosen") is None
    page.wait_for_function("nudged === null", timeout=10_000)


def test_it_is_dark_where_the_reader_has_it_dark(opened, live):
    page = opened()
    look = "[getComputedStyle(byId('es-card')).backgroundColor, viewer.scene.background.getHex()]"
    bright = page.evaluate(look)
    page.emulate_media(color_scheme="dark")
    page.wait_for_function(f"(was) => {look}[1] !== was", arg=bright[1])
    dark = page.evaluate(look)
    assert dark[0] != bright[0]
    assert dark[1] < bright[1]


def still(browser, viewer, scene, how=""):
    """A page of a picture that does not change."""
    robot = load_robot("bridge-arm")
    viewer.show(robot, scene, plan(robot, scene, robot.home(x=-1.0), robot.home(x=4.0)))
    page = browser.new_page()
    page.goto(viewer.url + how)
    page.wait_for_function(
        "document.body.dataset.ready === 'yes' && viewer.scene_tree.children.obstacles !== undefined"
    )
    return page


def test_a_wall_before_the_robot_is_looked_through(browser):
    """Of the colours about the robot there are others where it is not looked through."""
    wall = Box((6.0, 0.1, 3.0), at=(1.0, -2.5, 1.5), name="wall")
    with Viewer() as viewer:
        page = still(browser, viewer, Scene([wall]), "#fine")
        count = """(radius) => {
          framed = null; find_robot(); found = Infinity;
          const at = viewer.scene.localToWorld(new T.Vector3(-1.0, 0.0, 0.5)), size = new T.Vector2();
          viewer.camera.position.copy(viewer.scene.localToWorld(new T.Vector3(-1.0, -8.0, 0.7)));
          viewer.controls.target.copy(at); viewer.controls.update(); viewer.camera.updateMatrixWorld();
          sight.esRobot.value.copy(at); sight.esRadius.value = radius; draw();
          const gl = viewer.renderer.getContext(), n = 60, pixels = new Uint8Array(4 * n * n), seen = new Set();
          viewer.renderer.getDrawingBufferSize(size); at.project(viewer.camera);
          const [x, y] = [(at.x + 1) / 2 * size.x - n / 2, (at.y + 1) / 2 * size.y - n / 2];
          gl.readPixels(x, y, n, n, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
          for (let i = 0; i < pixels.length; i += 4) seen.add(pixels.slice(i, i + 3).join());
          return seen.size;
        }"""
        through, closed = page.evaluate(count, 0.6), page.evaluate(count, 0.0)
        page.close()
    assert through > 2 * closed


def test_it_is_sharp_at_rest_and_coarse_while_something_moves(browser):
    with Viewer() as viewer:
        page = still(browser, viewer, Scene([Sphere(0.2, at=(3.0, 2.0, 1.0))]))
        page.evaluate("while (plain < 2) plainer(); viewer.set_dirty()")
        page.wait_for_function("viewer.renderer.getPixelRatio() === devicePixelRatio && coarse !== null")
        page.evaluate("viewer.render()")
        assert page.evaluate("viewer.renderer.getPixelRatio() < devicePixelRatio")
        page.close()


def test_a_page_says_that_the_program_has_ended(browser, live):
    page = browser.new_page()
    page.goto(live.viewer_of_test.url)
    page.wait_for_function("document.body.dataset.ready === 'yes' && allowed.obstacles")
    assert "certified" in page.inner_text("#es-card .chip")
    live.close()  # nobody keeps the strip certified from now on
    page.wait_for_function("document.querySelector('#es-card .chip').textContent.startsWith('ended')")
    live.viewer_of_test.show(live.report.strip.robot, live.scene, live.report)  # this picture is not of then
    page.wait_for_function("!document.querySelector('#es-card .chip').textContent.startsWith('ended')")
    live.viewer_of_test.close()
    page.wait_for_function("document.title.startsWith('(ended)')")
    page.evaluate("card({ title: 'late', chip: ['certified', 'green'], rows: [], legend: [] })")
    page.wait_for_function("document.querySelector('#es-card h1').textContent.startsWith('late')")
    assert page.inner_text("#es-card .chip").startswith("ended")
    page.close()


def test_a_frame_of_another_program_is_not_answered(live):
    port = int(live.viewer_of_test.url.rsplit(":", 1)[1].strip("/"))

    def status(path):
        connection = http.client.HTTPConnection("127.0.0.1", port, timeout=30)
        connection.request("GET", path)
        return connection.getresponse().status

    own = live.viewer_of_test.own_url.rsplit("/", 1)[1]
    assert status("/") == status("/" + own) == 200
    assert own in live._repr_html_() or live._viewer is None
    assert status("/?id=12345678") == 404


def test_the_goal_is_held_by_the_inside_of_its_ring(opened, live):
    page = opened()
    page.wait_for_function("allowed.goal && viewer.scene_tree.children.markers !== undefined")
    before = live.report.strip.coordinates[-1].copy()
    assert "the goal's ring" in page.inner_text("#es-hint")
    drag(page, page.evaluate(GOAL.replace("0, 0.47, 0", "-0.3, 0.2, 0")), (-60, 0))
    page.mouse.up()
    wait(lambda: abs(live.report.strip.coordinates[-1, :2] - before[:2]).max() > 0.1 and live.report.certified)
    assert not page.is_visible("#es-hint")  # it is known now


def test_the_goals_hand_is_dragged(opened, live):
    page = opened()
    page.wait_for_function("allowed.hand && viewer.scene_tree.children.markers.children.hand !== undefined")
    before = live.report.strip.coordinates[-1].copy()
    at = page.evaluate("""() => {
      viewer.render();
      const ball = viewer.scene_tree.find(["markers", "hand"]).object;
      const at = ball.getWorldPosition(new T.Vector3()).project(viewer.camera);
      return [(at.x + 1) / 2 * innerWidth, (1 - at.y) / 2 * innerHeight];
    }""")
    drag(page, at, (-25, 10))
    page.mouse.up()
    wait(lambda: abs(live.report.strip.coordinates[-1, 3:] - before[3:]).max() > 0.05 and live.report.certified)
    np.testing.assert_allclose(live.report.strip.coordinates[-1, :3], before[:3], atol=1e-9)  # the base stays


def test_the_whole_strip_comes_back_into_the_picture(opened, live):
    page = opened()
    eye = page.evaluate("viewer.camera.position.toArray()")
    drag(page, (620, 420), (90, 30))  # the floor: the camera turns
    page.mouse.up()
    page.wait_for_function("(was) => viewer.camera.position.distanceTo(new T.Vector3(...was)) > 0.2", arg=eye)
    page.get_by_role("button", name="the whole strip in the picture").click()
    assert page.evaluate("viewer.camera.position.toArray()") == pytest.approx(eye, abs=1e-6)


def test_a_notebooks_picture_draws_where_nothing_may_be_loaded(browser, live, tmp_path):
    """VS Code's policy of outputs, where it is switched on: scripts of the page itself, and nothing from a machine."""
    policy = "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data:; child-src data:"
    viewer = Viewer(server=False, title="inline")
    viewer.show(live.report.strip.robot, live.scene, live.report)
    meta = f'<meta http-equiv="Content-Security-Policy" content="{policy}">'
    path = tmp_path / "notebook.html"
    path.write_text(f"<!DOCTYPE html><head>{meta}</head>{viewer._repr_html_()}", encoding="utf-8")
    page, said = browser.new_page(), list[str]()
    page.on("console", lambda message: said.append(message.text) if message.type == "error" else None)
    page.on("pageerror", lambda error: said.append(str(error)))
    page.goto(path.as_uri())
    frame = page.frame_locator("iframe")
    frame.locator("#es-card h1").wait_for(timeout=60e3)
    assert frame.locator("#es-card h1").inner_text().startswith("inline")
    assert frame.locator("canvas").count() == 1
    assert said == []
    page.close()


def test_a_notebook_on_another_port_frames_it_and_a_foreign_page_does_not(browser, live, tmp_path):
    """As Jupyter does: a page of this machine, from another port. A foreign one is stood for by a file's."""
    address = live.viewer_of_test.own_url
    (tmp_path / "notebook.html").write_text(f'<!DOCTYPE html><iframe src="{address}"></iframe>', encoding="utf-8")
    handler = partial(http.server.SimpleHTTPRequestHandler, directory=str(tmp_path))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        page = browser.new_page()
        page.goto(f"http://localhost:{server.server_address[1]}/notebook.html")
        page.frame_locator("iframe").locator("#es-card h1").wait_for(timeout=60e3)
        said = list[str]()
        foreign = browser.new_page()
        foreign.on("console", lambda message: said.append(message.text))
        foreign.goto((tmp_path / "notebook.html").as_uri())
        wait(lambda: any("frame-ancestors" in text for text in said))
        assert foreign.frame_locator("iframe").locator("#es-card").count() == 0
        page.close()
        foreign.close()
        server.shutdown()


def test_pages_of_others_are_refused(live):
    port = int(live.viewer_of_test.url.rsplit(":", 1)[1].strip("/"))
    wanted = {"Connection": "Upgrade", "Upgrade": "websocket", "Sec-WebSocket-Version": "13"}
    wanted["Sec-WebSocket-Key"] = "a" * 22 + "=="

    def status(**headers):
        connection = http.client.HTTPConnection("127.0.0.1", port, timeout=10)
        connection.request("GET", "/ws", headers=wanted | headers)
        with connection.getresponse() as answer:
            return answer.status

    assert status(Origin=f"http://127.0.0.1:{port}") == 101
    assert status(Origin="http://example.org") == 403
    assert status(Host="example.org") == 403
