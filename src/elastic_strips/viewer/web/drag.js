// What can be dragged: obstacles and the ring at the goal. Over the floor; with Shift, or the arrow, up and down; with
// Alt, or the ring, about the vertical. The picture follows what comes back from the program.
let allowed = { obstacles: false, goal: false, hand: false }, held = null, chosen = null;
extra.draggable = (cmd) => {
  const any = (can) => can.obstacles || can.goal || can.hand;
  if (any(cmd)) delete document.body.dataset.ended;
  else if (any(allowed)) ended();  // nobody keeps the strip any more
  allowed = cmd;
  choose(null);
  byId("es-hint").style.display = any(cmd) && !document.body.dataset.grabbed ? "block" : "none";
  const things = [[cmd.obstacles, "an obstacle"], [cmd.goal, "the goal's ring"], [cmd.hand, "the goal's hand"]];
  const named = things.filter(([can]) => can).map(([, name]) => name), last = named.pop();
  byId("es-hint").textContent = `drag ${named.length ? `${named.join(", ")} or ` : ""}${last} \u00b7 Shift: up and down \u00b7 Alt: turn`;
};
const say_back = (message) => {
  if (viewer.connection && viewer.connection.readyState === 1) viewer.connection.send(JSON.stringify(message));
};
const is_goal = (object, name = "goal") => {
  for (let o = object; o; o = o.parent) if (o.userData.name === name) return true;
  return false;
};
const is_hand = (object) => is_goal(object, "hand at the goal");
can_drag = (hit) => (hit.branch === "obstacles" && allowed.obstacles && hit.name !== undefined) ||
  (hit.branch === "markers" && ((allowed.goal && is_goal(hit.object)) || (allowed.hand && is_hand(hit.object))));

// The goal's hand is held through what stands before it, and its base by the ring's inside, too, but not through anything.
const under = look_under;
look_under = (event) => {
  const hit = under(event), marks = (viewer.scene_tree.children.markers || { children: { } }).children;
  const [ball] = allowed.hand && marks.hand && shown(marks.hand.object) ? ray.intersectObject(marks.hand.object, true) : [];
  if (ball) return { branch: "markers", distance: ball.distance, point: ball.point, object: ball.object, name: called(ball.object) };
  const goal = allowed.goal && (marks.goal || { }).object;
  if ((hit && hit.branch !== "markers") || !goal || !shown(goal)) return hit;
  const floor = ray.ray.intersectPlane(new T.Plane(new T.Vector3(0, 1, 0), 0), new T.Vector3());
  if (!floor || floor.distanceTo(goal.getWorldPosition(new T.Vector3())) > 0.55) return hit;
  return { branch: "markers", point: floor, object: goal, name: "goal" };
};

// Handles about what was chosen.
const handle_color = new T.MeshBasicMaterial({ color: color(0x24606f), transparent: true, opacity: 0.85, depthTest: false });
const handles = { up: new T.Group(), turn: new T.Group() };
const shaft = new T.Mesh(new T.CylinderGeometry(0.02, 0.02, 0.5, 12), handle_color);
const tops = [0.3, -0.3].map((y) => {
  const tip = new T.Mesh(new T.ConeGeometry(0.07, 0.16, 18), handle_color);
  tip.position.y = y;
  if (y < 0) tip.rotation.x = Math.PI;
  return tip;
});
handles.up.add(shaft, ...tops);
handles.up.rotation.x = Math.PI / 2;  // cylinders stand along y
handles.turn.add(new T.Mesh(new T.TorusGeometry(0.55, 0.022, 10, 48), handle_color));
const gizmo = new T.Group();
gizmo.add(handles.up, handles.turn);
gizmo.visible = false;
gizmo.traverse((o) => { o.renderOrder = 10; });
viewer.scene.add(gizmo);  // the scene's own frame: z is up
function choose(name) {
  chosen = name;
  gizmo.visible = name !== null;
  place_gizmo();
  viewer.set_dirty();
}
function place_gizmo() {
  if (chosen === null) return;
  const found = places(1e4).find(([name]) => name === chosen);
  gizmo.visible = !!found;
  if (found) gizmo.position.copy(viewer.scene.worldToLocal(found[1].clone()));
}
const render_all = viewer.render;
viewer.render = () => { place_gizmo(); render_all(); };
function on_handle(event) {
  if (!gizmo.visible) return null;
  aim(event);
  gizmo.updateMatrixWorld(true);
  for (const [mode, group] of [["up", handles.up], ["turn", handles.turn]])
    if (ray.intersectObject(group, true).length) return mode;
  return null;
}

