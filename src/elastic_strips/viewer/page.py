"""Page: the HTML that shows a picture, live from the server or standalone with the picture inside.

The page is meshcat's script plus one of ours, which adds a better background, lights and camera, objects that are drawn
many times at once, a card with numbers and legend, and buttons for what plays.
"""

from __future__ import annotations

import base64
import html
import importlib.util
import zlib
from functools import cache
from pathlib import Path

from elastic_strips.viewer.server import Record

_STYLE = """
html, body { margin: 0; height: 100%; background: #eef1f4; overflow: hidden; }
#meshcat-pane { width: 100vw; height: 100vh; overflow: hidden; }
#es-card, #es-play { position: absolute; font: 13px/1.5 system-ui, sans-serif; color: #24303c;
  background: rgba(255, 255, 255, .82); border-radius: 10px; box-shadow: 0 1px 6px rgba(30, 45, 60, .14); }
.dg.main .close-button { background: #24606f !important; border-radius: 0 0 0 8px; }
#es-card { left: 16px; top: 16px; padding: 11px 15px; max-width: 300px; display: none; pointer-events: none; }
#es-card h1 { font-size: 15px; font-weight: 600; margin: 0 0 4px; }
#es-card .chip { display: inline-block; padding: 0 8px; border-radius: 8px; color: #fff; font-size: 11px;
  font-weight: 600; margin-left: 8px; vertical-align: 1px; }
#es-card .row { display: flex; justify-content: space-between; gap: 24px; }
#es-card .row b { font-weight: 600; font-variant-numeric: tabular-nums; }
#es-card .note { margin-top: 5px; color: #24303c; font-size: 12px; line-height: 1.35; min-height: 2.7em; }
#es-card .legend { margin-top: 6px; color: #566372; font-size: 12px; }
#es-card .legend span { white-space: nowrap; margin-right: 10px; }
#es-card .legend i { display: inline-block; width: 10px; height: 10px; border-radius: 3px; margin-right: 5px; }
#es-play { left: 50%; bottom: 18px; transform: translateX(-50%); padding: 7px 14px; display: none; gap: 10px;
  align-items: center; }
#es-play button { border: 0; background: #24606f; color: #fff; border-radius: 7px; width: 34px; height: 26px;
  cursor: pointer; }
#es-play input { width: min(38vw, 380px); accent-color: #24606f; }
#es-play output { font-variant-numeric: tabular-nums; min-width: 3.6em; }
"""

