// What is shown and hidden, what things are called, and texts at places.
const LAYERS = [  // name, whether it is shown at first, what belongs to it
  ["ghosts", true, (p) => p[0] === "ghosts"],
  ["strip", true, (p) => p[p.length - 1] === "base" && p[0] !== "robot"],
  ["threads", true, (p) => p[p.length - 1] === "threads"],
  ["protective hulls", false, (p) => p[0] === "hulls"],
  ["forces", true, (p) => p[0] === "forces"],
  ["driven", true, (p) => p[1] === "trace"],
  ["trails", true, (p) => p[1] === "trails"],
  ["predictions", true, (p) => p[0] === "predictions"],
  ["sensed", true, (p) => p[0] === "sensed"],
  ["views", true, (p) => p[0] === "views"],
  ["map", true, (p) => p[0] === "map"],
  ["unseen", true, (p) => p[0] === "unseen"],
  ["depth", true, () => false],  // pictures, which are no meshes
  ["obstacles", true, (p) => p[0] === "obstacles"],
];
const store = (() => { try { return window.sessionStorage; } catch { return { }; } })();  // none in some frames
const on = Object.fromEntries([...LAYERS, ["names", false]].map(([n, first]) => [n, (store["es-" + n] || first + "") === "true"]));
const layer_of = (path) => LAYERS.find(([, , holds]) => holds(path));
const buttons = { };
const whole = element(byId("es-bar"), "button", "\u2922");  // the camera as it was at first
whole.type = "button";
whole.title = "the whole strip in the picture";
whole.setAttribute("aria-label", whole.title);
whole.className = "whole";
whole.onclick = () => { if (home) { look(...home); viewer.set_dirty(); } };

// Meshes are hidden, not the nodes above them: those belong to what plays.
function each_mesh(node, path, visit) {
  for (const [name, child] of Object.entries(node.children)) {
    if (name === "<object>") visit(child.object, path); else each_mesh(child, [...path, name], visit);
  }
}
function apply(object, path) {
  const layer = layer_of(path);
  if (layer) object.visible = on[layer[0]];
  return layer;
}
function toggle(name) {
  on[name] = !on[name];
  buttons[name].setAttribute("aria-pressed", on[name]);
  each_mesh(viewer.scene_tree, [], apply);
  byId("es-depth").style.display = on.depth ? "block" : "none";
  viewer.set_dirty();
}
function button(name) {
  if (buttons[name]) return;
  const b = buttons[name] = element(byId("es-bar"), "button", name);
  b.type = "button";
  b.title = `show or hide: ${name}`;
  b.setAttribute("aria-pressed", on[name]);
  b.onclick = () => {
    toggle(name);
    try { store["es-" + name] = on[name]; } catch { /* kept for this page alone */ }
  };
  byId("es-bar").append(...[...LAYERS.map((l) => l[0]), "names"].filter((n) => buttons[n]).map((n) => buttons[n]), whole);
  byId("es-bar").style.display = "flex";
}
added = (path) => {
  const node = viewer.scene_tree.find(path), inner = path.filter((x) => x !== "<object>");
  if (node.children["<object>"]) {
    apply(node.children["<object>"].object, inner);
    simplify(node.children["<object>"].object, inner);
  }
  const layer = layer_of(inner);
  if (layer) button(layer[0]);
  if (layer && layer[0] === "obstacles") button("names");
};

