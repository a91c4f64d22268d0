"use strict";
const T = MeshCat.THREE, byId = (id) => document.getElementById(id);
// Without a graphics card a processor draws: then edges are not smoothed, which takes it half of its time, and all is
// drawn plainer (see controls.js). Not where the address ends in #fine: pictures and films may take their time.
const FINE = location.hash === "#fine";
const SOFTWARE = !FINE && (() => {
  const gl = document.createElement("canvas").getContext("webgl"), info = gl && gl.getExtension("WEBGL_debug_renderer_info");
  return !!gl && /swiftshader|llvmpipe|softpipe|software|basic render/i.test(gl.getParameter(info ? info.UNMASKED_RENDERER_WEBGL : gl.RENDERER));
})();
const renderer = new T.WebGLRenderer({ antialias: !SOFTWARE, alpha: true });
renderer.shadowMap.enabled = true;
byId("meshcat-pane").appendChild(renderer.domElement);
const viewer = new MeshCat.Viewer(byId("meshcat-pane"), undefined, renderer);
viewer.gui.domElement.style.display = "none";  // the bar has what one needs
const color = (hex) => new T.Color(hex).convertSRGBToLinear();

// Background, floor and light.
viewer.renderer.outputEncoding = T.sRGBEncoding;
viewer.renderer.shadowMap.type = T.PCFSoftShadowMap;
for (const path of [["Lights"], ["Grid"], ["Axes"]]) viewer.delete_path(path);
const DARK = window.matchMedia("(prefers-color-scheme: dark)"), shades = () => DARK.matches ?
  { back: 0x1a2026, grid: 0x323d47, shadow: 0.5 } : { back: 0xeef1f4, grid: 0xcbd3db, shadow: 0.2 };
viewer.show_background = () => { viewer.scene.background = new T.Color(shades().back); viewer.set_dirty(); };
viewer.show_background();
viewer.scene.fog = new T.Fog(color(shades().back), 30, 120);
viewer.camera.fov = 24;  // from further away, so that upright things look upright at the edges, too
viewer.camera.near = 0.05;
viewer.camera.far = 500;
viewer.controls.maxPolarAngle = Math.PI / 2 - 0.03;  // above the floor
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
const floor = new T.Mesh(new T.PlaneGeometry(1000, 1000), new T.ShadowMaterial({ opacity: shades().shadow, depthWrite: false }));
floor.receiveShadow = true;
floor.position.z = -0.002;
viewer.set_object(["floor", "shadow"], floor);
const cells = [], HALF = 40;  // short lines: long ones that pass the camera get lost in some renderers
for (let i = -HALF; i <= HALF; i++) for (let j = -HALF; j < HALF; j++) cells.push([i, j]);
cells.sort(([i, j], [k, l]) => Math.max(i * i, j * j) - Math.max(k * k, l * l));  // the first ones are the middle
const lines = cells.flatMap(([i, j]) => [i, j, 0, i, j + 1, 0, j, i, 0, j + 1, i, 0]);
const grid = new T.LineSegments(new T.BufferGeometry(), new T.LineBasicMaterial({ color: color(shades().grid) }));
grid.geometry.setAttribute("position", new T.BufferAttribute(new Float32Array(lines), 3));
grid.position.z = -0.001;
viewer.set_object(["floor", "grid"], grid);
DARK.addEventListener("change", () => {
  const { back, grid: line, shadow } = shades();
  viewer.scene.fog.color = color(back);
  grid.material.color = color(line);
  floor.material.opacity = shadow;
  viewer.show_background();
});