_SCRIPT = """
"use strict";
const viewer = new MeshCat.Viewer(document.getElementById("meshcat-pane"));
const T = MeshCat.THREE, byId = (id) => document.getElementById(id);
const color = (hex) => new T.Color(hex).convertSRGBToLinear();

// Background, floor and light.
viewer.renderer.outputEncoding = T.sRGBEncoding;
viewer.renderer.shadowMap.type = T.PCFSoftShadowMap;
for (const path of [["Lights"], ["Grid"], ["Axes"]]) viewer.delete_path(path);
viewer.show_background = () => { viewer.scene.background = new T.Color(0xeef1f4); viewer.set_dirty(); };
viewer.show_background();
viewer.scene.fog = new T.Fog(color(0xeef1f4), 30, 120);
viewer.camera.fov = 36;
viewer.camera.near = 0.05;
viewer.camera.far = 500;
const sun = new T.DirectionalLight(0xfff6ea, 0.85);
sun.castShadow = true;
sun.shadow.mapSize.set(2048, 2048);
sun.shadow.bias = -0.0004;
sun.shadow.normalBias = 0.02;
sun.shadow.radius = 4;
viewer.set_object(["lights", "sun"], sun);
viewer.scene.add(sun.target);
const sky = new T.HemisphereLight(0xf4f8ff, 0xcfcac2, 0.62);
sky.position.set(0, 0, 1);
viewer.set_object(["lights", "sky"], sky);
const fill = new T.DirectionalLight(0xeaf2ff, 0.22);
viewer.set_object(["lights", "fill"], fill);
const floor = new T.Mesh(new T.PlaneGeometry(1000, 1000), new T.ShadowMaterial({ opacity: 0.2, depthWrite: false }));
floor.receiveShadow = true;
floor.position.z = -0.002;
viewer.set_object(["floor", "shadow"], floor);
const lines = [], HALF = 40;  // short lines: long ones that pass the camera get lost in some renderers
for (let i = -HALF; i <= HALF; i++)
  for (let j = -HALF; j < HALF; j++) lines.push(i, j, 0, i, j + 1, 0, j, i, 0, j + 1, i, 0);
const grid = new T.LineSegments(new T.BufferGeometry(), new T.LineBasicMaterial({ color: color(0xcbd3db) }));
grid.geometry.setAttribute("position", new T.BufferAttribute(new Float32Array(lines), 3));
grid.position.z = -0.001;
viewer.set_object(["floor", "grid"], grid);

// Look against `direction` (z up) from where all points are in the picture.
function look(points, direction) {
  const box = new T.Box3(), p = new T.Vector3(), list = [];
  for (let i = 0; i < points.length; i += 3) {
    list.push(new T.Vector3(points[i], points[i + 1], points[i + 2]));
    box.expandByPoint(list[list.length - 1]);
  }
  const center = box.getCenter(new T.Vector3()), n = new T.Vector3(...direction).normalize();
  const right = new T.Vector3(0, 0, 1).cross(n).normalize(), up = n.clone().cross(right);
  const vertical = Math.tan(viewer.camera.fov * Math.PI / 360) * 0.9;
  const horizontal = vertical * Math.max(window.innerWidth, 1) / Math.max(window.innerHeight, 1);
  let distance = 1;
  for (let turn = 0; turn < 8; turn++) {  // near things look larger: find the middle of the picture
    distance = 1;
    for (const q of list) {
      p.subVectors(q, center);
      const reach = Math.max(Math.abs(p.dot(right)) / horizontal, Math.abs(p.dot(up)) / vertical);
      distance = Math.max(distance, p.dot(n) + reach);
    }
    const x = [Infinity, -Infinity], y = [Infinity, -Infinity];
    for (const q of list) {
      p.subVectors(q, center);
      const depth = distance - p.dot(n), u = p.dot(right) / depth, v = p.dot(up) / depth;
      x[0] = Math.min(x[0], u); x[1] = Math.max(x[1], u);
      y[0] = Math.min(y[0], v); y[1] = Math.max(y[1], v);
    }
    center.addScaledVector(right, distance * (x[0] + x[1]) / 2).addScaledVector(up, distance * (y[0] + y[1]) / 2);
  }
  const eye = center.clone().addScaledVector(n, distance);
  viewer.controls.target.set(center.x, center.z, -center.y);  // the camera lives in a frame with y up
  viewer.camera.position.set(eye.x, eye.z, -eye.y);
  viewer.controls.update();
  const radius = Math.max(box.getSize(p).length() / 2, 2);
  sun.position.set(center.x - 0.45 * radius - 1, center.y - 0.35 * radius - 2, center.z + 1.3 * radius + 4);
  sun.target.position.copy(center);
  const lens = sun.shadow.camera;
  lens.left = lens.bottom = -1.25 * radius; lens.right = lens.top = 1.25 * radius;
  lens.near = 0.1; lens.far = 6 * radius + 20;
  lens.updateProjectionMatrix();
  fill.position.set(center.x + radius, center.y + 2 * radius, center.z + radius);
  viewer.scene.fog.near = distance + 2 * radius; viewer.scene.fog.far = distance + 8 * radius + 20;
}

// Objects that are drawn many times at once.
const names = (path) => path.split("/").filter((x) => x);
const at = (path) => viewer.scene_tree.find(names(path)).object;
const room = (object, name, size, count) => {
  if (!object[name] || object[name].count < count)
    object[name] = new T.InstancedBufferAttribute(new Float32Array(size * Math.ceil(1.5 * count)), size);
  return object[name];
};
function place(cmd) {
  const object = at(cmd.path + "/<object>"), count = cmd.matrices.length / 16;
  const matrices = room(object, "instanceMatrix", 16, count);
  matrices.array.set(cmd.matrices);
  matrices.needsUpdate = true;
  if (cmd.colors) {
    if (!object.instanceColor) object.material.needsUpdate = true;
    const colors = room(object, "instanceColor", 3, count);
    colors.array.set(cmd.colors);
    colors.needsUpdate = true;
  }
  object.count = count;
  const veil = object.userData.veil;
  if (veil) { veil.instanceMatrix = object.instanceMatrix; veil.count = count; }
}
// A translucent body hides its own inside: draw its depth first.
function veiled(object) {
  const veil = new T.InstancedMesh(object.geometry, object.material.clone(), 1);
  veil.material.colorWrite = false;
  veil.frustumCulled = false;
  veil.renderOrder = 1;
  object.renderOrder = 2;
  veil.instanceMatrix = object.instanceMatrix;
  veil.count = object.count;
  object.add(veil);
  object.userData.veil = veil;
}

// The card in the corner. Names come from files: they are text, never markup.
function element(parent, tag, text, style) {
  const e = parent.appendChild(document.createElement(tag));
  if (text !== undefined) e.textContent = text;
  if (style) e.style.background = style;
  return e;
}
function card(cmd) {
  const box = byId("es-card");
  box.replaceChildren();
  box.style.display = "block";
  const head = element(box, "h1", cmd.title);
  if (cmd.chip) element(head, "span", cmd.chip[0], cmd.chip[1]).className = "chip";
  for (const [name, value] of cmd.rows) {
    const row = element(box, "div");
    row.className = "row";
    element(row, "span", name);
    element(row, "b", value);
  }
  if (cmd.note !== undefined) element(box, "div", cmd.note).className = "note";
  const legend = element(box, "div");
  legend.className = "legend";
  for (const [name, color] of cmd.legend) {
    const entry = element(legend, "span");
    element(entry, "i", undefined, color);
    entry.append(name);
  }
}

// Buttons for what plays.
const animator = viewer.animator, slider = byId("es-time");
byId("es-toggle").onclick = () => { animator.playing ? animator.pause() : animator.play(); };
slider.oninput = () => { animator.pause(); animator.seek(+slider.value); animator.display_progress(+slider.value); };
let captions = null, caption = -1;  // what the card says while something plays
function say(time) {
  if (!captions) return;
  let k = 0;
  while (k + 1 < captions.times.length && captions.times[k + 1] <= time + 1e-3) k++;
  if (k !== caption) card({ ...captions.common, ...captions.cards[caption = k] });
}
const progress = animator.display_progress.bind(animator);
animator.display_progress = (time) => {
  progress(time);
  say(time);
  if (document.activeElement !== slider || animator.playing) slider.value = time;
};
setInterval(() => {
  byId("es-toggle").textContent = animator.playing ? "\\u275a\\u275a" : "\\u25b6";
  byId("es-now").textContent = (+slider.value).toFixed(1) + " s";
}, 100);

const set_object = viewer.set_object.bind(viewer), handle = viewer.handle_command.bind(viewer);
viewer.set_object = (path, object) => {
  if (object.userData && object.userData.shadow === false) object.castShadow = object.receiveShadow = false;
  if (object.userData && object.userData.veiled) veiled(object);
  set_object(path, object);
};
viewer.handle_command = (cmd) => {
  switch (cmd.type) {
    case "instances": place(cmd); break;
    case "transforms":
      cmd.paths.forEach((p, i) => viewer.set_transform(names(p), cmd.matrices.subarray(16 * i, 16 * i + 16)));
      break;
    case "hud": card(cmd); break;
    case "camera": look(cmd.points, cmd.direction); break;
    case "captions": captions = cmd.cards.length ? cmd : null; caption = -1; break;
    case "no_animation": animator.pause(); animator.clear(); byId("es-play").style.display = "none"; break;
    case "set_animation":
      handle(cmd);
      slider.max = animator.duration;
      byId("es-play").style.display = "flex";
      break;
    default: handle(cmd);
  }
  viewer.set_dirty();
};
const decode = viewer.handle_command_bytearray.bind(viewer);
const one = viewer.handle_command;
viewer.handle_command = (data) => {
  for (const cmd of Array.isArray(data) ? data : [data]) {
    try { one(cmd); } catch (error) { console.error(cmd.type, cmd.path, error); }
  }
};
const receive = (bytes) => { decode(bytes); document.body.dataset.ready = "yes"; };
"""