// Where a picture takes long it is drawn plainer, step by step, until it is quick enough.
const SLOW = 32;  // [ms] a picture; the browser adds half as much
let plain = 0;
function simplify(object, path) {
  const old = object.material;
  if (!plain || !old) return;
  if (path[0] === "robot") fewer(object.geometry, 12);
  if (path[0] === "ghosts") fewer(object.geometry, 6);
  if (path[0] === "ghosts") place({ path: path.join("/"), matrices: object.instanceMatrix.array.slice(0, 16 * object.count) });
  if (object.userData.veil && object.userData.veil.visible) {
    object.userData.veil.visible = false;
    object.material = new T.MeshBasicMaterial({ color: old.color, opacity: 0.2, transparent: true, depthWrite: false });
    old.dispose();
  } else if (old.isMeshStandardMaterial && path[0] !== "lights") {
    const { color: c, opacity, transparent, depthWrite } = old;
    const side = ["obstacles", "predictions"].includes(path[0]) ? T.FrontSide : old.side;  // closed ones
    object.material = new T.MeshBasicMaterial({ color: c, opacity, transparent, side, vertexColors: true, depthWrite });
    object.userData.painted = true;
    if (FADED.includes(path[0])) looked_through(object.material);
    old.dispose();
  }
  if (object.userData.painted) paint(object.geometry);
}
// Light and shade as colours of the vertices, once: light costs a processor a third of a picture. It turns with a body.
function paint(geometry) {
  const { normal, color } = geometry.attributes;
  if (geometry.userData.painted || !normal) return;
  geometry.userData.painted = true;
  const whole = color && color.normalized ? 2 ** (8 * color.array.BYTES_PER_ELEMENT) - 1 : 1;  // of colours as whole numbers
  const shades = new Float32Array(3 * normal.count), n = new T.Vector3(), from = new T.Vector3(-0.4, -0.45, 0.8).normalize();
  for (let i = 0; i < normal.count; i++) {
    const light = 0.56 + 0.12 * n.fromBufferAttribute(normal, i).z + 0.42 * Math.max(n.dot(from), 0);
    for (let k = 0; k < 3; k++) shades[3 * i + k] = Math.min(light, 1) * (color ? color.array[color.itemSize * i + k] / whole : 1);
  }
  geometry.setAttribute("color", new T.BufferAttribute(shades, 3));
}
// Of a mesh's vertices that share a cell, and look the same way, only the first is kept.
function fewer(geometry, cells) {  // so many in its radius
  if (geometry.userData.fewer || !geometry.index || geometry.index.count < 3 * 300) return;
  geometry.userData.fewer = true;
  geometry.computeBoundingSphere();
  const { position, normal, color } = geometry.attributes, faces = geometry.index.array, kept = [];
  const cell = Math.max(geometry.boundingSphere.radius / cells, 0.02), first = new Map(), of = new Uint32Array(position.count);
  for (let i = 0; i < of.length; i++) {
    const key = [position, normal, color].map((a, k) => a &&
      [a.getX(i), a.getY(i), a.getZ(i)].map((x) => Math.round(x / [cell, 1, 0.1][k]))).join();
    if (!first.has(key)) first.set(key, i);
    of[i] = first.get(key);
  }
  for (let i = 0; i < faces.length; i += 3) {
    const [a, b, c] = [of[faces[i]], of[faces[i + 1]], of[faces[i + 2]]];
    if (a !== b && b !== c && c !== a) kept.push(a, b, c);
  }
  if (kept.length) geometry.setIndex(kept);
}
// Lines in place of rods.
function plain_rods(cmd) {
  const object = at(cmd.path + "/<object>"), n = cmd.nodes, count = cmd.points.length / (3 * n);
  const points = new Float32Array(6 * count * (n - 1)), colors = new Float32Array(points.length);
  for (let line = 0, k = 0; line < count; line++) {
    for (let j = 0; j < n - 1; j++, k += 6) {
      const i = 3 * (line * n + j);
      points.set(cmd.points.subarray(i, i + 6), k);
      for (const end of [k, k + 3]) colors.set(cmd.colors.subarray(3 * line, 3 * line + 3), end);
    }
  }
  let lines = object.children[0];
  if (!lines) {
    lines = new T.LineSegments(new T.BufferGeometry(), new T.LineBasicMaterial({ vertexColors: true }));
    lines.frustumCulled = false;
    object.add(lines);
    object.count = 0;
  }
  for (const [name, values] of [["position", points], ["color", colors]]) {
    const old = lines.geometry.attributes[name];
    if (!old || old.array.length !== values.length) lines.geometry.setAttribute(name, new T.BufferAttribute(values, 3));
    else { old.array.set(values); old.needsUpdate = true; }
  }
}
function plainer() {
  plain++;
  if (plain === 1) {
    viewer.renderer.shadowMap.enabled = sun.castShadow = floor.visible = false;
    grid.geometry.setDrawRange(0, lines.length / 3 / 4);  // its middle
  }
  if (plain === 2) viewer.renderer.setPixelRatio(0.5 * window.devicePixelRatio);
  if (plain === 4) viewer.renderer.setPixelRatio(0.4 * window.devicePixelRatio);
  each_mesh(viewer.scene_tree, [], simplify);
  viewer.set_dirty();
  document.body.dataset.plain = plain;
  if (plain === 2) toast("drawn more plainly because this machine is slow; #fine at the end of the address draws everything");
}
if (SOFTWARE) plainer();
const one_pixel = new Uint8Array(4);
let due_look = 0, looks = 0;
function time_it() {  // what a picture takes is known only where its pixels are waited for
  const gl = viewer.renderer.getContext(), finish = () => gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, one_pixel);
  finish();  // the pictures before
  const begin = performance.now();
  draw();
  finish();
  looks++;
  due_look = performance.now() + 600;
  if (performance.now() - begin > SLOW && looks > 1 && plain < 4) plainer();  // the first one compiles
}