// The parts of the window that are free of the card, of the bars and of the pictures of depths, as [left, top, right,
// bottom] in pixels: beside the card, and below it.
function free_areas() {
  const wide = Math.max(window.innerWidth, 1), high = Math.max(window.innerHeight, 1), rest = [0, 0, wide, high];
  const box = (id) => {
    const b = byId(id) && byId(id).getBoundingClientRect();
    return b && b.width > 0 && b.height > 0 ? b : null;
  };
  const card = box("es-card"), bar = box("es-bar"), beside = [...rest], below = [...rest];
  for (const id of ["es-play", "es-hint"]) { const b = box(id); if (b) beside[3] = below[3] = Math.min(below[3], b.top); }
  if (box("es-stick")) beside[3] = below[3] = Math.min(below[3], box("es-stick").top);
  const depth = box("es-depth");
  if (depth) beside[2] = below[2] = Math.min(below[2], depth.left);
  if (bar) { beside[0] = bar.right; below[3] = Math.min(below[3], bar.top); }
  if (card) { beside[0] = Math.max(beside[0], card.right); below[1] = card.bottom; }
  const large = [beside, below].filter(([l, t, r, b]) => r - l > 0.3 * wide && b - t > 0.3 * high);
  return large.length ? large : [rest];
}
// Look against `direction` (z up) from where all points are in the free part of the picture; again where the window or
// the card changes, until somebody moves the camera.
let framed = null, home = null;
viewer.controls.addEventListener("start", () => { framed = null; });
const again = () => { if (framed) look(...framed); else shift(middle); viewer.set_dirty(); };
window.addEventListener("resize", again);
const bars = new ResizeObserver(() => { if (framed) again(); });
for (const id of ["es-bar", "es-play", "es-hint", "es-depth"]) bars.observe(byId(id));
let middle = [0.5, 0.5];  // of the free part, as shares of the window
function shift([x, y]) {
  const wide = Math.max(window.innerWidth, 1), high = Math.max(window.innerHeight, 1);
  middle = [x, y];
  viewer.camera.aspect = wide / high;
  viewer.camera.setViewOffset(wide, high, (0.5 - x) * wide, (0.5 - y) * high, wide, high);
}
function look(points, direction) {
  home = framed = [points, direction];
  const found = free_areas().flatMap((area) => sides(direction, area).map((side) => framing(points, side, area)));
  aim_at(found.reduce((best, other) => other.distance < best.distance ? other : best));
}
// The direction to look against, and in a high and narrow picture others, from which a long strip is narrower.
function sides(direction, [left, top, right, bottom]) {
  const turn = new T.Vector3(...direction), up = new T.Vector3(0, 0, 1);
  const angles = bottom - top > 1.2 * (right - left) ? [0, 0.6, -0.6, 1.1, -1.1] : [0];
  return angles.map((angle) => turn.clone().applyAxisAngle(up, angle).toArray());
}
function framing(points, direction, [left, top, right_edge, bottom]) {
  const wide = Math.max(window.innerWidth, 1), high = Math.max(window.innerHeight, 1);
  const box = new T.Box3(), p = new T.Vector3(), list = [];
  for (let i = 0; i < points.length; i += 3) {
    list.push(new T.Vector3(points[i], points[i + 1], points[i + 2]));
    box.expandByPoint(list[list.length - 1]);
  }
  const center = box.getCenter(new T.Vector3()), n = new T.Vector3(...direction).normalize();
  const right = new T.Vector3(0, 0, 1).cross(n).normalize(), up = n.clone().cross(right);
  const share = Math.tan(viewer.camera.fov * Math.PI / 360) * 0.92 / high;
  const vertical = share * (bottom - top), horizontal = share * (right_edge - left);
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
  return { box, center, n, distance, middle: [(left + right_edge) / 2 / wide, (top + bottom) / 2 / high] };
}
function aim_at({ box, center, n, distance, middle: at }) {
  const eye = center.clone().addScaledVector(n, distance), p = new T.Vector3();
  shift(at);
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
  const object = at(cmd.path + "/<object>");
  if (plain > 2 && names(cmd.path)[0] === "ghosts") cmd = { ...cmd, matrices: thinned(cmd.matrices, plain > 3 ? 3 : 6) };
  const count = cmd.matrices.length / 16;
  if (cmd.names) object.userData.names = cmd.names;
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
// So many of matrices, evenly.
function thinned(matrices, most) {
  const n = matrices.length / 16, few = new Float32Array(16 * Math.min(n, most));
  for (let k = 0; k < few.length / 16; k++) {
    const from = 16 * Math.round(k * (n - 1) / Math.max(few.length / 16 - 1, 1));
    few.set(matrices.subarray(from, from + 16), 16 * k);
  }
  return few;
}
// Rods between neighbouring points of lines, each of one colour.
function rods(cmd) {
  if (plain) return plain_rods(cmd);
  const n = cmd.nodes, lines = cmd.points.length / (3 * n), count = lines * (n - 1);
  const matrices = new Float32Array(16 * count), colors = new Float32Array(3 * count);
  const M = new T.Matrix4(), a = new T.Vector3(), x = new T.Vector3(), y = new T.Vector3(), z = new T.Vector3();
  for (let line = 0, k = 0; line < lines; line++) {
    for (let j = 0; j < n - 1; j++, k++) {
      const i = 3 * (line * n + j);
      a.fromArray(cmd.points, i);
      z.fromArray(cmd.points, i + 3).sub(a);
      if (z.length() < 1e-6) z.set(0, 0, 1e-6);
      (Math.abs(z.z) < 0.9 * z.length() ? x.set(0, 0, 1) : x.set(1, 0, 0)).cross(z).setLength(cmd.radius);
      y.crossVectors(z, x).setLength(cmd.radius);
      M.makeBasis(x, y, z).setPosition(a).toArray(matrices, 16 * k);
      colors.set(cmd.colors.subarray(3 * line, 3 * line + 3), 3 * k);
    }
  }
  place({ path: cmd.path, matrices, colors });
}
// A translucent body hides its own inside: draw its depth first. Where it coincides with a solid one it is behind.
function veiled(object) {
  Object.assign(object.material, { polygonOffset: true, polygonOffsetFactor: 2, polygonOffsetUnits: 400 });
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
let newest = null, resting = null;  // the card to show, and for how long the one that is shown stays
function card(cmd) {
  newest = cmd;
  if (resting) return;
  write_card(cmd);
  if (!FINE) resting = setTimeout(() => { resting = null; if (newest !== cmd) card(newest); }, 150);  // nobody reads faster
}
const SMALL = window.matchMedia("(max-width: 700px), (max-height: 420px)");
let folded = SMALL.matches, rows_before = -1;
SMALL.addEventListener("change", () => fold(SMALL.matches));
function fold(is) {
  folded = is;
  if (newest) write_card(newest);
  again();
}
function write_card(cmd) {
  const box = byId("es-card");
  box.replaceChildren();
  box.style.display = "block";
  box.className = folded ? "folded" : "";
  const head = element(box, "h1", cmd.title);
  if (cmd.chip) element(head, "span", cmd.chip[0], cmd.chip[1]).className = "chip";
  const button = element(head, "button", folded ? "+" : "\u2212");
  button.type = "button";
  button.title = folded ? "show all of the card (C)" : "show less of the card (C)";
  button.setAttribute("aria-label", button.title);
  button.setAttribute("aria-expanded", !folded);
  button.onclick = () => fold(!folded);
  for (const [name, value] of cmd.rows) {
    const row = element(box, "div");
    row.className = "row";
    element(row, "span", name);
    element(row, "b", value);
  }
  if (cmd.note !== undefined) element(box, "div", cmd.note).className = "note";
  if (document.body.dataset.ended) ended();
  const legend = element(box, "div");
  legend.className = "legend";
  for (const [name, color] of cmd.legend) {
    const entry = element(legend, "span");
    element(entry, "i", undefined, color);
    entry.append(name);
  }
  if (cmd.rows.length + cmd.legend.length !== rows_before) {  // another card: of another size
    rows_before = cmd.rows.length + cmd.legend.length;
    if (framed) again();
  }
}

// What is shown is no longer so: the program behind it has ended.
function ended() {
  document.body.dataset.ended = "yes";
  const chip = byId("es-card").querySelector(".chip");
  if (chip) { chip.textContent = "ended: the last picture"; chip.style.background = "#7b8896"; }
}

// Buttons for what plays.
const animator = viewer.animator, slider = byId("es-time"), speed = byId("es-speed");
for (const x of [0.25, 0.5, 1, 2, 4]) speed.add(new Option("\u00d7" + x, x, x === 1, x === 1));
speed.onchange = () => { animator.mixer.timeScale = +speed.value; };
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
  byId("es-toggle").textContent = animator.playing ? "\u275a\u275a" : "\u25b6";
  byId("es-now").textContent = (+slider.value).toFixed(1) + " s";
}, 100);