_LIVE = """
viewer.connect(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/ws`);
viewer.connection.onmessage = (message) => receive(new Uint8Array(message.data));
viewer.connection.onclose = () => { document.title = "(ended) " + document.title; };
"""

_STATIC = """
(async () => {
  const packed = Uint8Array.from(atob(byId("es-data").textContent.trim()), (c) => c.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  receive(new Uint8Array(await new Response(stream).arrayBuffer()));
})();
"""


@cache
def _meshcat_script() -> str:
    """Read meshcat's bundle without importing meshcat, which would import half of Jupyter."""
    spec = importlib.util.find_spec("meshcat")
    if spec is None or not spec.submodule_search_locations:
        raise ModuleNotFoundError("meshcat is not installed; it comes with elastic-strips: pip install meshcat")
    return (Path(spec.submodule_search_locations[0]) / "viewer" / "dist" / "main.min.js").read_text(encoding="utf-8")


def _page(title: str, last: str, data: str = "") -> str:
    return f"""<!DOCTYPE html>
<html lang="en">
<head><meta charset="utf-8"><meta name="viewport" content="width=device-width"><title>{html.escape(title)}</title>
<style>{_STYLE}</style></head>
<body>
<div id="meshcat-pane"></div>
<div id="es-card"></div>
<div id="es-play"><button id="es-toggle" title="play or pause"></button>
<input id="es-time" type="range" min="0" max="1" step="0.01" value="0"><output id="es-now"></output></div>
{data}
<script>{_meshcat_script()}</script>
<script>{_SCRIPT}{last}</script>
</body>
</html>
"""


def live_page(title: str) -> str:
    """Return the page that asks its server for the picture."""
    return _page(title, _LIVE)


def static_page(title: str, record: Record) -> str:
    """Return a standalone page with the picture inside; it needs no server and no network."""
    packed = base64.b64encode(zlib.compress(record.batch(), 9)).decode()
    return _page(title, _STATIC, f'<script id="es-data" type="application/octet-stream">{packed}</script>')


def inline_frame(page: str, height: int = 480) -> str:
    """Wrap a standalone page for a notebook."""
    source = page.replace("&", "&amp;").replace('"', "&quot;")
    return f'<iframe srcdoc="{source}" style="width: 100%; height: {height}px; border: 0; border-radius: 8px"></iframe>'