// Points and lines of one colour, which change often: their buffers are kept while there is room.
function plain_object(cmd, make) {
  const branch = names(cmd.path), node = viewer.scene_tree.find(branch).children["<object>"], count = cmd.places.length / 3;
  let object = node && node.object;
  if (!object) {
    object = make(new T.BufferGeometry(), new T.Color(...cmd.color));
    object.geometry.setAttribute("position", new T.BufferAttribute(new Float32Array(0), 3));
    object.frustumCulled = false;
    viewer.set_object(branch, object);
  }
  let places = object.geometry.attributes.position;
  if (places.count < count) {
    object.geometry.dispose();  // the old buffers
    places = new T.BufferAttribute(new Float32Array(3 * Math.ceil(1.5 * count)), 3);
    object.geometry.setAttribute("position", places);
  }
  places.array.set(cmd.places);
  places.needsUpdate = true;
  object.geometry.setDrawRange(0, count);
}
const dot = 3 * window.devicePixelRatio;
extra.points = (cmd) => plain_object(cmd, (shape, color) =>
  new T.Points(shape, new T.PointsMaterial({ color, size: dot, sizeAttenuation: false })));
extra.lines = (cmd) => plain_object(cmd, (shape, color) => new T.LineSegments(shape, new T.LineBasicMaterial({ color })));

// Pictures of depths: near is yellow, far is violet; where nothing is, it is white, and where nothing is known, gray.
const STOPS = [[253, 231, 37], [94, 201, 98], [33, 145, 140], [59, 82, 139], [68, 1, 84]], NOTHING = [255, 255, 255], LOST = [150, 150, 150];
const shade = (x) => {
  const k = Math.min(Math.floor(4 * x), 3), f = 4 * x - k;
  return STOPS[k].map((c, i) => Math.round(c + f * (STOPS[k + 1][i] - c)));
};
const PALETTE = Array.from({ length: 256 }, (_, v) => v === 0 ? LOST : v === 255 ? NOTHING : shade((v - 1) / 253));
const css = (rgb) => `rgb(${rgb.join()})`;
const pictures = new Map();  // sensor -> its figure
extra.depth = (cmd) => {
  let figure = pictures.get(cmd.sensor);
  if (!cmd.columns) {
    if (figure) figure.remove();
    pictures.delete(cmd.sensor);
    return;
  }
  if (!figure) {
    pictures.set(cmd.sensor, figure = element(byId("es-depth"), "figure"));
    element(figure, "canvas");
    const said = element(figure, "figcaption", cmd.sensor + " ");
    element(said, "i", undefined, `linear-gradient(90deg, ${STOPS.map(css).join()})`).className = "wide";
    said.append(`${cmd.near.toFixed(1)} to ${cmd.far.toFixed(0)} m `);
    for (const [text, rgb] of [["nothing", NOTHING], ["not known", LOST]]) {
      element(said, "i", undefined, css(rgb));
      said.append(text + " ");
    }
    byId("es-depth").style.display = on.depth ? "block" : "none";
    button("depth");
  }
  const canvas = figure.firstChild, rows = cmd.pixels.length / cmd.columns;
  if (canvas.width !== cmd.columns || canvas.height !== rows) Object.assign(canvas, { width: cmd.columns, height: rows });
  const image = new ImageData(cmd.columns, rows);
  cmd.pixels.forEach((v, i) => { image.data.set(PALETTE[v], 4 * i); image.data[4 * i + 3] = 255; });
  canvas.getContext("2d").putImageData(image, 0, 0);
};

// Names.
extra.names = (cmd) => cmd.paths.forEach((path, i) => { viewer.scene_tree.find(names(path)).object.userData.name = cmd.names[i]; });
const shown = (object) => { for (let o = object; o; o = o.parent) if (!o.visible) return false; return true; };
function called(object, instance) {
  if (instance !== undefined && object.userData.names) return object.userData.names[instance];
  for (let o = object; o; o = o.parent) if (o.userData.name !== undefined) return o.userData.name;
  return undefined;
}
const ray = new T.Raycaster();
function aim(event) {
  const box = viewer.renderer.domElement.getBoundingClientRect();
  ray.setFromCamera(new T.Vector2((event.clientX - box.left) / box.width * 2 - 1,
                                  1 - (event.clientY - box.top) / box.height * 2), viewer.camera);
}
// The first thing under the pointer in one of the branches: what it is called, where, and in which branch.
function pick(event, branches) {
  aim(event);
  let best = null;
  for (const branch of branches) {
    const node = viewer.scene_tree.children[branch];
    for (const hit of node ? ray.intersectObject(node.object, true) : []) {
      if (shown(hit.object) && (!best || hit.distance < best.distance))
        best = { branch, distance: hit.distance, point: hit.point, object: hit.object, name: called(hit.object, hit.instanceId) };
    }
  }
  return best;
}
const pane = byId("meshcat-pane"), tip = byId("es-tip");
let waiting = null, down = false;
for (const [kind, value] of [["pointerdown", true], ["pointerup", false], ["pointercancel", false]])
  window.addEventListener(kind, () => { down = value; }, true);