// Places come as whole numbers, and faces as how far behind the next new vertex theirs are.
function unpack(geometry) {
  const p = geometry.data.attributes.position, index = geometry.data.index, planes = index.behind;
  if (planes) {
    const n = planes.length / 3, faces = new Uint32Array(n);
    for (let i = 0, next = 0; i < n; i++) {
      const behind = planes[i] | planes[n + i] << 8 | planes[2 * n + i] << 16;
      faces[i] = next - behind;
      if (behind === 0) next++;
    }
    index.array = faces;
  }
  if (p.unit === undefined) return;
  const places = new Float32Array(p.array.length);
  for (let i = 0; i < places.length; i++) places[i] = p.low[i % 3] + p.unit * p.array[i];
  p.array = places;
  p.type = "Float32Array";
}
// What a plain mesh looks like besides its shape.
function looks_like(object) {
  if (!object.isMesh || object.isInstancedMesh || !object.userData) return undefined;
  const { uuid, ...look } = object.material.toJSON();
  return JSON.stringify([look, object.matrix, object.userData.shadow, object.userData.veiled]);
}
const set_object = viewer.set_object.bind(viewer), handle = viewer.handle_command.bind(viewer);
viewer.set_object = (path, object) => {
  const old = (viewer.scene_tree.find(path).children["<object>"] || { }).object, look = looks_like(object);
  if (old && look && old.userData.look === look) {  // a new material would be compiled anew, which takes long
    old.geometry.dispose();
    old.geometry = object.geometry;
    return added(path);
  }
  object.userData.look = look;
  if (object.userData && object.userData.shadow === false) object.castShadow = object.receiveShadow = false;
  if (object.geometry && !object.geometry.attributes.normal) object.geometry.computeVertexNormals();
  if (object.userData && object.userData.veiled) veiled(object);
  set_object(path, object);
  added(path);
};
const extra = { };  // commands of the other scripts
let added = () => { };  // told of new objects
viewer.handle_command = (cmd) => {
  switch (cmd.type) {
    case "set_object": cmd.object.geometries.forEach(unpack); handle(cmd); break;
    case "instances": place(cmd); break;
    case "rods": rods(cmd); break;
    case "transforms":
      cmd.paths.forEach((p, i) => viewer.set_transform(names(p), cmd.matrices.subarray(16 * i, 16 * i + 16)));
      break;
    case "hud": card(cmd); break;
    case "camera":
      look(cmd.points, cmd.direction);
      if (document.body.dataset.ended && newest) { delete document.body.dataset.ended; write_card(newest); }  // another picture
      break;
    case "captions": captions = cmd.cards.length ? cmd : null; caption = -1; break;
    case "no_animation": animator.pause(); animator.clear(); byId("es-play").style.display = "none"; break;
    case "set_animation":
      handle(cmd);
      slider.max = animator.duration;
      speed.onchange();
      byId("es-play").style.display = "flex";
      break;
    default: (extra[cmd.type] || handle)(cmd);
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
