// Steering: keys and a stick. What is held is said twenty times a second, and once that nothing is: silence is rest.
const KEYS = { w: [1, 0, 0], arrowup: [1, 0, 0], s: [-1, 0, 0], arrowdown: [-1, 0, 0], a: [0, 0, 1], arrowleft: [0, 0, 1],
               d: [0, 0, -1], arrowright: [0, 0, -1], q: [0, 1, 0], e: [0, -1, 0] };
const EVERY = 50;  // ms
let steering = null, stick = [0, 0, 0], spoke = false;
const pressed = new Set(), pad = document.createElement("div"), knob = document.createElement("div");
pad.id = "es-stick";
pad.appendChild(knob);
document.body.appendChild(pad);
extra.steerable = (cmd) => {
  steering = cmd.on ? cmd : null;
  pressed.clear();
  rest();
  pad.style.display = cmd.on ? "block" : "none";
  byId("es-hint").style.display = cmd.on ? "block" : "none";
  byId("es-hint").textContent = `W A S D or arrows drive${cmd.slides ? " \u00b7 Q E sideways" : ""} \u00b7 or the stick`;
};
function rest() {
  stick = [0, 0, 0];
  knob.style.transform = "";
}
function said() {
  const sum = [...stick];
  for (const k of pressed) for (let i = 0; i < 3; i++) sum[i] += KEYS[k][i];
  return sum.map((x) => Math.max(-1, Math.min(1, x)));
}
function speak() {
  if (!steering) return;
  const [forward, left, turn] = said(), moves = forward || left || turn;
  if (moves || spoke) say_back({ type: "steer", forward, left: steering.slides ? left : 0, turn });
  spoke = !!moves;
}
setInterval(speak, EVERY);
window.addEventListener("keydown", (event) => {
  const k = event.key.toLowerCase();
  if (!steering || !(k in KEYS) || event.ctrlKey || event.metaKey || event.altKey) return;
  event.preventDefault();
  event.stopPropagation();
  const fresh = !pressed.has(k);
  pressed.add(k);
  if (fresh) speak();
}, true);
window.addEventListener("keyup", (event) => { if (pressed.delete(event.key.toLowerCase())) speak(); }, true);
window.addEventListener("blur", () => { pressed.clear(); rest(); speak(); });
function to_stick(event) {
  const box = pad.getBoundingClientRect(), r = box.width / 2;
  let x = (event.clientX - box.left - r) / r, y = (event.clientY - box.top - r) / r;
  const size = Math.max(1, Math.hypot(x, y));
  x /= size; y /= size;
  stick = [-y, 0, -x];
  knob.style.transform = `translate(${0.6 * r * x}px, ${0.6 * r * y}px)`;
}
pad.addEventListener("pointerdown", (event) => {
  event.stopPropagation();
  pad.setPointerCapture(event.pointerId);
  to_stick(event);
  speak();
});
pad.addEventListener("pointermove", (event) => { if (pad.hasPointerCapture(event.pointerId)) to_stick(event); });
for (const kind of ["pointerup", "pointercancel", "lostpointercapture"])
  pad.addEventListener(kind, () => { rest(); speak(); });