pane.addEventListener("pointermove", (event) => {
  if (event.buttons || waiting) return;
  waiting = setTimeout(() => {
    waiting = null;
    if (down) return;
    const hit = look_under(event);
    tip.style.display = hit && hit.name ? "block" : "none";
    if (hit && hit.name) tip.textContent = hit.name;
    tip.style.left = event.clientX + "px"; tip.style.top = event.clientY + "px";
    pane.style.cursor = hit && can_drag(hit) ? "grab" : "";
  }, 60);
});
pane.addEventListener("pointerdown", () => { tip.style.display = "none"; });
let can_drag = () => false;
let look_under = (event) => pick(event, ["obstacles", "sensed", "map", "robot", "markers"]);

// Where each obstacle is: [name, world position] of those that are shown.
function places(limit) {
  const list = [], m = new T.Matrix4(), node = viewer.scene_tree.children.obstacles;
  if (!node) return list;
  node.object.updateMatrixWorld();
  each_mesh(node, ["obstacles"], (object) => {
    if (!shown(object)) return;
    if (object.isInstancedMesh && object.userData.names) {
      for (let i = 0; i < object.count && list.length < limit; i++) {
        object.getMatrixAt(i, m);
        list.push([object.userData.names[i], new T.Vector3().setFromMatrixPosition(m).applyMatrix4(object.matrixWorld)]);
      }
    } else if (list.length < limit) list.push([called(object), object.getWorldPosition(new T.Vector3())]);
  });
  return list;
}

// Texts at places.
const texts = new Map();  // group -> [[text, world position], ...]
extra.labels = (cmd) => texts.set(cmd.group, cmd.texts.map((text, i) =>
  [text, new T.Vector3(cmd.points[3 * i], cmd.points[3 * i + 2], -cmd.points[3 * i + 1])]));
const board = byId("es-labels");
function write() {
  const list = [];
  for (const [group, entries] of texts) for (const [text, at] of entries) list.push([text, at, group.slice(1)]);
  if (on.names) for (const [text, at] of places(120)) list.push([text, at, ""]);
  while (board.children.length > list.length) board.lastChild.remove();
  while (board.children.length < list.length) element(board, "div");
  const beside = list.length ? byId("es-card").getBoundingClientRect() : null;
  const p = new T.Vector3(), box = viewer.renderer.domElement.getBoundingClientRect();
  list.forEach(([text, at, kind], i) => {
    const e = board.children[i];
    p.copy(at).project(viewer.camera);
    if (e.textContent !== text) e.textContent = text;
    if (e.className !== kind) e.className = kind;
    e.style.display = Math.abs(p.z) < 1 ? "block" : "none";
    const half = e.offsetWidth / 2, wide = box.width - half, top = Math.max((1 - p.y) / 2 * box.height, e.offsetHeight);
    const low = top - e.offsetHeight < beside.bottom ? Math.min(beside.right + 8 + half, wide) : half;  // not over the card
    e.style.left = Math.min(Math.max((p.x + 1) / 2 * box.width, low), wide) + "px";
    e.style.top = top + "px";
  });
}
const draw = viewer.render.bind(viewer);
viewer.render = () => {
  const may = looks < 12 && !FINE && document.body.dataset.ready;
  if (may && performance.now() > due_look) time_it(); else draw();
  write();
};
let toasting = null;
function toast(text) {
  if (document.body.dataset.ended) return;
  const box = byId("es-toast"), said = box.style.display === "block" ? box.textContent.split("\n") : [];
  const lines = text.split("\n");
  if (box.style.display !== "block") delete box.dataset.keys;  // what H has listed is no longer up
  box.textContent = [...said.filter((line) => !lines.includes(line)), ...lines].join("\n");  // what is still up stays up
  box.style.display = "block";
  clearTimeout(toasting);
  toasting = setTimeout(() => { box.style.display = "none"; }, Math.max(2500, 60 * box.textContent.length));
}