// Where the pointer is, in the frame with z up, on the plane that the thing is dragged in.
function on_plane(event) {
  aim(event);
  const plane = new T.Plane(), p = new T.Vector3();
  if (held.mode === "up") {  // upright, facing the camera
    const n = viewer.camera.getWorldDirection(new T.Vector3());
    n.y = 0;
    plane.setFromNormalAndCoplanarPoint(n.normalize(), held.point);
  } else plane.setFromNormalAndCoplanarPoint(new T.Vector3(0, 1, 0), held.point);
  if (!ray.ray.intersectPlane(plane, p) || p.distanceTo(held.point) > 60) return null;
  return [p.x, -p.z, p.y];
}
let due = null;
function drag_to(event) {
  const p = on_plane(event);
  if (held.mode === "turn") held.turn = (event.clientX - held.x) * 0.012;
  else if (p && held.from) held.shift = held.mode === "up" ? [0, 0, p[2] - held.from[2]]
    : [p[0] - held.from[0], p[1] - held.from[1], 0];
  if (due === null) due = requestAnimationFrame(send);
}
function send() {
  due = null;
  if (held) say_back({ type: "drag", name: held.name, hand: held.hand, shift: held.shift, turn: held.turn });
}
pane.addEventListener("pointerdown", (event) => {
  if (event.button !== 0 || !(allowed.obstacles || allowed.goal || allowed.hand)) return;
  const mode = on_handle(event), hit = mode ? null : look_under(event);
  if (!mode && !(hit && can_drag(hit))) { choose(null); return; }
  event.stopPropagation();  // the camera stays
  viewer.controls.enabled = false;
  const goal = !mode && hit.branch === "markers", hand = goal && is_hand(hit.object);
  const point = mode ? viewer.scene.localToWorld(gizmo.position.clone()) : hit.point.clone();
  held = { name: mode ? chosen : goal ? null : hit.name, hand, point, x: event.clientX, shift: [0, 0, 0], turn: 0, from: null,
           mode: mode || (event.altKey ? "turn" : event.shiftKey && (hand || !goal) ? "up" : "flat") };
  held.from = on_plane(event);
  tip.style.display = "none";
  choose(goal ? null : held.name);
  pane.setPointerCapture(event.pointerId);
  pane.style.cursor = "grabbing";
  say_back({ type: "grab", name: held.name, hand });
  document.body.dataset.grabbed = "yes";
  byId("es-hint").style.display = "none";
}, true);
pane.addEventListener("pointermove", (event) => { if (held) { event.stopPropagation(); drag_to(event); } }, true);
function let_go() {
  if (!held) return;
  if (due !== null) { cancelAnimationFrame(due); send(); }
  say_back({ type: "release", name: held.name });
  held = null;
  viewer.controls.enabled = true;
  pane.style.cursor = "";
}
for (const kind of ["pointerup", "pointercancel", "lostpointercapture"]) pane.addEventListener(kind, let_go, true);
window.addEventListener("blur", let_go);

// With keys: one obstacle after the other is chosen, and moved by steps.
const MOVE = 0.05, TURN = 0.1, PAUSE = 600;  // [m], [rad] a key; [ms] after the last key it is let go
const SIDES = { arrowup: [0, 1, 0], arrowdown: [0, -1, 0], arrowleft: [-1, 0, 0], arrowright: [1, 0, 0] };  // right, ahead, up
let nudged = null, left_alone = null;
function nudge(by, turn) {
  if (!nudged || nudged.name !== chosen) {
    leave_nudged();
    nudged = { name: chosen, shift: [0, 0, 0], turn: 0 };
    say_back({ type: "grab", name: chosen, hand: false });
  }
  const ahead = viewer.camera.getWorldDirection(new T.Vector3()), side = Math.atan2(-ahead.z, ahead.x);
  const square = Math.round(side / (Math.PI / 2)) * Math.PI / 2, [c, s] = [Math.cos(square), Math.sin(square)];  // along x or y
  const step = [by[1] * c + by[0] * s, by[1] * s - by[0] * c, by[2]];
  nudged.shift = nudged.shift.map((x, i) => x + MOVE * step[i]);
  nudged.turn += TURN * turn;
  say_back({ type: "drag", name: nudged.name, hand: false, shift: nudged.shift, turn: nudged.turn });
  clearTimeout(left_alone);
  left_alone = setTimeout(leave_nudged, PAUSE);
}
function leave_nudged() {
  if (nudged) say_back({ type: "release", name: nudged.name });
  nudged = null;
}
const chosen_one = () => allowed.obstacles && chosen !== null;
ACTIONS.unshift(
  ["o", "choose the next obstacle", () => allowed.obstacles, () => {
    const all = [...new Set(places(1e4).map(([name]) => name).filter((name) => name !== undefined))];
    if (all.length) choose(all[(all.indexOf(chosen) + 1) % all.length]);
    if (all.length) toast(`${chosen}: arrows move it, Page up and Page down lift it, comma and full stop turn it, Escape leaves it`);
  }],
  ...Object.entries(SIDES).map(([key, by]) => [key, "move what was chosen", chosen_one, () => nudge(by, 0)]),
  ["pageup", "lift it", chosen_one, () => nudge([0, 0, 1], 0)],
  ["pagedown", "lower it", chosen_one, () => nudge([0, 0, -1], 0)],
  [",", "turn it to the left", chosen_one, () => nudge([0, 0, 0], 1)],
  [".", "turn it to the right", chosen_one, () => nudge([0, 0, 0], -1)],
  ["escape", "leave it", chosen_one, () => choose(null)],
);
